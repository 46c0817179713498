"""Derivative action at a scan that was not recorded hides the dynamics: noise of PV comes back through OP in a sample.

What it then looks like is a plant without dead time. The records are simulated, recorded every second, seeds stated.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import polars as pl
import pytest
from scipy.signal import lfilter

from support.one_loop import declared
from support.simulated import coloured, random_switching
from trueplant import Project, run
from trueplant import simulate as simulated
from trueplant.loop import PID, Controller, Simulation, simulate
from trueplant.lti import TransferMatrix, sampled_response, tf
from trueplant.project.tables import Unmeasured
from trueplant.tracking.track import track

PROJECT = """
time_unit = "min"
data = {files = ["p.csv"], time = "t"}
output = [{name = "top", pv = "pv", sp = "sp"}]
input = [{name = "reflux", op = "op", limits = [0, 100]}]
model = [{output = "top", input = "reflux", tf = "-0.464/(12 s + 1)"}]
controller = [{output = "top", input = "reflux", Kc = 1.0, Ti = 8.0, Td = 0.5, action = "direct"}]

[simulate]
duration = 600
sample_time = 0.5
noise = 0.05
seed = SEED
start = {top = 0, reflux = 50}
plant = [{output = "top", input = "reflux", tf = "-0.7/(12 s + 1)"}]
setpoints = [
    {time = 50, output = "top", value = 2},
    {time = 200, output = "top", value = -1},
    {time = 400, output = "top", value = 1},
]
"""
MODEL = "-2.6 exp(-6 s)/(40 s + 1)"
LAW = {"Kc": -1.0, "Ti": 40.0, "Td": 4.0, "alpha": 0.1, "derivative_on": "pv"}


def recorded(
    scans: int, samples: int = 1500, seed: int = 3, noise: float = 0.05, pole: float = 0.0, **law: object
) -> Simulation:
    """The loop with so many scans of the controller in each sample of the record; `pole` is that of the noise."""
    rng = np.random.default_rng(seed)
    r = np.repeat(random_switching(rng, samples, 1, 60.0), scans, axis=0)
    v = coloured(rng, samples * scans, 1, [1, -pole], [1], noise)
    h = 1 / scans
    entry = PID(**LAW | {"sample_time": h} | law)
    plant = TransferMatrix.of([[MODEL]], "s")
    return simulate(plant, Controller.diagonal([entry]), r, h, noise=v, record_every=scans)


def test_a_declared_scan_that_is_faster_leaves_the_gain_alone(tmp_path):
    element = run(declared(tmp_path, recorded(2), MODEL, LAW | {"sample_time": 0.5})).elements[0]
    assert element.verdict == "unchanged"
    assert [p.plant is None for p in element.parameters] == [False, True, True]
    assert "scans faster than the record" in element.parameters[2].reason


def test_a_declared_disturbance_does_not_bring_them_back(tmp_path):
    made = declared(tmp_path, recorded(2, 500), MODEL, LAW | {"sample_time": 0.5})
    with_disturbance = made.model_copy(update={"unmeasured": [Unmeasured(output="y", kind="drift", std=0.001)]})
    result = run(with_disturbance)
    assert "disturbance" in result.to_dict()["methods"]
    assert [p.plant is None for p in result.elements[0].parameters] == [False, True, True]


def test_tracking_leaves_the_dynamics_alone_as_well(tmp_path):
    found = track(declared(tmp_path, recorded(2), MODEL, LAW | {"sample_time": 0.5}))
    windows = [w for w in found.windows if w.status == "ok"]
    assert windows
    for window in windows:
        gain, *dynamics = window.elements[0].parameters
        assert gain.plant == pytest.approx(-2.6, rel=0.1)
        assert len(dynamics) == 2
        assert all(p.plant is None and "scans faster than the record" in p.reason for p in dynamics)


@pytest.mark.parametrize("seed", [3, 4, 5])
def test_a_faster_scan_that_is_not_declared_is_noticed(tmp_path, seed):
    element = run(declared(tmp_path, recorded(10, seed=seed), MODEL, LAW)).elements[0]
    assert element.verdict == "unchanged" or "would not have been seen for certain" in element.reason
    assert element.verdict != "changed"
    assert [p.plant is None for p in element.parameters] == [False, True, True]
    assert "declare the controller's scan" in element.parameters[2].reason


@pytest.mark.parametrize("changes", [{}, {"Kc": -0.6}, {"setpoint_filter": tf("1/(10 s + 1)")}])
def test_a_scan_that_is_the_records_need_not_be_declared(tmp_path, changes):
    """Not even where the tuning is another than was declared."""
    element = run(declared(tmp_path, recorded(1, **changes), MODEL, LAW)).elements[0]
    assert element.verdict == "unchanged"
    for found, true in zip(element.parameters, (-2.6, 40.0, 6.0), strict=True):
        assert abs(found.plant - true) < 4 * found.std_error


def test_a_change_of_tuning_is_no_sign_of_a_faster_scan(tmp_path):
    before, after = recorded(1), recorded(1, seed=4, Kc=-0.5)
    columns = {name: np.concatenate([getattr(before, name), getattr(after, name)]) for name in ("r", "u", "y")}
    both = dataclasses.replace(before, t=np.arange(3000.0), **columns)
    element = run(declared(tmp_path, both, MODEL, LAW)).elements[0]
    assert all(p.plant is not None for p in element.parameters)


def test_a_slower_scan_is_no_faster_one(tmp_path):
    element = run(declared(tmp_path, recorded(1, sample_time=3.0), MODEL, LAW)).elements[0]
    assert all(p.plant is not None for p in element.parameters)


def test_an_op_at_its_limits_is_no_sign_of_a_faster_scan(tmp_path):
    limits = (-1.0, 0.5)
    record = recorded(1, limits=limits, anti_windup="clamp")
    assert 0.05 < np.mean(np.isin(record.u, limits)) < 0.95
    text = declared(tmp_path, record, MODEL, LAW).to_toml().replace('op = "op"', 'op = "op"\nlimits = [-1.0, 0.5]')
    element = run(Project.from_toml(text, tmp_path)).elements[0]
    assert all(p.plant is not None for p in element.parameters)


def test_a_scan_that_is_the_records_is_confirmed_without_being_declared(tmp_path):
    """A continuous law would not have written what derivative action on noise wrote once a sample."""
    confirmed = run(declared(tmp_path, recorded(1), MODEL, LAW)).to_dict()["methods"]["controller_consistency"]
    assert [entry["confirmed"] for entry in confirmed] == [True]
    assert confirmed[0]["message"].startswith("the declared controller reproduces OP to rounding (gain 1.000,")
    other = run(declared(tmp_path, recorded(1, Kc=-0.6), MODEL, LAW)).to_dict()["methods"]["controller_consistency"]
    assert [entry["confirmed"] for entry in other] == [False]


PI = {"Td": 0.0, "Kc": -3.0}


@pytest.mark.parametrize("law", [None, LAW | PI])
def test_a_pi_law_that_scans_faster_is_noticed_by_the_op_it_wrote(tmp_path, law):
    """Between the samples OP moves on, and the dead time comes out half a sample short: its interval says so."""
    result = run(declared(tmp_path, recorded(5, noise=0.2, pole=0.9, Td=0.0, Kc=-3.0), MODEL, law))
    dead_time = result.elements[0].parameters[2]
    assert not dead_time.changed
    assert dead_time.ci[0] < 6 < dead_time.ci[1] and dead_time.std_error > 0.5
    assert [note.code for note in result.notes if note.code == "scan"] == ["scan"]


@pytest.mark.parametrize("law", [None, LAW | PI])
@pytest.mark.parametrize("digits", [6, 1])
def test_an_op_that_was_rounded_is_no_sign_of_a_faster_scan(tmp_path, law, digits):
    made = recorded(1, Td=0.0, Kc=-3.0)
    rounded = dataclasses.replace(made, u=np.round(made.u, digits))
    result = run(declared(tmp_path, rounded, MODEL, law))
    assert not any(note.code == "scan" for note in result.notes)


def test_the_rounding_of_op_is_no_other_tuning(tmp_path):
    made = recorded(1, Td=0.0, Kc=-3.0, noise=0.02)
    rounded = dataclasses.replace(made, u=np.round(made.u))
    step = 1 / np.sqrt(12) / float(np.std(made.u))
    assert step > 0.05
    checked = run(declared(tmp_path, rounded, MODEL, LAW | PI | {"sample_time": 1.0})).to_dict()["methods"][
        "controller_consistency"
    ]
    assert [entry["confirmed"] for entry in checked] == [True]


@pytest.mark.parametrize("seed", [1, 2])
def test_set_points_that_kick_op_between_samples_pass_for_no_loads(tmp_path, seed):
    """A derivative answers a set-point within a twentieth of a sample: what OP did then nobody recorded."""
    text = PROJECT.replace("SEED", str(seed))
    (tmp_path / "p.toml").write_text(text)
    simulated(tmp_path / "p.toml").write_csv(tmp_path / "p.csv")
    result = run(tmp_path / "p.toml")
    assert not any("stepped as an input" in note.message for note in result.notes)
    low, high = result.elements[0].parameters[0].ci
    assert low < -0.7 < high


FORWARD = """
time_unit = "s"
data = {files = ["p.csv"], time = "t"}
output = [{name = "y", pv = "pv", sp = "sp"}]
input = [{name = "u", op = "op"}]
disturbance = [{name = "feed", column = "d"}]
model = [
    {output = "y", input = "u", tf = "-2.6 exp(-6 s)/(40 s + 1)"},
    {output = "y", input = "feed", tf = "1.2 exp(-3.5 s)/(15 s + 1)"},
]
controller = [{output = "y", input = "u", Kc = -1.0, Ti = 40.0}]
"""


def test_an_op_that_also_acts_on_a_measured_disturbance_follows_from_the_samples(tmp_path):
    """Feedforward that nobody declared: what it adds to OP acts on the plant as OP does."""
    rng = np.random.default_rng(6)
    samples, plant = 1500, TransferMatrix.of([[MODEL]], "s")
    d = coloured(rng, samples, 1, [1, -0.9], [1], 0.5)
    forward = lfilter([0.4], [1, -0.3], d, axis=0)
    feed = TransferMatrix.of([["1.2 exp(-3.5 s)/(15 s + 1)"]], "s")
    v = sampled_response(plant, forward, 1.0, ("zoh",)) + sampled_response(feed, d, 1.0, ("zoh",))
    v += coloured(rng, samples, 1, [1, -0.8], [1], 0.05)
    law = PID(Kc=-1.0, Ti=40.0, sample_time=1.0)
    s = simulate(plant, Controller.diagonal([law]), random_switching(rng, samples, 1, 60.0), 1.0, v=v)
    columns = {"t": s.t, "sp": s.r[:, 0], "op": s.u[:, 0] + forward[:, 0], "pv": s.y[:, 0], "d": d[:, 0]}
    pl.DataFrame(columns).write_csv(tmp_path / "p.csv")
    result = run(Project.from_toml(FORWARD, tmp_path))
    assert not any(note.code == "scan" for note in result.notes)
    (of_op,) = [e.parameters for e in result.elements if e.input == "u"]
    assert of_op[2].ci[0] < 6 < of_op[2].ci[1] and np.ptp(of_op[2].ci) < 0.5
