"""Derivative action at a scan that was not recorded hides the dynamics: noise of PV comes back through OP in a sample.

What it then looks like is a plant without dead time. The records are simulated, recorded every second, seeds stated.
"""

from __future__ import annotations

import numpy as np
import pytest

from simulated import random_switching
from test_study_one_loop import declared
from trueplant.loop import PID, Controller, Simulation, simulate
from trueplant.lti import TransferMatrix
from trueplant.study import run
from trueplant.study.project_parts import Unmeasured
from trueplant.study.track import track

MODEL = "-2.6 exp(-6 s)/(40 s + 1)"
LAW = {"Kc": -1.0, "Ti": 40.0, "Td": 4.0, "alpha": 0.1, "derivative_on": "pv"}


def recorded(scans: int, samples: int = 1500, seed: int = 3, noise: float = 0.05, **law: object) -> Simulation:
    """The loop with so many scans of the controller in each sample of the record."""
    rng = np.random.default_rng(seed)
    r = np.repeat(random_switching(rng, samples, 1, 60.0), scans, axis=0)
    v = noise * rng.standard_normal((samples * scans, 1))
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
    made = declared(tmp_path, recorded(2), MODEL, LAW | {"sample_time": 0.5})
    with_disturbance = made.model_copy(update={"unmeasured": [Unmeasured(output="y", kind="drift", std=0.001)]})
    result = run(with_disturbance)
    assert "disturbance" in result.methods
    assert [p.plant is None for p in result.elements[0].parameters] == [False, True, True]


def test_tracking_leaves_the_dynamics_alone_as_well(tmp_path):
    found = track(declared(tmp_path, recorded(2), MODEL, LAW | {"sample_time": 0.5}))
    windows = [w for w in found.windows if w.status == "ok"]
    assert windows
    for window in windows:
        gain, *dynamics = window.elements[0].parameters
        assert gain.plant == pytest.approx(-2.6, rel=0.1)
        assert all(p.plant is None and "scans faster than the record" in p.reason for p in dynamics)
