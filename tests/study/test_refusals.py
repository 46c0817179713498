"""Records that cannot answer, or not surely: refused or qualified by the whole analysis, each with its own sentence.

All records are simulated: one loop of 2 exp(-13.4 s)/(60 s + 1) under PI, or Wood-Berry under BLT PI.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

from support.historian import swinging_door
from support.simulated import BLT, WOOD_BERRY, coloured, random_switching
from support.two_loops import changed, written
from support.two_loops import project as two_loops
from trueplant import Loop, Project, Result, run
from trueplant.loop import PID, Controller, Simulation, simulate
from trueplant.lti import TransferMatrix

LAG = TransferMatrix.of([["2 exp(-13.4 s)/(60 s + 1)"]], "s")
PI = PID(Kc=1.0, Ti=60.0, sample_time=1.0)
SAMPLES = 2000


def one_loop(seed: int, size: float = 1.0, std: float = 0.1, **more: Any) -> Simulation:
    """One loop whose set-point switches between 0 and 2 * size, with an AR(1) disturbance."""
    rng = np.random.default_rng(seed)
    r = size * random_switching(rng, SAMPLES, 1, 100.0)
    v = coloured(rng, SAMPLES, 1, [1, -0.8], [1], std)
    return simulate(LAG, Controller.diagonal([PI]), r, 1.0, v=v, **more)


def columns_of(simulation: Simulation) -> dict[str, Any]:
    r, u, y = (x[:, 0] for x in (simulation.r, simulation.u, simulation.y))
    return {"t": simulation.t, "sp": r.copy(), "op": u.copy(), "pv": y.copy()}


def answered(folder: Path, columns: dict[str, Any], **of_input: Any) -> Result:
    """The analysis of one loop, its project and record written to files as a user would."""
    pl.DataFrame(columns).write_csv(folder / "record.csv")
    made = Project(
        time_unit="s",
        data={"files": ["record.csv"], "time": "t"},
        output=[{"name": "temperature", "pv": "pv"} | ({"sp": "sp"} if "sp" in columns else {})],
        input=[{"name": "heater", "op": "op", **of_input}],
        model=[{"output": "temperature", "input": "heater", "tf": "2 exp(-13.4 s)/(60 s + 1)"}],
    )
    (folder / "project.toml").write_text(made.to_toml())
    return run(folder / "project.toml")


def refusals(result: Result, code: str) -> list[str]:
    """The sentences of a refusal, which goes with no verdict about any element."""
    assert result.status == "refused"
    assert {e.verdict for e in result.elements} <= {"not identifiable"}
    return [reason.message for reason in result.reasons if reason.code == code]


def notes(result: Result, code: str) -> list[str]:
    return [note.message for note in result.notes if note.code == code]


def covers(result: Result, wide: float = 4.0) -> bool:
    """Do all estimates of the one loop lie within so many standard errors of the truth?"""
    parameters = zip(result.elements[0].parameters, [2.0, 60.0, 13.4], strict=True)
    return all(abs(p.plant - true) < wide * p.std_error for p, true in parameters)


def test_an_excellent_direct_fit_of_a_loop_at_rest_is_refused(tmp_path):
    """A slow disturbance drives OP, and from OP a model foretells PV almost perfectly: it is -1/Q, not the plant.

    Disturbance of pole 0.99, a P controller: PV = r - OP/Kc, so that the static gain of the best fit is -1/Kc while
    the plant's is +2.
    """
    rng = np.random.default_rng(3)
    v = coloured(rng, SAMPLES, 1, [1, -0.99], [1], 1.0)
    law = Controller.diagonal([PID(Kc=0.8, sample_time=1.0)])
    record = columns_of(simulate(LAG, law, np.zeros((SAMPLES, 1)), 1.0, v=v))
    slope, _ = np.polyfit(record["op"], record["pv"], 1)
    assert slope == pytest.approx(-1 / 0.8, rel=1e-6)
    assert np.var(record["pv"] - slope * record["op"]) < 1e-12 * np.var(record["pv"])
    (sentence,) = refusals(answered(tmp_path, record), "no-excitation")
    assert "no set-point changes" in sentence and "-1/Q" in sentence
    assert "use a record in which the set-points were moved" in sentence


@pytest.mark.parametrize("level", [0.0, 60.0])
def test_a_constant_setpoint_is_refused_at_any_level(tmp_path, level):
    record = columns_of(one_loop(4, size=0.0))
    record["sp"] += level
    record["pv"] += level
    (sentence,) = refusals(answered(tmp_path, record), "no-excitation")
    assert "no set-point changes" in sentence


STRUCTURES = ["fopdt", "sopdt", "sopdt+lead", "pair", "integrator", "integrator+lag", "sopdt+delayed", None]


@pytest.mark.parametrize("structure", [*STRUCTURES, "no model"])
@pytest.mark.parametrize("stamps", ["even", "irregular", "printed"])
def test_a_constant_setpoint_is_refused_with_the_right_reason(structure, stamps):
    """Whatever the element may be, with a model and without, and however the record is sampled and printed."""
    record = columns_of(one_loop(13, size=0.0, std=1.0))
    rng = np.random.default_rng(13)
    record["sp"] = record["sp"] + 60.1 + np.spacing(60.1) * rng.integers(-1, 2, SAMPLES)
    record["pv"] = record["pv"] + 60.1
    if stamps == "printed":
        record = {name: np.round(x, 3) for name, x in record.items()}
    if stamps == "irregular":
        record["t"] = record["t"] + rng.uniform(-0.3, 0.3, SAMPLES)
    tf = {"integrator": "0.03 exp(-13 s)/s", "integrator+lag": "0.03 exp(-13 s)/(s (60 s + 1))"}
    model = {"tf": tf.get(str(structure), "2 exp(-13.4 s)/(60 s + 1)")}
    model |= {} if structure is None else {"structure": structure}
    loops = [Loop("T", pv="pv", sp="sp", op="op")]
    result = run(record, loops=loops, model=None if structure == "no model" else {("T", "T"): model}, time_unit="s")
    assert result.status == "refused"
    (reason,) = result.reasons
    assert reason.code == "no-excitation" and reason.message.startswith("no set-point changes in these data")


FLICKER = {"none": (0.0, 3), "of a digit": (0.1, 1), "of a quantum": (0.25, 3)}
"""By how much a set-point flickers, and with how many digits all is printed."""


@pytest.mark.parametrize("stamps", ["even", "irregular"])
@pytest.mark.parametrize("flicker", FLICKER)
@pytest.mark.parametrize("structure", ["fopdt", "integrator", None, "no model"])
def test_flicker_beside_a_move_that_is_left_out_is_no_setpoint_change(tmp_path, structure, flicker, stamps):
    """The only real move of a set-point is excluded; what is left of it is one step of what the record resolves."""
    record, rng = columns_of(one_loop(13, size=0.0, std=1.0)), np.random.default_rng(13)
    step, digits = FLICKER[flicker]
    moved = 5.0 * (record["t"] >= 1500)
    record["sp"] = record["sp"] + 60.0 + step * rng.integers(0, 2, SAMPLES) + moved
    record["pv"] = record["pv"] + 60.0
    if flicker == "of a quantum":
        record["pv"] = 0.25 * np.round(record["pv"] / 0.25)
    record = {name: np.round(x, digits) for name, x in record.items()}
    if stamps == "irregular":
        record["t"] = record["t"] + rng.uniform(-0.3, 0.3, SAMPLES)
    pl.DataFrame(record).write_csv(tmp_path / "record.csv")
    tf = "0.03 exp(-13 s)/s" if structure == "integrator" else "2 exp(-13.4 s)/(60 s + 1)"
    element = {"output": "T", "input": "Q", "tf": tf} | ({} if structure is None else {"structure": structure})
    made = Project(
        time_unit="s",
        data={"files": ["record.csv"], "time": "t", "exclude": [{"from": 1490, "to": SAMPLES}]},
        output=[{"name": "T", "pv": "pv", "sp": "sp"}],
        input=[{"name": "Q", "op": "op"}],
        model=[] if structure == "no model" else [element],
    )
    result = run(Project.from_toml(made.to_toml(), tmp_path))
    assert result.status == "refused"
    (reason,) = result.reasons
    assert reason.code == "no-excitation" and reason.message.startswith("no set-point changes in these data")
    (moves,) = result.result.data[0].setpoints
    assert moves.moves == 1  # of the whole record


def test_a_setpoint_that_was_not_recorded_is_asked_for(tmp_path):
    record = columns_of(one_loop(5))
    del record["sp"]
    (sentence,) = refusals(answered(tmp_path, record), "no-excitation")
    assert "no set-point was recorded" in sentence and "add the set-point columns" in sentence


def two_setpoints(seed: int, sizes: np.ndarray) -> Simulation:
    """Wood-Berry whose set-points change at the same instants, every 20 samples; sizes (n, 2) of the levels."""
    v = coloured(np.random.default_rng(seed), 20 * len(sizes), 2, [1, -0.8], [1], 0.3)
    return simulate(WOOD_BERRY, BLT, np.repeat(sizes, 20, axis=0), 1.0, v=v)


def test_setpoints_at_the_same_instants_by_unrelated_amounts_are_answered(tmp_path):
    """The same instants are no fault: only the same proportion is, of which `test_study` has the note."""
    sizes = np.random.default_rng(11).uniform(-1.5, 1.5, (125, 2))
    sizes[0] = 0
    written(tmp_path, "record.csv", two_setpoints(11, sizes))
    unrelated = run(two_loops(tmp_path))
    written(tmp_path, "record.csv", two_setpoints(11, sizes[:, :1] * np.array([1.0, 0.5])))
    proportional = run(two_loops(tmp_path))
    assert unrelated.status != "refused" and not changed(unrelated)
    assert not notes(unrelated, "setpoint-rank")
    (sentence,) = notes(proportional, "setpoint-rank")
    assert "always move in the same proportion" in sentence and "(17)-(20) cannot be used" in sentence
    # The direction that the set-points leave out is paid for: here by the gains from steam.
    sure, less = (
        [e.parameters[0].std_error for e in x.elements if e.input == "steam"] for x in (unrelated, proportional)
    )
    assert all(b > 1.5 * a for a, b in zip(sure, less, strict=True))
    for element, true in zip(unrelated.elements, [12.8, -18.9, 6.6, -19.4], strict=True):
        assert abs(element.parameters[0].plant - true) < 4 * element.parameters[0].std_error


def test_an_op_at_its_limit_most_of_the_time_is_used_where_the_record_has_the_moves(tmp_path):
    simulation = one_loop(6, size=1.0, limits=np.array([[-0.1, 0.5]]))
    at = float(np.mean((simulation.u <= -0.1) | (simulation.u >= 0.5)))
    assert 0.5 < at < 0.95
    result = answered(tmp_path, columns_of(simulation), limits=[-0.1, 0.5])
    assert result.elements[0].verdict == "unchanged" and covers(result)
    (sentence,) = notes(result, "cause-valve-saturated")
    assert f"OP stood at a limit, or beyond it, in {100 * at:.2g} % of the samples" in sentence


def test_setpoints_that_an_op_at_its_limit_could_not_follow_are_no_excitation(tmp_path):
    """The disturbance needs all that OP can give: the set-points move, and nothing in the plant does."""
    rng = np.random.default_rng(12)
    late = np.arange(SAMPLES) >= 600
    r = random_switching(rng, SAMPLES, 1, 100.0) * late[:, None]
    v = coloured(rng, SAMPLES, 1, [1, -0.8], [1], 1.0)
    v[300:] += 30.0
    simulation = simulate(LAG, Controller.diagonal([PI]), r, 1.0, v=v, limits=np.array([[0.0, 9.0]]))
    (sentence,) = refusals(answered(tmp_path, columns_of(simulation), limits=[0.0, 9.0]), "no-excitation")
    assert "the set-points move too little" in sentence
    assert "OP of heater was at a limit or in manual for" in sentence and "and followed nothing" in sentence


def test_an_op_at_its_limit_now_and_then_is_used_and_said(tmp_path):
    """What is at the limit is still what moved the plant."""
    simulation = one_loop(6, limits=np.array([[-0.5, 1.4]]))
    at = float(np.mean((simulation.u <= -0.5) | (simulation.u >= 1.4)))
    assert 0.02 < at < 0.4
    result = answered(tmp_path, columns_of(simulation), limits=[-0.5, 1.4])
    assert result.elements[0].verdict == "unchanged" and covers(result)
    assert result.to_dict()["data"][0]["saturated_share"]["heater"] == pytest.approx(at, abs=1e-3)
    (finding,) = [f for f in result.to_dict()["data"][0]["findings"] if f["kind"] == "saturated"]
    assert f"at a limit for {100 * at:.3g} %" in finding["message"]


def test_an_op_that_runs_on_beyond_its_limit_is_taken_as_far_as_what_it_moves(tmp_path):
    """The valve is at its end, and a controller without anti-windup writes on; taken at its word, OP did nothing."""
    simulation = one_loop(6, limits=np.array([[-0.5, 1.4]]))
    columns = columns_of(simulation)
    there = columns["op"] >= 1.4
    columns["op"][there] += 0.8 * (columns["sp"] - columns["pv"])[there].clip(0)
    assert 0.05 < float(np.mean(columns["op"] > 1.5)) < 0.4
    result = answered(tmp_path, columns, limits=[-0.5, 1.4])
    assert result.elements[0].verdict == "unchanged" and covers(result)
    said = [f["message"] for f in result.to_dict()["data"][0]["findings"] if f["kind"] == "saturated"]
    assert said[-1].endswith("PV answers as if it had stayed at them: so it is taken.")


@pytest.mark.parametrize("limits", [[-0.2, 1.0], [2.0, 3.0]])
def test_limits_that_op_was_not_held_to_change_nothing(tmp_path, limits):
    """They are those of a test to be planned, or of another unit."""
    columns = columns_of(one_loop(6))
    assert np.mean(columns["op"] > 1.1) > 0.1
    result = answered(tmp_path, columns, limits=limits)
    assert result.elements[0].verdict == "unchanged" and covers(result)
    said = [f["message"] for f in result.to_dict()["data"][0]["findings"] if f["kind"] == "saturated"]
    assert said[-1].endswith("PV answers as if it had gone on: it is taken as recorded.")


def test_samples_that_were_left_out_are_not_said_to_have_been_at_a_limit(tmp_path):
    columns = columns_of(one_loop(6, limits=np.array([[-9.0, 9.0]])))
    columns["op"][900:1100] = 9.0
    answered(tmp_path, columns, limits=[-9.0, 9.0])
    text = (tmp_path / "project.toml").read_text()
    (tmp_path / "project.toml").write_text(text + "\n[[data.exclude]]\nfrom = 880\nto = 1200\n")
    assert notes(run(tmp_path / "project.toml"), "cause-valve-saturated") == []


def test_a_trip_does_not_hide_what_the_set_points_show(tmp_path):
    """OP is cut by hand for a tenth of the record, by many times what the controller moves it."""
    columns = columns_of(one_loop(17, size=0.3, std=0.05))
    cut = np.zeros((SAMPLES, 1))
    cut[900:1100] = -40.0
    columns["op"] += cut[:, 0]
    columns["pv"] += simulate(LAG, None, np.zeros_like(cut), 1.0, u=cut).y[:, 0]
    result = answered(tmp_path, columns)
    assert result.status == "ok" and covers(result)


def test_a_pv_that_is_frozen_all_the_time_is_refused(tmp_path):
    record = columns_of(one_loop(7))
    record["pv"][:] = 50.0
    (sentence,) = refusals(answered(tmp_path, record), "record")
    assert "PV of temperature is frozen all the time" in sentence and "check the sensor or the tag" in sentence


def test_a_pv_that_froze_for_a_while_is_left_out_there_and_said(tmp_path):
    """Left in, a thousand samples of it would halve the gain."""
    simulation = one_loop(8)
    record = columns_of(simulation)
    record["pv"][600:1000] = record["pv"][600]
    result = answered(tmp_path, record)
    assert result.elements[0].verdict == "unchanged" and covers(result)
    assert result.to_dict()["data"][0]["usable_share"]["temperature"] == pytest.approx(1 - 400 / SAMPLES, abs=2e-3)
    (finding,) = [f for f in result.to_dict()["data"][0]["findings"] if f["kind"] == "frozen"]
    assert "stood still" in finding["message"] and "left out" in finding["message"] and finding["excludes"]


def in_manual(seed: int, share: float) -> dict[str, Any]:
    """A record whose last part was run by hand: OP stays where it was, PV follows it."""
    simulation = one_loop(seed)
    begin = round(SAMPLES * (1 - share))
    u = simulation.u.copy()
    u[begin:] = u[begin - 1]
    v = coloured(np.random.default_rng(seed), SAMPLES, 1, [1, -0.8], [1], 0.1)
    by_hand = simulate(LAG, None, simulation.r, 1.0, u=u, v=v)
    return columns_of(by_hand) | {"mode": np.where(np.arange(SAMPLES) < begin, "AUTO", "MAN")}


def test_a_loop_in_manual_most_of_the_time_is_used(tmp_path):
    """By hand OP is as true an input as any; the set-points of the rest have to tell."""
    result = answered(tmp_path, in_manual(9, 0.7), mode="mode", automatic_values=["AUTO"])
    assert result.elements[0].verdict == "unchanged" and covers(result)
    (finding,) = [f for f in result.to_dict()["data"][0]["findings"] if f["kind"] == "manual"]
    assert finding["message"] == "heater was in manual for 70 % of the record."
    (said,) = notes(result, "manual")
    assert "name the values that mean automatic" in said


def test_a_loop_in_manual_for_a_while_is_used_and_said(tmp_path):
    result = answered(tmp_path, in_manual(9, 0.2), mode="mode", automatic_values=["AUTO"])
    assert result.elements[0].verdict == "unchanged" and covers(result)
    (finding,) = [f for f in result.to_dict()["data"][0]["findings"] if f["kind"] == "manual"]
    assert finding["message"] == "heater was in manual for 20 % of the record."
    assert not notes(result, "manual")


def test_a_loop_in_no_known_mode_is_said_and_is_no_error(tmp_path):
    """Codes of modes that nobody has explained count as not automatic, all the time."""
    record = in_manual(9, 0.5) | {"mode": np.where(np.arange(SAMPLES) < 500, 16, 4)}
    result = answered(tmp_path, record, mode="mode")
    found = {f["kind"]: f["message"] for f in result.to_dict()["data"][0]["findings"]}
    assert f"4 ({SAMPLES - 500})" in found["mode"] and "16 (500)" in found["mode"]
    assert "nothing is automatic" in found["mode"] and "Name those of them that are" in found["mode"]
    assert found["manual"] == "heater was in manual for 100 % of the record."


def test_a_pv_that_answers_to_nothing_is_said_to(tmp_path):
    """PV and OP are not those of one loop: no first model, and where to look."""
    columns, other = columns_of(one_loop(9)), columns_of(one_loop(10))
    pl.DataFrame(columns | {"pv": other["pv"], "sp": other["sp"]}).write_csv(tmp_path / "r.csv")
    loop = Loop("T", pv="pv", sp="sp", op="op")
    result = run(pl.read_csv(tmp_path / "r.csv"), loops=[loop], time_unit="s")
    assert result.status == "refused"
    assert "see whether PV, SP and OP are the columns that they are called" in result.headline


@pytest.mark.parametrize("digits", [12, 4])
def test_compressed_signals_are_answered_qualified_or_refused(tmp_path, digits):
    """Deviations in standard deviations of what the disturbance does to PV (0.1) and, about, to OP."""
    whole = columns_of(one_loop(10))

    def through_historian(pv: float, op: float) -> Result:
        stored = {"pv": swinging_door(whole["pv"], pv), "op": swinging_door(whole["op"], op)}
        return answered(tmp_path, whole | {name: np.round(x, digits) for name, x in stored.items()})

    lightly = through_historian(0.005, 0.005)
    assert covers(lightly) and not notes(lightly, "compressed")
    assert sum(f["kind"] == "compressed" for f in lightly.to_dict()["data"][0]["findings"]) == 2
    (sentence,) = notes(through_historian(0.07, 0.0), "compressed")
    assert "a historian stored only part of temperature" in sentence
    assert "Export the record without compression" in sentence
    (sentence,) = refusals(through_historian(0.3, 0.0), "record")
    assert "PV of temperature was compressed by its historian" in sentence
    (sentence,) = refusals(through_historian(0.0, 0.3), "record")
    assert "OP of heater was compressed by its historian" in sentence
    assert "what moved the plant is not in the record" in sentence
