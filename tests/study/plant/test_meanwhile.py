"""Plant and disturbance told apart in whole analyses of simulated records in which one of them changes."""

from __future__ import annotations

import numpy as np
import polars as pl
import pytest

from support.changing import changing_loop, changing_wood_berry, write_project
from support.simulated import coloured, random_switching
from trueplant import Project, run
from trueplant.loop import PID, Controller, Step, simulate
from trueplant.lti import TransferMatrix

PLANT = TransferMatrix.of([["2 exp(-3.3 s)/(10 s + 1)"]], "min")
LAW = Controller.diagonal([PID(Kc=0.66, Ti=10.0, sample_time=1.0)])
SAMPLES = 1500
ANALYSIS = 'analysis = {method = "direct", confidence = 0.999}\n'
TABLES = """
time_unit = "min"
output = [{name = "y", pv = "pv", sp = "sp"}]
input = [{name = "u", op = "op"}]
model = [{output = "y", input = "u", tf = "2 exp(-3.3 s)/(10 s + 1)"}]
"""


def causes(result):
    return {note.code: note for note in result.notes if note.code.startswith("cause-")}


def analysed(folder, *simulations, analysis=""):
    """The result of one loop, each simulation an experiment."""
    names = [f"run{k}.csv" for k in range(len(simulations))]
    for name, sim in zip(names, simulations, strict=True):
        columns = {"t": sim.t, "sp": sim.r[:, 0], "op": sim.u[:, 0], "pv": sim.y[:, 0]}
        pl.DataFrame(columns).write_csv(folder / name)
    data = f'data = {{files = {names}, time = "t"}}\n'.replace("'", '"')
    return run(Project.from_toml(analysis + data + TABLES, folder))


def one_loop(folder, *simulations):
    """What is said of one loop, each simulation an experiment."""
    return causes(analysed(folder, *simulations, analysis=ANALYSIS))


def moving(seed, share):
    """The gain rises by 40 % at this share of the record."""
    rng = np.random.default_rng([seed, 1])
    gain = 2 * np.where(np.arange(SAMPLES) < share * SAMPLES, 1.0, 1.4)
    r, v = random_switching(rng, SAMPLES, 1, 40.0), coloured(rng, SAMPLES, 1, [1, -0.8], [1], 0.1)
    return changing_loop(PLANT, LAW, r, v, (0, 0), gain, 10.0, 3.3)


def test_one_gain_of_four_that_changed_halfway_is_a_plant_that_moved(tmp_path):
    gain = np.where(np.arange(SAMPLES) < SAMPLES // 2, 1.0, 1.4)
    simulation = changing_wood_berry(61, SAMPLES, place=(1, 0), gain=gain)
    path = write_project(simulation, tmp_path)
    path.write_text(ANALYSIS + path.read_text(encoding="utf-8"), encoding="utf-8")
    named = causes(run(path))
    assert named["cause-moved-meanwhile"].where == "bottom, record.csv"
    assert "trueplant track" in named["cause-moved-meanwhile"].message
    assert not {"cause-disturbance", "cause-operating-point", "cause-valve-sticking"} & set(named)


@pytest.mark.parametrize("share", [0.5, 0.75])
def test_a_gain_that_changed_on_the_way_is_no_disturbance(tmp_path, share):
    named = one_loop(tmp_path, moving(62, share))
    assert "cause-moved-meanwhile" in named
    assert "cause-disturbance" not in named


def test_a_gain_that_is_off_from_the_start_has_not_moved_meanwhile(tmp_path):
    named = one_loop(tmp_path, moving(63, 0.0))
    assert set(named) == {"cause-unknown"}


@pytest.mark.parametrize("seed", range(4))
def test_outliers_are_no_disturbance_that_changed(tmp_path, seed):
    rng = np.random.default_rng([seed, 2])
    v = 0.1 * rng.standard_normal((SAMPLES, 1))
    v += np.where(rng.random((SAMPLES, 1)) < 0.01, rng.choice([-1.0, 1.0], (SAMPLES, 1)), 0.0)
    named = one_loop(tmp_path, simulate(PLANT, LAW, random_switching(rng, SAMPLES, 1, 40.0), 1.0, v=v))
    assert named == {}


def test_plant_and_disturbance_that_both_change_are_both_named(tmp_path):
    rng = np.random.default_rng(64)
    late = np.arange(SAMPLES) >= SAMPLES // 2
    r = random_switching(rng, SAMPLES, 1, 40.0)
    v = coloured(rng, SAMPLES, 1, [1, -0.8], [1], 0.1) * np.where(late, 2.0, 1.0)[:, None]
    named = one_loop(tmp_path, changing_loop(PLANT, LAW, r, v, (0, 0), 2 * np.where(late, 1.4, 1.0), 10.0, 3.3))
    assert {"cause-moved-meanwhile", "cause-disturbance"} <= set(named)


def test_a_plant_that_differs_between_experiments_is_no_disturbance(tmp_path):
    named = one_loop(tmp_path, moving(65, 1.0), moving(66, 0.0))
    assert "cause-disturbance" not in named


@pytest.mark.parametrize("even", [(1.0, 0.0), (0.5,)])
def test_noise_that_was_read_between_odd_instants_has_not_changed(tmp_path, even):
    """Interpolation smooths it: beside a record on a grid that passed for another disturbance in 8 of 8 records, in one
    that is even for its first half alone in 6 of 8."""
    for seed in range(3):
        rng = np.random.default_rng([67, seed])
        fine, records = 10 * SAMPLES, []
        for share in even:
            begin = int(share * fine)
            odd = np.cumsum(rng.integers(4, 17, fine)) + begin
            at = np.concatenate([np.arange(0, begin, 10), odd[odd < fine]])
            since = np.clip(np.searchsorted(at, np.arange(fine), side="right") - 1, 0, None)
            u = random_switching(rng, at.size, 1, 25.0)[since]
            v = coloured(rng, fine, 1, [1, -0.98], [1], 0.03)
            s = simulate(PLANT, None, np.zeros((fine, 1)), 0.1, u=u, v=v)
            records.append(pl.DataFrame({"t": s.t[at], "op": s.u[at, 0], "pv": s.y[at, 0]}))
        for k, record in enumerate(records):
            record.write_csv(tmp_path / f"odd{k}.csv")
        runs = ", ".join(f'{{file = "odd{k}.csv", loop = "open"}}' for k in range(len(records)))
        text = TABLES.replace(', sp = "sp"', "") + f'data = {{time = "t"}}\nexperiment = [{runs}]\n'
        assert "cause-disturbance" not in causes(run(Project.from_toml(ANALYSIS + text, tmp_path)))


@pytest.mark.parametrize("seed", [6, 9])
def test_a_gain_that_moved_is_no_load_at_each_move_after_it(tmp_path, seed):
    """Loads that begin with the set-point's moves took its place: it was not said that the first had moved, and the
    gain of the second was that before."""
    rng = np.random.default_rng([seed, 3])
    gain = 2 * np.where(np.arange(SAMPLES) < rng.uniform(0.3, 0.8) * SAMPLES, 1.0, 1.4)
    r, v = random_switching(rng, SAMPLES, 1, 300.0), coloured(rng, SAMPLES, 1, [1, -0.8], [1], 0.03)
    s = changing_loop(PLANT, LAW, r, v, (0, 0), gain, 10.0, 3.3)
    codes = {note.code for note in analysed(tmp_path, s).notes}
    assert "cause-moved-meanwhile" in codes
    assert "load-step" not in codes


def test_a_load_beside_an_unchanged_plant_stays_a_load(tmp_path):
    rng = np.random.default_rng([7, 3])
    r, v = random_switching(rng, SAMPLES, 1, 300.0), coloured(rng, SAMPLES, 1, [1, -0.8], [1], 0.03)
    s = simulate(PLANT, LAW, r, 1.0, v=v, input_disturbance=[Step(700.0, (0.5,))])
    result = analysed(tmp_path, s)
    codes = {note.code for note in result.notes}
    assert "load-step" in codes and "cause-moved-meanwhile" not in codes
    assert str(result.elements[0].verdict) == "unchanged"
