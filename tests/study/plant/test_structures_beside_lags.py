"""Models and plants that answer at once, or integrate (simulated)."""

from __future__ import annotations

import numpy as np
import pytest

import trueplant as tp
from trueplant.loop import PID, Controller, alternating_steps, simulate
from trueplant.lti import TransferMatrix, sampled_response, tf

PLANT = TransferMatrix.of([["2 exp(-2 s)/(10 s + 1)"]], "min")
LAW = Controller.diagonal([PID(Kc=1.0, Ti=10.0, sample_time=0.5)])


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("tf", ["2", "2 exp(-2 s)", "0.2 exp(-2 s)/s"])
def test_the_plants_own_lag_takes_their_place(tf: str, seed: int) -> None:
    """The controller is not declared: did OP act on the PV that it was computed from, the plant would be the
    controller's inverse, -1 / Kc, with a load at each step of the set-point.
    """
    found = simulate(PLANT, LAW, alternating_steps(1200, 0.5, 60.0, [1.0]), 0.5, noise=0.05, seed=seed)
    columns = {"time": found.t, "sp": found.r[:, 0], "op": found.u[:, 0], "pv": found.y[:, 0]}
    analysis = tp.run(columns, loops=[tp.Loop("T", pv="pv", sp="sp", op="op")], model={("T", "T"): tf})
    (element,) = analysis.elements
    assert element.structure == "fopdt" and all(note["code"] != "load-step" for note in analysis.to_dict()["notes"])
    for parameter, truth, near in zip(element.parameters, (2.0, 10.0, 2.0), (0.04, 0.4, 0.2), strict=True):
        low, high = parameter.ci
        assert abs(parameter.plant - truth) < near and high - low < 2 * near


@pytest.mark.parametrize(("gain", "verdict"), [(2.0, "unchanged"), (2.6, "changed")])
@pytest.mark.parametrize("seed", range(2))
def test_a_plant_that_answers_at_once_is_told_by_its_gain(gain: float, verdict: str, seed: int) -> None:
    """It answers to the OP written behind the PV before: no lag, no load and no valve is needed for that."""
    plant = TransferMatrix.of([[f"{gain}"]], "min")
    law = Controller.diagonal([PID(Kc=0.1, Ti=1.0, sample_time=0.5)])
    found = simulate(plant, law, alternating_steps(1200, 0.5, 30.0, [1.0]), 0.5, noise=0.05, seed=seed)
    columns = {"time": found.t, "sp": found.r[:, 0], "op": found.u[:, 0], "pv": found.y[:, 0]}
    analysis = tp.run(columns, loops=[tp.Loop("T", pv="pv", sp="sp", op="op")], model={("T", "T"): "2"})
    (element,) = analysis.elements
    assert (element.structure, element.verdict) == ("gain", verdict)
    assert abs(element.parameters[0].plant - gain) < 0.02
    codes = {note["code"] for note in analysis.to_dict()["notes"]}
    assert not codes & {"load-step", "structure", "cause-valve-sticking"}


def test_what_is_written_after_pv_is_read_acts_in_the_next_sample() -> None:
    """The direct part alone is late: by hand for a gain, and beside a lag by partial fractions."""
    u = np.random.default_rng(3).standard_normal(50)
    assert np.array_equal(sampled_response(tf("2"), u, 0.5, "written")[1:], 2 * u[:-1])
    whole = sampled_response(tf("(2 s + 1)/(5 s + 1)"), u, 0.5, "written")
    lag = sampled_response(tf("0.6/(5 s + 1)"), u, 0.5)
    assert np.allclose(whole[1:], lag[1:] + 0.4 * u[:-1], atol=1e-12)
    same = sampled_response(tf("2 exp(-0.3 s)/(5 s + 1)"), u, 0.5)
    assert np.array_equal(sampled_response(tf("2 exp(-0.3 s)/(5 s + 1)"), u, 0.5, "written"), same)
