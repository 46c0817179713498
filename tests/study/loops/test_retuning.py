"""Retuned controllers in the result: what they restore, and that their promise holds."""

from __future__ import annotations

import json

import numpy as np
import pytest

import trueplant as tp
from support import ROOT
from support.retuned import demo, proposal
from trueplant import Project, Result
from trueplant.loop import PID, Controller
from trueplant.lti import TransferMatrix
from trueplant.project.tables import Tuning
from trueplant.tune import loop_metrics

pytestmark = pytest.mark.slow


def law_of(result: Result, method: str, scan: float | None) -> Controller:
    """The controllers as a user would type them in."""
    entries = []
    for loop in result.to_dict()["controllers"]:
        rows = {p["method"]: p for p in loop["proposals"]} | {"current": loop["current"]}
        entries.append(PID(**rows[method]["settings"], sample_time=scan))
    return Controller.diagonal(entries)


@pytest.fixture(scope="module")
def splitter(tmp_path_factory):
    folder = tmp_path_factory.mktemp("splitter")
    return demo("splitter", folder, '[tuning]\nmethods = ["certain-share", "as-designed", "simc"]\nkind = "PI"')


@pytest.fixture(scope="module")
def mill(tmp_path_factory):
    tables = """
[analysis]
method = "direct"
[robustness]
wI = {gain_percent = 10, dead_time = 0.2}
wP = {bandwidth = 0.02}
[tuning]
methods = ["certain-share", "as-designed"]
"""
    return demo("mill", tmp_path_factory.mktemp("mill"), tables)


@pytest.mark.parametrize("name", ["splitter", "mill"])
def test_the_loop_that_was_designed_is_restored(name, request):
    """as-designed: on the plant as estimated each loop is again what it was on the model, where today it is not."""
    result, _ = request.getfixturevalue(name)
    gained = []
    for loop in result.to_dict()["controllers"]:
        wanted = loop["current"]["metrics"]["model"]["setpoint"]["iae"]
        before, after = (
            row["metrics"]["plant"]["setpoint"]["iae"] for row in (loop["current"], proposal(loop, "as-designed"))
        )
        # the interactions have changed too, and only each loop's own element is made up for
        assert after == pytest.approx(wanted, rel=0.2)
        gained.append((abs(before / wanted - 1), abs(after / wanted - 1)))
    assert max(b for b, _ in gained) > 0.2
    assert max(a for _, a in gained) < max(b for b, _ in gained) / 1.5


@pytest.mark.parametrize("name", ["splitter", "mill"])
def test_the_recommended_settings_are_better_on_the_true_plant(name, request):
    result, plant = request.getfixturevalue(name)
    assert {loop.recommended for loop in result.controllers} == {"certain-share"}
    scan = result.to_dict()["provenance"] and {"splitter": 0.1, "mill": 0.05}[name]
    before, after = (law_of(result, method, scan) for method in ("current", "certain-share"))
    for i, _ in enumerate(result.to_dict()["controllers"]):
        old, new = (loop_metrics(plant, law, output=i, input=i) for law in (before, after))
        assert new.load.iae <= old.load.iae * 1.02
        assert new.margins.Ms < 1.62
    first = [loop_metrics(plant, law, output=0, input=0).load.iae for law in (before, after)]
    assert first[1] < 0.7 * first[0]


@pytest.mark.parametrize("name", ["splitter", "mill"])
def test_the_share_is_that_of_plants_drawn_independently(name, request):
    result, _ = request.getfixturevalue(name)
    assert len(result.to_dict()["controllers"]) == 2
    for loop in result.to_dict()["controllers"]:
        drawn = proposal(loop, "certain-share")["drawn"]
        assert drawn["count"] == 1000
        assert drawn["seed"] == result.to_dict()["provenance"]["seed"] + 2
        assert 0.95 <= drawn["share_all"] <= drawn["share"] <= drawn["stable"] <= 1
        assert drawn["Ms"]["q50"] <= drawn["Ms"]["q95"] <= 1.6


def test_no_gain_is_proposed_that_the_record_cannot_support(splitter):
    """The element to the top temperature has no dead time: no rule would bound its gain."""
    result, _ = splitter
    top = result.to_dict()["controllers"][0]
    assert top["input"] == "reflux"
    assert "could be hidden" in top["assumptions"][0]
    today = top["current"]["metrics"]["plant"]["crossover"]
    for row in top["proposals"]:
        assert abs(row["settings"]["Kc"]) < 3
        assert row["metrics"]["plant"]["crossover"] < 2.1 * today


def test_settings_are_written_as_the_controller_is_declared(splitter):
    result, _ = splitter
    top, bottom = result.to_dict()["controllers"]
    declared = {"form": "ideal", "Kc": 1.0, "Ti": 8.0, "Td": 0.5, "alpha": 0.1, "action": "direct"}
    assert top["current"]["settings"] == declared
    for row in top["proposals"]:
        assert row["settings"]["action"] == "direct" and row["settings"]["Kc"] > 0
    assert bottom["form"] == "ideal" and bottom["gain_unit"] == "engineering" and bottom["time_unit"] == "min"
    assert proposal(top, "certain-share")["shown"]["integral"] == proposal(top, "certain-share")["settings"]["Ti"]


def test_the_recovered_disturbance_reproduces_the_record(splitter):
    """Today's controller under v = y - G u on the same plant is the record itself, noise included."""
    result, _ = splitter
    assert result.result.curves is not None
    for curves in result.result.curves.retuning:
        apart = curves.replay["before"] - curves.replay["record"]
        assert np.std(apart) < 0.35 * np.std(curves.replay["record"])
        assert curves.replay_t.shape == curves.replay["after"].shape


def test_bands_hold_the_curve_of_the_plant_and_end_at_rest(splitter):
    result, _ = splitter
    assert len(result.result.curves.retuning) == 2
    for curves in result.result.curves.retuning:
        for label in ("before", "after"):
            low, value, high = curves.setpoint[label].T
            assert np.mean((low <= value + 1e-9) & (value <= high + 1e-9)) > 0.9
            assert value[-1] == pytest.approx(1.0, abs=0.05)
            assert curves.load[label][-1, 1] == pytest.approx(0.0, abs=0.3)


def test_mu_is_reported_with_weights(mill):
    result, _ = mill
    assert len(result.to_dict()["controllers"]) == 2
    for loop in result.to_dict()["controllers"]:
        now = loop["current"]["metrics"]
        assert now["model"]["mu"]["upper"] >= now["model"]["mu"]["lower"] > 0.3
        assert now["plant"]["mu"] == result.to_dict()["controllers"][0]["current"]["metrics"]["plant"]["mu"]
        assert 0 <= proposal(loop, "certain-share")["drawn"]["mu_share"] <= 1


def test_the_table_is_json(mill):
    text = json.dumps(mill[0].to_dict()["controllers"], allow_nan=False)
    assert json.loads(text)[0]["recommended"] == "certain-share"


@pytest.mark.real
def test_a_proposal_from_one_run_holds_on_the_plant_of_another(real_data):
    """TCLab: both loops retuned from pid_short_01, judged by simulation on the plant fitted to pid_short_02."""
    examples = ROOT / "examples"
    first = Project.load(examples / "tclab_pid_short_01.toml")
    asked = Tuning(methods=["certain-share", "simc"], kind="PI")
    result = tp.run(first.model_copy(update={"tuning": asked}))
    other = tp.run(Project.load(examples / "tclab_pid_short_02.toml"))
    found = {(e.output, e.input): e.tf_plant for e in other.elements}
    names = ("temperature_1", "temperature_2"), ("heater_1", "heater_2")
    plant = TransferMatrix.of([[found[y, u] for u in names[1]] for y in names[0]], "s")
    assert [loop.recommended for loop in result.controllers] == ["certain-share"] * 2
    before, after = (law_of(result, method, None) for method in ("current", "certain-share"))
    for i in range(2):
        old, new = (loop_metrics(plant, law, output=i, input=i) for law in (before, after))
        # the promise was made for plants near that of the other run
        assert new.margins.Ms < 1.59 and new.margins.Mt < 1.59
        assert new.load.iae < 0.75 * old.load.iae
        assert new.setpoint.settling < 1.2 * old.setpoint.settling
        crossover = result.to_dict()["controllers"][i]["current"]["metrics"]["plant"]["crossover"]
        assert new.margins.phase_margin_frequency < 2.2 * crossover
