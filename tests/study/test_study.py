"""The whole analysis on simulated records: what it finds, what it leaves alone, what it refuses."""

from __future__ import annotations

import re

import numpy as np
import pytest

from support.chance import most
from support.simulated import BLT, WOOD_BERRY, coloured, random_switching, segment_of, wood_berry
from support.two_loops import CONTROLLERS, changed, project, scaled, written
from trueplant import Project, run
from trueplant.detect import verdicts
from trueplant.loop import PID, Controller, Step, simulate
from trueplant.lti import TransferMatrix, sampled_response
from trueplant.result import Source

FEED = TransferMatrix.of([["3.8 exp(-8.1 s)/(14.9 s + 1)"], ["4.9 exp(-3.4 s)/(13.2 s + 1)"]])


def test_the_one_element_that_changed_is_found(tmp_path):
    written(tmp_path, "record.csv", wood_berry(3, plant=scaled(1, 0, 1.3)))
    result = run(project(tmp_path, controller=CONTROLLERS))
    assert changed(result) == {("reflux", "bottom")}
    gain = next(e for e in result.elements if e.verdict == "changed").parameters[0]
    assert gain.changed
    assert gain.ci[0] < 6.6 * 1.3 < gain.ci[1]
    assert "reflux -> bottom" in result.headline


@pytest.mark.slow
def test_a_changed_disturbance_is_no_mismatch():
    """80 seeded runs, at most 9 alarms: passes with 0.993 at the level of 5 %, with 0.029 at 20 %."""
    alarms = 0
    for seed in range(7, 87):
        rng = np.random.default_rng(seed)
        v = coloured(rng, 1500, 2, [1, -1.7, 0.72], [1], 0.6)
        record = segment_of(simulate(WOOD_BERRY, BLT, random_switching(rng, 1500, 2, 20.0), 1.0, v=v))
        alarms += any(found.verdict == "changed" for found in verdicts([record], WOOD_BERRY).values())
    assert alarms <= most(80, 0.05)


def test_another_controller_is_said_and_is_no_mismatch(tmp_path):
    written(tmp_path, "record.csv", wood_berry(5))
    wrong = [CONTROLLERS[0] | {"Kc": 0.2}, CONTROLLERS[1]]
    result = run(project(tmp_path, controller=wrong))
    assert not changed(result)
    notes = [note for note in result.notes if note.code == "controller"]
    assert len(notes) == 1
    assert "reflux" in notes[0].where


def test_the_updated_model_is_unchanged_on_the_same_record(tmp_path):
    written(tmp_path, "record.csv", wood_berry(4, plant=scaled(0, 1, 0.7)))
    first = run(project(tmp_path))
    assert changed(first) == {("steam", "top")}
    assert not changed(run(first.save(tmp_path / "updated")["plant.toml"]))


def test_no_setpoint_change_is_refused(tmp_path):
    rng = np.random.default_rng(1)
    v = coloured(rng, 1500, 2, [1, -0.9], [1], 0.5)
    written(tmp_path, "record.csv", simulate(WOOD_BERRY, BLT, np.zeros((1500, 2)), 1.0, v=v))
    result = run(project(tmp_path))
    assert result.status == "refused"
    assert "-1/Q" in result.reasons[0].message


def test_setpoints_in_proportion_are_qualified(tmp_path):
    rng = np.random.default_rng(2)
    r = random_switching(rng, 2000, 1, 20.0) * np.array([1.0, 0.5])
    v = coloured(rng, 2000, 2, [1, -0.8], [1], 0.3)
    written(tmp_path, "record.csv", simulate(WOOD_BERRY, BLT, r, 1.0, v=v))
    result = run(project(tmp_path))
    assert any(note.code == "setpoint-rank" for note in result.notes)


def test_a_measured_disturbance_whose_own_model_has_drifted(tmp_path):
    rng = np.random.default_rng(9)
    samples = 4000
    d = 0.3 * random_switching(rng, samples, 1, 40.0)
    # A measured disturbance runs on between samples: its effect is that of the piecewise-linear signal.
    v = coloured(rng, samples, 2, [1, -0.8], [1], 0.2) + sampled_response(FEED, d, 1.0, "linear")
    simulation = simulate(WOOD_BERRY, BLT, random_switching(rng, samples, 2, 20.0), 1.0, v=v)
    written(tmp_path, "record.csv", simulation, feed=d[:, 0])
    elements = [
        {"output": "top", "input": "feed", "tf": "3.0 exp(-8.1 s)/(14.9 s + 1)"},
        {"output": "bottom", "input": "feed", "tf": "4.9 exp(-3.4 s)/(13.2 s + 1)"},
    ]
    tables = {"disturbance": [{"name": "feed", "column": "feed"}], "more_elements": elements}
    result = run(project(tmp_path, **tables))
    assert changed(result) == {("feed", "top")}
    gain = next(e for e in result.elements if e.verdict == "changed").parameters[0]
    assert abs(gain.plant - 3.8) < 4 * gain.std_error


def test_open_and_closed_experiments_together(tmp_path):
    rng = np.random.default_rng(12)
    written(tmp_path, "closed.csv", wood_berry(16))
    u = 0.5 * (random_switching(rng, 1200, 2, 25.0) - 1)
    v = coloured(rng, 1200, 2, [1, -0.8], [1], 0.3)
    written(tmp_path, "open.csv", simulate(WOOD_BERRY, None, np.zeros((1200, 2)), 1.0, u=u, v=v))
    together = run(project(tmp_path, experiment=[{"file": "closed.csv"}, {"file": "open.csv", "loop": "open"}]))
    alone = run(project(tmp_path, experiment=[{"file": "closed.csv"}]))
    assert not changed(together)
    assert "open-loop response" in together.to_dict()["methods"]
    assert "joint" in {**together.to_dict()["methods"], **together.to_dict()["methods"]["not_applied"]}
    for both, one in zip(together.elements, alone.elements, strict=True):
        # what two experiments may differ by is part of the one, and cannot be of the other
        between = sum(part.share for part in both.budget[0].parts if part.source is Source.EXPERIMENTS)
        assert both.parameters[0].std_error * np.sqrt(1 - between) < one.parameters[0].std_error


def test_a_load_that_nobody_recorded_is_dated_and_sized_and_is_no_mismatch(tmp_path):
    rng = np.random.default_rng(21)
    v = coloured(rng, 1500, 2, [1, -0.8], [1], 0.2)
    step = Step(700.0, (0.0, 0.1))
    record = simulate(WOOD_BERRY, BLT, random_switching(rng, 1500, 2, 60.0), 1.0, v=v, input_disturbance=[step])
    written(tmp_path, "record.csv", record)
    result = run(project(tmp_path))
    assert not changed(result)
    (note,) = (note for note in result.notes if note.code == "load-step")
    at, size, half = map(float, re.search(r"at ([\d.]+) min like steam by (\S+) ± ([\d.]+)", note.message).groups())
    assert abs(at - 700) <= 5 and abs(size - 0.1) < 2 * half < 0.05
    steps = [{"output": name, "kind": "step", "std": 0.1} for name in ("top", "bottom")]
    declared = run(project(tmp_path, unmeasured=steps))
    assert not [note for note in declared.notes if note.code == "load-step"]


def test_an_element_that_the_model_lacks_is_found_when_asked_for(tmp_path):
    written(tmp_path, "record.csv", wood_berry(14))
    made = project(tmp_path)
    elements = [e.model_dump(exclude_unset=True) for e in made.model]
    elements[2] |= {"tf": "0", "structure": "fopdt"}
    tables = made.model_dump(by_alias=True, exclude_unset=True) | {"model": elements}
    result = run(Project.from_toml(Project(**tables).to_toml(), tmp_path))
    found = next(e for e in result.elements if (e.input, e.output) == ("reflux", "bottom"))
    assert found.verdict == "changed"
    assert abs(found.parameters[0].plant - 6.6) < 4 * found.parameters[0].std_error
    assert found.parameters[1].model is None


def test_an_element_that_was_left_out_is_named_and_estimated_along(tmp_path):
    written(tmp_path, "record.csv", wood_berry(15))
    made = project(tmp_path)
    elements = [e.model_dump(exclude_unset=True) for e in made.model]
    tables = made.model_dump(by_alias=True, exclude_unset=True) | {"model": elements[:2] + elements[3:]}
    result = run(Project.from_toml(Project(**tables).to_toml(), tmp_path))
    notes = [note.message for note in result.notes if note.code == "missing-element"]
    assert len(notes) == 1 and notes[0].startswith("reflux moves bottom,")
    assert "cause-plant" not in {note.code for note in result.notes}
    (element,) = (e for e in result.elements if e.input == "reflux" and e.output == "bottom")
    assert element.verdict == "changed" and element.tf_model == "0"
    gain = element.parameters[0]
    assert abs(gain.plant - 6.6) < 4 * gain.std_error and gain.std_error < 0.5


def with_absent_element_asked_for(folder, seed):
    """The result of a plant and a model without the element from steam to top, which is asked for."""
    plant = TransferMatrix(((WOOD_BERRY[0, 0], WOOD_BERRY[0, 1] * 0.0), WOOD_BERRY.elements[1]))
    written(folder, "record.csv", wood_berry(seed, samples=1500, plant=plant))
    made = project(folder)
    elements = [e.model_dump(exclude_unset=True) for e in made.model]
    elements[1] |= {"tf": "0", "structure": "fopdt"}
    tables = made.model_dump(by_alias=True, exclude_unset=True) | {"model": elements}
    return run(Project.from_toml(Project(**tables).to_toml(), folder))


@pytest.mark.slow
def test_false_alarms_are_rare_also_where_an_absent_element_is_asked_for(tmp_path):
    """80 seeded runs, at most 9 alarms, of that element and of the others: passes with 0.993 at the level of 5 %,
    with 0.029 at 20 %.
    """
    found = [changed(with_absent_element_asked_for(tmp_path, 400 + k)) for k in range(80)]
    assert sum(("steam", "top") in one for one in found) <= most(80, 0.05)
    assert sum(bool(one - {("steam", "top")}) for one in found) <= most(80, 0.05)


def test_an_absent_element_that_comes_out_as_zero_has_a_band(tmp_path):
    assert with_absent_element_asked_for(tmp_path, 417).status == "ok"


@pytest.mark.slow
def test_a_disturbance_that_reaches_both_outputs_is_said_and_raises_no_alarm(tmp_path):
    """Wood-Berry's own feed disturbance, unmeasured: with one noise model an output 6 of 20 such records, three
    times as long, raise one.

    80 seeded runs, at most 9 alarms: passes with 0.993 at the level of 5 %, with 0.029 at 20 %. All of them say that
    the disturbance is shared; where the joint fit does not help, intervals are widened instead.
    """
    alarms = apart = 0
    for seed in range(70, 150):
        rng = np.random.default_rng(seed)
        feed = coloured(rng, 1000, 1, [1, -0.9], [1], 0.3)[:, 0]
        v = np.column_stack([sampled_response(FEED[i, 0], feed, 1.0, "linear") for i in range(2)])
        v += coloured(rng, 1000, 2, [1], [1], 0.05)
        written(tmp_path, "record.csv", simulate(WOOD_BERRY, BLT, random_switching(rng, 1000, 2, 20.0), 1.0, v=v))
        result = run(project(tmp_path))
        alarms += bool(changed(result))
        said = [note.message for note in result.notes if note.code == "crossed"]
        assert said
        apart += not any("together" in message for message in said)
    assert alarms <= most(80, 0.05)
    assert apart <= most(80, 0.05)


def test_independent_disturbances_are_not_said_to_be_crossed(tmp_path):
    written(tmp_path, "record.csv", wood_berry(31))
    assert not any(note.code == "crossed" for note in run(project(tmp_path)).notes)


def test_a_scan_faster_than_the_record_widens_the_dead_time(tmp_path):
    rng = np.random.default_rng(5)
    fine = [PID(Kc=0.375, Ti=8.29, sample_time=0.1), PID(Kc=-0.0754, Ti=23.6, sample_time=0.1)]
    r = np.repeat(random_switching(rng, 2000, 2, 20.0), 10, axis=0)
    v = np.repeat(coloured(rng, 2000, 2, [1, -0.8], [1], 0.2), 10, axis=0)
    simulation = simulate(WOOD_BERRY, Controller.diagonal(fine), r, 0.1, v=v, record_every=10)
    written(tmp_path, "record.csv", simulation)
    result = run(project(tmp_path, controller=[law | {"sample_time": 0.1} for law in CONTROLLERS]))
    assert any(note.code == "scan" for note in result.notes)
    for found, true in zip(result.elements, [1.4, 3.4, 7.4, 3.4], strict=True):
        low, high = found.parameters[2].ci
        assert low < true < high


def test_margins_on_model_and_plant(tmp_path):
    """Splitter, vaporisation loop: GM 4.47, PM 60.6 deg, Ms 1.398 with a continuous controller (simulated plant)."""
    from trueplant import plants

    case = plants.splitter()
    assert case.plant is not None
    r = random_switching(np.random.default_rng(3), 3000, 2, 300.0)
    simulation = simulate(case.plant, case.controller, r, 0.1, noise=0.05, seed=3)
    written(tmp_path, "record.csv", simulation)
    made = project(tmp_path, case.model)
    tables = made.model_dump(by_alias=True, exclude_unset=True)
    tables["model"] = [e for e in tables["model"] if e["tf"] != "0"]
    tables["controller"] = [
        {"input": "reflux", "output": "top", "Kc": 1.0, "Ti": 8.0, "Td": 0.5, "alpha": 0.1, "action": "direct"},
        {"input": "steam", "output": "bottom", "Kc": 0.5, "Ti": 2.0},
    ]
    result = run(Project.from_toml(Project(**tables).to_toml(), tmp_path))
    rows = {name: found[1] for name, found in result.to_dict()["robustness"]["margins"].items()}
    assert abs(rows["model"]["gain_margin"] - 4.47) < 0.01
    assert abs(rows["model"]["phase_margin"] - 60.6) < 0.1
    assert abs(rows["model"]["Ms"] - 1.398) < 0.001
    assert abs(rows["plant"]["Ms"] - 1.398) < 0.05
    assert result.to_dict()["robustness"]["worse"] == []


@pytest.mark.slow
@pytest.mark.parametrize(("variant", "peak"), [("printed", 4.964), ("eq37", 1.426)])
def test_the_mill_loses_robust_performance(tmp_path, variant, peak):
    """Paper, Figure 4 and theory: 0.9728 at 0.889 rad/min on the model; the plants' values are the limits at rest.

    Simulated without noise, so that the plant is found to rounding.
    """
    from trueplant import plants

    case = plants.mill(variant)
    assert case.plant is not None
    h = 0.037
    r = random_switching(np.random.default_rng(1), 8000, 2, 5 / h)
    written(tmp_path, "record.csv", simulate(case.plant, case.controller, r, h))
    law = [{"input": "reflux", "output": "top", "Kc": -2.0, "Ti": 3.3}]
    law.append({"input": "steam", "output": "bottom", "Kc": 0.42, "Ti": 5.2})
    weights = {"wI": {"gain_percent": 10.0, "dead_time": 0.2}, "wP": "(0.45 s + 0.05)/s"}
    result = run(project(tmp_path, case.model, controller=law, robustness=weights))
    model, plant = result.to_dict()["robustness"]["peaks"]["model"], result.to_dict()["robustness"]["peaks"]["plant"]
    assert abs(model["RP"]["upper"] - 0.9728) < 1e-4
    assert abs(model["RP"]["frequency"] - 0.889) < 2e-3
    assert model["robust_performance_holds"]
    assert abs(plant["RP"]["upper"] - peak) < 2e-3
    assert plant["RP"]["frequency"] == 0.0
    assert any(note.code == "robust-performance" for note in result.notes)
