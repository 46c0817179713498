"""The declared controller against the OP that it wrote, summed up, limited and started in every way (simulated)."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import polars as pl
import pytest

import trueplant as tp
from support.historian import swinging_door
from support.laws import STARTS, SUMS, WINDUPS, Law, Loop, drawn
from support.retuned import DECLARED, PI_LAW, small
from trueplant import Project
from trueplant.errors import ProjectError
from trueplant.loop import PID, Controller, Linear, simulate
from trueplant.lti import TransferMatrix, tf
from trueplant.result import Code, ControllerCheck, LawRatio
from trueplant.study.data.by_hand import hand_notes
from trueplant.study.data.controller_check import _words, check_controllers
from trueplant.study.data.prepare import prepare

WRONG = [{"gain": 1.1}, {"gain": 0.9}, {"ti": 1.25}, {"ti": 0.75}]
PI = Law(Kc=2.0, Ti=40.0)


def checked(loop: Loop, frame: pl.DataFrame | None = None, **declared: Any) -> ControllerCheck:
    study = prepare(loop.project(**declared), frames=[loop.record() if frame is None else frame])
    return check_controllers(study)[0]


def ratios(check: ControllerCheck) -> dict[str, float]:
    return {r.name: r.value for r in check.ratios}


@pytest.mark.slow
@pytest.mark.parametrize("decade", range(30))
def test_a_right_law_is_confirmed_and_a_wrong_one_is_found_out(decade):
    """300 seeds over P, PI and PID, three sums, five wind-ups, derivative on error and PV, started at rest and not.

    With two manual stretches, 0.25 % of PV lost or wrong in the record alone, OP and PV rounded, OP at its limits. The
    200 with an integral are declared with another time, too.
    """
    for seed in range(10 * decade, 10 * decade + 10):
        loop = drawn(seed)
        study = prepare(loop.project(), frames=[loop.record()])
        right = check_controllers(study)[0]
        assert right.confirmed is True, f"{seed}: {right.message}"
        for declared in WRONG:
            if loop.law.Ti or "ti" not in declared:
                law = loop.project(**declared).controller(0)
                wrong = check_controllers(replace(study, records=replace(study.records, declared=(law,))))[0]
                assert wrong.confirmed is False, f"{seed}, {declared}: {wrong.message}"


@pytest.mark.parametrize("how", SUMS)
@pytest.mark.parametrize("windup", WINDUPS)
def test_each_sum_and_wind_up(how, windup):
    law = replace(PI, sum=how, windup=windup, Td=3.0, alpha=0.2, derivative_on="pv", start=STARTS[1])
    loop = Loop(law, gain=1.2, limits=(42.0, 60.0), offset=8.0, manual=((700, 900),), bad=0.0025, seed=3)
    frame = loop.record()
    assert 0.01 < np.mean(np.isin(frame["op"], (42.0, 60.0))) < 0.4
    right = checked(loop, frame)
    assert right.confirmed is True, right.message
    assert f"the integral a {how} sum" in right.message
    for declared in WRONG:
        wrong = checked(loop, frame, **declared)
        assert wrong.confirmed is False, wrong.message


def test_the_gains_and_times_found_are_those_of_the_law():
    wrong = checked(Loop(replace(PI, Td=4.0), seed=5), gain=0.8, ti=1.5)
    found = ratios(wrong)
    errors = {r.name: r.std_error for r in wrong.ratios}
    for name, true in {"gain": 1 / 0.8, "integral time": 1 / 1.5, "derivative time": 1.0}.items():
        assert found[name] == pytest.approx(true, abs=4 * errors[name]), wrong.message
    assert "is not what was declared" in wrong.message and "throughout" in wrong.message
    assert "has changed" not in wrong.message


@pytest.mark.parametrize(
    ("integral", "said"),
    [
        ((1.5, 0.02), "gain 0.40 ± 0.13, integral time 1.50 ± 0.02 times what is declared"),
        ((2.0, 0.8), "gain 0.40 ± 0.13, integral time 2.00 ± 0.80 times what is declared"),
        # its inverse is 0 but for its error: the number that it is by chance says nothing
        ((18596.0, 78848.0), "gain 0.40 ± 0.13 times what is declared, no integral action to be seen"),
        ((np.inf, np.inf), "gain 0.40 ± 0.13 times what is declared, no integral action to be seen"),
        # its inverse may be 0 as well as that of the declared one
        ((1.2, 2.0), "gain 0.40 ± 0.13 times what is declared, its integral time cannot be told"),
    ],
)
def test_an_integral_time_that_may_be_any_is_not_a_number(integral, said):
    assert _words([LawRatio("y", "gain", 0.4, 0.13), LawRatio("y", "integral time", *integral)]) == said


def test_what_is_told_of_several_outputs_names_them():
    some = [LawRatio("y", "gain", 0.4, 0.13), LawRatio("z", "integral time", np.inf, np.inf)]
    assert _words(some) == "gain from y 0.40 ± 0.13 times what is declared, no integral action from z to be seen"


@pytest.mark.parametrize(("pv_digits", "op_digits"), [(0.01, 0.01), (0.2, 0.1), (0.5, 0.1)])
def test_the_standard_errors_know_the_rounding(pv_digits, op_digits):
    """30 records with noise of 0.3: errors in standard errors have mean 0 and the usual size 1.

    Where few windows bear the information on the integral, single ones reach 5 (of 0.02 %).
    """
    loops = [
        Loop(PI, noise=0.3, pv_digits=pv_digits, op_digits=op_digits, samples=1500, seed=seed) for seed in range(30)
    ]
    found = [checked(loop).ratios for loop in loops]
    for k, name in enumerate(("gain", "integral time")):
        z = np.array([(one[k].value - 1) / one[k].std_error for one in found])
        assert [one[k].name for one in found] == [name] * 30
        assert abs(np.mean(z)) < 3 / np.sqrt(30), name
        assert 0.4 < 1.48 * np.median(np.abs(z)) < 1.4, name
        assert np.sum(np.abs(z) > 3) <= 2, name


def test_a_right_law_behind_a_pv_in_steps_of_three_times_its_noise_is_seldom_called_another():
    """Seeds 5000 to 5059: the steps of slow PVs make slow errors, of which gains are told with doubt, or not at all."""
    loops = [replace(one, pv_digits=3 * one.noise) for one in map(drawn, range(5000, 5060))]
    said = [checked(loop).confirmed for loop in loops]
    assert said.count(False) <= 3
    assert said.count(True) > 15


@pytest.mark.parametrize("declared_first", [True, False])
def test_another_tuning_is_dated(declared_first):
    """That a controller has changed is said where one part of the record is as declared, and another is not."""
    declared = Loop(PI, seed=7)
    other = replace(declared, law=replace(PI, Kc=2.6), seed=8)
    first, second = (loop.record() for loop in ((declared, other) if declared_first else (other, declared)))
    frame = pl.concat([first, second.with_columns(pl.col("t") + declared.samples)])
    found = checked(declared, frame)
    assert found.confirmed is False
    assert found.message.startswith("the controller has changed: ")
    at = float(re.search(r"until (\d+)" if declared_first else r"from (\d+)[. \w]* on the declared", found.message)[1])
    assert at == pytest.approx(declared.samples, abs=200)
    assert found.since == (at if declared_first else None)
    assert ratios(found)["gain"] > 1.05
    assert "it is gain 1.30" in found.message


@pytest.mark.parametrize(("on", "words"), [("pv", "the derivative on PV"), ("error", "the derivative on the error")])
def test_a_derivative_on_the_other_signal_is_named(on, words):
    loop = Loop(replace(PI, Td=6.0, derivative_on=on), seed=9)
    other = replace(loop, law=replace(loop.law, derivative_on="pv" if on == "error" else "error"))
    found = checked(other, loop.record())
    assert found.confirmed is False
    assert words in found.message


@pytest.mark.parametrize(("late", "words"), [("op", "from the last PV"), ("pv", "from the next PV")])
def test_a_column_that_was_recorded_a_sample_late_is_named_and_no_other_tuning(late, words):
    loop = Loop(PI)
    frame = loop.record()
    check = checked(loop, frame.with_columns(pl.col(late).shift(1).backward_fill()))
    assert words in check.message
    error = "short" if late == "op" else "long"
    assert check.confirmed is None
    assert check.message.endswith(f"{late.upper()} was recorded a sample late, dead times come out 1 too {error}")


def test_an_undeclared_integral_is_found_out():
    loop = Loop(PI, seed=11)
    found = checked(replace(loop, law=Law(Kc=2.0)), loop.record())
    assert found.confirmed is False, found.message


def test_an_op_that_hardly_moves_tells_nothing():
    loop = Loop(PI, size=0.0, noise=0.05, pv_digits=0.5, op_digits=0.5, seed=1)
    found = checked(loop)
    assert found.confirmed is None
    assert found.message.startswith("the controller cannot be checked: ")


def declared_loops(laws: Controller, plant: TransferMatrix, controllers: list[Mapping[str, Any]]) -> ControllerCheck:
    """The first OP of a loop with one or two outputs under `laws`, checked against what is declared."""
    n_y, n_u = plant.shape
    rng = np.random.default_rng(1)
    r = np.cumsum(rng.choice([-1.0, 0.0, 1.0], (2000, n_y), p=[0.005, 0.99, 0.005]), axis=0)
    made = simulate(plant, laws, r, 1.0, noise=0.05, quantisation=0.01, seed=2)
    columns = (
        {"t": made.t} | {f"sp{j}": made.r[:, j] for j in range(n_y)} | {f"pv{j}": made.y[:, j] for j in range(n_y)}
    )
    frame = pl.DataFrame(columns | {f"op{i}": np.round(made.u[:, i], 2) for i in range(n_u)})
    project = Project(
        time_unit="s",
        data={"files": ["loops.csv"], "time": "t"},
        output=[{"name": f"y{j}", "pv": f"pv{j}", "sp": f"sp{j}"} for j in range(n_y)],
        input=[{"name": f"u{i}", "op": f"op{i}"} for i in range(n_u)],
        model=[{"output": f"y{j}", "input": "u0", "tf": "1/(30 s + 1)"} for j in range(n_y)],
        controller=list(controllers),
    )
    return check_controllers(prepare(project, frames=[frame]))[0]


@pytest.mark.parametrize(("factor", "confirmed"), [("2", True), ("2.2", False)])
def test_a_transfer_function_is_checked_by_its_own_recursion(factor, confirmed):
    law = "(20 s + 1) (2 s + 1)/(20 s (0.5 s + 1))"
    entry = Linear(tf(f"2 {law}"), sample_time=1.0)
    plant = TransferMatrix.of([["exp(-3 s)/(30 s + 1)"]])
    declared = {"input": "u0", "output": "y0", "tf": f"{factor} {law}", "sample_time": 1.0}
    found = declared_loops(Controller.diagonal([entry]), plant, [declared])
    assert found.confirmed is confirmed, found.message


def test_two_outputs_that_write_one_op_are_told_apart():
    laws = Controller(
        {(0, 0): PID(Kc=1.5, Ti=30.0, sample_time=1.0), (0, 1): PID(Kc=0.6, Ti=50.0, sample_time=1.0)}, 1, 2
    )
    plant = TransferMatrix.of([["exp(-3 s)/(30 s + 1)"], ["0.4 exp(-5 s)/(20 s + 1)"]])
    right = [
        {"input": "u0", "output": "y0", "Kc": 1.5, "Ti": 30.0, "sample_time": 1.0},
        {"input": "u0", "output": "y1", "Kc": 0.6, "Ti": 50.0, "sample_time": 1.0},
    ]
    assert declared_loops(laws, plant, right).confirmed is True
    found = declared_loops(laws, plant, [right[0], right[1] | {"Kc": 0.72}])
    assert found.confirmed is False
    values = {(r.output, r.name): r.value for r in found.ratios}
    assert values.pop(("y1", "gain")) == pytest.approx(0.6 / 0.72, abs=0.01)
    assert len(values) == 3
    assert all(value == pytest.approx(1.0, abs=0.01) for value in values.values())


def test_a_slower_scan_is_found_by_when_op_moves():
    law = PID(Kc=1.5, Ti=30.0, sample_time=4.0)
    plant = TransferMatrix.of([["exp(-3 s)/(30 s + 1)"]])
    for declared, confirmed in (({}, True), ({"sample_time": 4.0}, True), ({"Kc": 1.9}, False)):
        table = {"input": "u0", "output": "y0", "Kc": 1.5, "Ti": 30.0} | declared
        found = declared_loops(Controller.diagonal([law]), plant, [table])
        assert found.confirmed is confirmed, found.message


def test_scans_that_are_no_whole_samples_cannot_be_checked():
    law = PID(Kc=1.5, Ti=30.0, sample_time=1.0)
    plant = TransferMatrix.of([["exp(-3 s)/(30 s + 1)"]])
    table = {"input": "u0", "output": "y0", "Kc": 1.5, "Ti": 30.0, "sample_time": 2.5}
    found = declared_loops(Controller.diagonal([law]), plant, [table])
    assert found.confirmed is None
    assert "whole multiple" in found.message


def test_what_is_not_replayed_is_named_as_why(tmp_path):
    """Half of the declared gain wrote OP: with a gap declared that may be why, without one the law is wrong."""
    wrong = DECLARED.replace("Kc = 1.0", "Kc = 2.0")
    plain = tp.run(small(tmp_path, "", wrong, law=PI_LAW)).to_dict()
    assert plain["methods"]["controller_consistency"][0]["confirmed"] is False
    result = tp.run(small(tmp_path, "", wrong + "gap = 0.5\n", law=PI_LAW)).to_dict()
    (check,) = result["methods"]["controller_consistency"]
    assert check["confirmed"] is None
    assert check["message"].startswith("the controller has a gap, which is not replayed and may be why")
    assert "closed-form" not in result["methods"]
    assert "a gap: (17) takes a linear law" in result["methods"]["not_applied"]["closed-form"]
    assert any("without a gap" in note["message"] for note in result["notes"])


def test_what_is_there_and_does_nothing_is_confirmed(tmp_path):
    for more in ("rate_limit = 1000\n", 'pv_filter = "1/(2 s + 1)"\nrecorded = "after"\n'):
        result = tp.run(small(tmp_path, "", DECLARED + more, law=PI_LAW)).to_dict()
        assert result["methods"]["controller_consistency"][0]["confirmed"] is True


def test_a_file_in_which_the_controller_was_retuned_is_two_experiments(tmp_path):
    """Simulated: the gain is 1 until 400 min and 0.5 from then on, in one file."""
    plant = TransferMatrix.of([["2 exp(-2 s)/(10 s + 1)"]], "min")
    frames = []
    for k, gain in enumerate((1.0, 0.5)):
        r = 50 + 4 * np.repeat(np.arange(8) % 2, 50)[:, None]
        law = Controller.diagonal([PID(Kc=gain, Ti=10.0, sample_time=1.0)])
        done = simulate(plant, law, r, 1.0, noise=0.05, seed=k, u0=40.0, y0=50.0)
        frames.append(
            pl.DataFrame(
                {"t": done.t[:400] + 400 * k, "sp": done.r[:400, 0], "pv": done.y[:400, 0], "op": done.u[:400, 0]}
            )
        )
    record = pl.concat(frames)

    def project(**tables: Any) -> Project:
        return Project(
            time_unit="min",
            output=[{"name": "y", "pv": "pv", "sp": "sp"}],
            input=[{"name": "u", "op": "op", "actuator": "other"}],
            model=[{"output": "y", "input": "u", "tf": "2 exp(-2 s)/(10 s + 1)"}],
            controller=[{"input": "u", "output": "y", "Kc": 1.0, "Ti": 10.0, "sample_time": 1.0}],
            **tables,
        )

    whole = check_controllers(prepare(project(data={"files": ["a"]}), frames=[record]))
    assert whole[0].confirmed is False and "two [[experiment]] entries" in whole[0].message
    assert whole[0].since == pytest.approx(400, abs=40)
    parts = [
        {"file": "a", "to": 400},
        {"file": "a", "from": 400, "controllers": [{"input": "u", "Kc": 0.5}]},
    ]
    study = prepare(project(experiment=parts), frames=[record, record])
    both = check_controllers(study)
    assert [(one.experiment, one.confirmed) for one in both] == [("a (to 400)", True), ("a (from 400)", True)]
    used = np.concatenate([segment.t for segment in study.segments])
    np.testing.assert_array_equal(used, np.arange(800))


def test_parts_of_a_file_are_in_order():
    with pytest.raises(ProjectError, match=r"experiment\[1\].*must come after from"):
        Project(
            time_unit="min",
            experiment=[{"file": "a", "from": 5, "to": 3}],
            output=[{"name": "y", "pv": "pv"}],
            input=[{"name": "u", "op": "op"}],
        )


@pytest.mark.parametrize("seed", range(3))
def test_a_controller_is_not_blamed_for_what_a_historian_left_out(seed):
    """It acted on the whole PV: what is left neither confirms nor refutes it."""
    loop = Loop(PI, seed=seed)
    frame = loop.record()
    frame = frame.with_columns(pl.Series("pv", swinging_door(frame["pv"].to_numpy(), 0.3)))
    right = checked(loop, frame)
    assert right.confirmed is None and "what a historian left out of y" in right.message


def test_a_stretch_in_manual_that_nobody_declared_is_no_other_tuning():
    """A hand moves OP every 25 samples there; the mode column says automatic throughout."""
    loop = Loop(PI, seed=5, manual=((800, 1400),), op_digits=0.001)
    study = prepare(loop.project(), frames=[loop.record().with_columns(mode=pl.lit(1))])
    found = check_controllers(study)[0]
    assert found.confirmed is True, found.message
    ((begin, end),) = found.by_hand
    assert begin == pytest.approx(800, abs=25) and end == pytest.approx(1400, abs=25)
    (note,) = hand_notes(study, [found])
    assert note.code is Code.MANUAL
    assert note.message.startswith(f"u looks to be in manual from {begin:.0f} to {end:.0f} s")


@pytest.mark.parametrize("digits", [0.01, 1.0, 5.0])
def test_a_coarse_op_is_not_in_manual(digits):
    """Of a law that is declared and of one with a third of its gain, which moves OP that much less."""
    for factor in (1.0, 3.0):
        loop = Loop(PI, seed=6, op_digits=digits, noise=0.05)
        assert checked(loop, gain=factor).by_hand == ()
