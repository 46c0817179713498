"""Tests of residuals that are registered by name reach the result and the report."""

from __future__ import annotations

import numpy as np
import pytest

import trueplant as tp
from trueplant.identify import RESIDUAL_TESTS, prediction_errors
from trueplant.loop import Controller, alternating_steps, simulate
from trueplant.report import render


def test_one_line_registers_a_test(monkeypatch):
    law = tp.PID(Kc=1.0, Ti=10.0, sample_time=0.5)
    plant = tp.TransferMatrix.of([["2.4 exp(-2 s)/(9 s + 1)"]], "min")
    sim = simulate(plant, Controller.diagonal([law]), alternating_steps(800, 0.5, 60.0, [1.0]), 0.5, noise=0.05, seed=1)
    frame = {"t": sim.t, "sp": sim.r[:, 0], "op": sim.u[:, 0], "pv": sim.y[:, 0]}
    seen = []

    def largest(fit):
        seen.append(np.nanmax(np.abs(prediction_errors(fit))) / np.sqrt(fit.variance))
        return float(np.exp(-seen[-1]))

    monkeypatch.setitem(RESIDUAL_TESTS, "largest error", largest)
    loop = tp.Loop("y", pv="pv", sp="sp", op="op", controller=law)
    found = tp.run(frame, loops=[loop], model={("y", "y"): "2 exp(-2 s)/(10 s + 1)"})
    (row,) = found.result.fit
    assert 2 < seen[0] < 6
    assert row.residual_tests.further_p["largest error"] == pytest.approx(np.exp(-seen[0]))
    assert 0.01 < row.residual_tests.further_p["constant variance"] <= 1
    assert "p, largest error" in render(found.result)
