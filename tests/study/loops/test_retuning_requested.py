"""One loop retuned as the [tuning] table asks: the notation, the methods, and what is refused."""

from __future__ import annotations

import sys
from typing import Any

import polars as pl
import pytest

import trueplant as tp
from support.retuned import DECLARED, PI_LAW, proposal, small
from trueplant import Project
from trueplant.errors import LoopError, ProjectError
from trueplant.loop import PID, Controller, Linear, unstable_poles
from trueplant.lti import TransferMatrix, UncertainPlant, tf
from trueplant.robust import margins


def test_vendor_notation(tmp_path):
    """Percent of span: a span of 200 of PV and 100 of OP halve the engineering gain."""
    asked = '[tuning]\nmethods = ["simc", "certain-share"]\nform = "series"\ngain_unit = "percent of span"\n'
    asked += 'gain = "proportional band"\nintegral = "repeats"\ntime_unit = "s"'
    loop = tp.run(small(tmp_path, asked, DECLARED, law=PI_LAW)).to_dict()["controllers"][0]
    simc = proposal(loop, "simc")
    # dead time 2 and half a scan, within what the data say: Kc = 10/(2 (2.5 + 2.5)) in engineering units
    assert simc["settings"]["Kc"] * 100 / 200 == pytest.approx(1.0, rel=0.1)
    assert simc["shown"]["gain"] == pytest.approx(100 / simc["settings"]["Kc"])
    assert simc["shown"]["integral"] == pytest.approx(1 / (60 * simc["settings"]["Ti"]))
    assert loop["form"] == simc["settings"]["form"] == "series"
    assert loop["notation"] == {
        "gain": "proportional band", "integral": "repeats", "derivative_filter": "ratio", "time_unit": "s"
    }  # fmt: skip


def test_as_designed_undoes_a_change_of_gain(tmp_path):
    asked = '[tuning]\nmethods = ["as-designed"]'
    loop = tp.run(small(tmp_path, asked, DECLARED, law=PI_LAW)).to_dict()["controllers"][0]
    settings = proposal(loop, "as-designed")["settings"]
    assert settings["Kc"] == pytest.approx(0.75, rel=0.03)
    assert settings["Ti"] == pytest.approx(10, rel=0.05)


def test_a_loop_that_needs_nothing_is_left_alone(tmp_path):
    """Tight already, at the limits that were asked for: no change is recommended, and the reason says why."""
    law = PID(Kc=0.8, Ti=5.0, sample_time=1.0)
    declared = DECLARED.replace("Kc = 1.0\nTi = 10", "Kc = 0.8\nTi = 5")
    asked = '[tuning]\nmethods = ["certain-share", "amigo"]\nlimits = {Ms = 1.75}'
    loop = tp.run(small(tmp_path, asked, declared, law=law)).to_dict()["controllers"][0]
    assert loop["recommended"] == "keep" and loop["trade_off"] is None
    assert "keep them" in loop["reason"]
    assert loop["current"]["drawn"]["share_all"] >= 0.95


def test_a_loop_too_lively_is_calmed(tmp_path):
    law = PID(Kc=1.9, Ti=7.0, sample_time=1.0)
    declared = DECLARED.replace("Kc = 1.0\nTi = 10", "Kc = 1.9\nTi = 7")
    loop = tp.run(small(tmp_path, "[tuning]\n", declared, law=law)).to_dict()["controllers"][0]
    assert loop["current"]["drawn"]["share"] < 0.05
    assert loop["recommended"] == "certain-share"
    assert proposal(loop, "certain-share")["drawn"]["share"] >= 0.95
    # every default method has an answer here, and those for several loops are not asked
    methods = [row["method"] for row in loop["proposals"]]
    assert methods[:2] == ["certain-share", "as-designed"] and "blt" not in methods
    assert all(row["settings"] is not None for row in loop["proposals"])


def test_designs_that_are_no_pid_are_transfer_functions(tmp_path):
    asked = '[tuning]\nmethods = ["lqg", "h2", "certain-share"]'
    project = small(tmp_path, asked, DECLARED, law=PI_LAW)
    result = tp.run(project)
    loop = result.to_dict()["controllers"][0]
    plant = TransferMatrix(((tf(result.elements[0].tf_plant),),))
    for method in ("lqg", "h2"):
        row = proposal(loop, method)
        assert list(row["settings"]) == ["tf"] and row["shown"] is None
        assert "no PID" in row["note"]
        law = Controller.diagonal([Linear(tf(row["settings"]["tf"]), sample_time=1.0)])
        assert unstable_poles(plant, law) == 0
        assert margins(plant, law).Ms == pytest.approx(row["metrics"]["plant"]["Ms"], rel=0.01)
        assert row["metrics"]["plant"]["Ms"] <= 1.59
    assert loop["recommended"] == "certain-share"


def test_h_infinity_without_slycot_says_what_to_do(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "slycot", None)
    loop = tp.run(small(tmp_path, '[tuning]\nmethods = ["h-infinity"]', DECLARED, law=PI_LAW)).to_dict()["controllers"][
        0
    ]
    assert "trueplant[hinf]" in proposal(loop, "h-infinity")["note"]
    assert proposal(loop, "h-infinity")["settings"] is None
    assert loop["recommended"] is None


def test_a_controller_that_acts_on_a_transformed_pv_gets_gains_for_it(tmp_path):
    """With pv_transform = "2 pv" the gain in front of it is half of what acts on PV."""
    declared = DECLARED.replace("Kc = 1.0", 'Kc = 0.5\npv_transform = "2 * pv"')
    asked = '[tuning]\nmethods = ["as-designed"]'
    loop = tp.run(small(tmp_path, asked, declared, law=PI_LAW)).to_dict()["controllers"][0]
    assert loop["current"]["settings"]["Kc"] == 0.5
    assert proposal(loop, "as-designed")["settings"]["Kc"] == pytest.approx(0.375, rel=0.03)


def test_nothing_is_proposed_without_the_table_or_without_a_controller(tmp_path):
    assert tp.run(small(tmp_path, "", DECLARED, law=PI_LAW)).controllers == ()
    result = tp.run(small(tmp_path, "[tuning]\n", "", law=PI_LAW))
    assert result.controllers == ()
    assert any(note.code == "tuning" and "[[controller]]" in note.message for note in result.notes)


def test_controllers_that_share_a_loop_are_not_retuned(tmp_path):
    both = DECLARED + DECLARED.replace('output = "y"', 'output = "z"')
    project = small(tmp_path, "[tuning]\n", DECLARED, law=PI_LAW)
    frame = pl.read_csv(tmp_path / "record.csv").with_columns(pl.col("sp").alias("sz"), pl.col("pv").alias("pz"))
    frame.write_csv(tmp_path / "record.csv")
    text = f"""
        time_unit = "min"
        data = {{files = ["record.csv"]}}
        output = [{{name = "y", pv = "pv", sp = "sp"}}, {{name = "z", pv = "pz", sp = "sz"}}]
        input = [{{name = "u", op = "op"}}]
        model = [{{output = "y", input = "u", tf = "1.5 exp(-2 s)/(10 s + 1)"}}]
        {both.replace("Kc = 1.0", "Kc = 0.5")}
        [tuning]
        """
    assert project.tuning is not None
    result = tp.run(Project.from_toml(text, tmp_path))
    assert result.controllers == ()
    assert any(note.code == "tuning" and "one controller a loop" in note.message for note in result.notes)


def test_a_plant_too_uncertain_to_draw_from_is_a_note(tmp_path, monkeypatch):
    def draw(*_: Any) -> None:
        raise LoopError("almost no draw has a plant that can be")

    monkeypatch.setattr(UncertainPlant, "draw", draw)
    result = tp.run(small(tmp_path, "[tuning]\n", DECLARED, law=PI_LAW))
    assert result.status == "ok" and result.controllers == ()
    assert any(note.code == "tuning" and "almost no draw" in note.message for note in result.notes)


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ('methods = ["magic"]', "no tuning method"),
        ("limits = {share = 1.0}", "share"),
        ("limits = {speed = 0.5}", "speed"),
        ('gain = "proportional band"', "percent of span"),
    ],
)
def test_a_wrong_table_is_refused(tmp_path, table, words):
    with pytest.raises(ProjectError, match=words):
        small(tmp_path, f"[tuning]\n{table}", DECLARED, law=PI_LAW)


def test_percent_of_span_needs_spans(tmp_path):
    project = small(tmp_path, "", DECLARED, law=PI_LAW)
    text = (tmp_path / "record.csv").read_text()
    assert text and project.tuning is None
    with pytest.raises(ProjectError, match="needs a span of u and of y"):
        Project.from_toml(
            """
            time_unit = "min"
            output = [{name = "y", pv = "pv", sp = "sp"}]
            input = [{name = "u", op = "op", limits = [0, 100]}]
            controller = [{input = "u", output = "y", Kc = 1.0}]
            tuning = {gain_unit = "percent of span"}
            """,
            tmp_path,
        )


def test_the_answer_is_as_the_system_shows_it(tmp_path):
    """A proportional band, in seconds, after the system named."""
    asked = '[tuning]\nmethods = ["simc"]\nvendor = "centum"'
    loop = tp.run(small(tmp_path, asked, DECLARED, law=PI_LAW)).to_dict()["controllers"][0]
    simc = proposal(loop, "simc")
    assert simc["shown"]["gain"] == pytest.approx(100 / simc["settings"]["Kc"])
    assert simc["shown"]["integral"] == pytest.approx(60 * simc["settings"]["Ti"])
    assert simc["settings"]["Kc"] * 100 / 200 == pytest.approx(1.0, rel=0.1)
    assert loop["notation"]["gain"] == "proportional band"


def test_no_settings_beside_a_controller_that_is_not_there(tmp_path):
    """OP was written with half of the declared gain."""
    wrong = DECLARED.replace("Kc = 1.0", "Kc = 2.0")
    result = tp.run(small(tmp_path, "[tuning]\n", wrong, law=PI_LAW)).to_dict()
    assert result["controllers"] == []
    (said,) = [note for note in result["notes"] if note["code"] == "tuning"]
    assert "OP was not written by the one declared" in said["message"]
    assert said["where"] == "u"
