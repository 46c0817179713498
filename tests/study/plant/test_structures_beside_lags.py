"""A model that answers at once, or integrates, beside a simulated plant that does neither."""

from __future__ import annotations

import pytest

import trueplant as tp
from trueplant.loop import PID, Controller, alternating_steps, simulate
from trueplant.lti import TransferMatrix

PLANT = TransferMatrix.of([["2 exp(-2 s)/(10 s + 1)"]], "min")
LAW = Controller.diagonal([PID(Kc=1.0, Ti=10.0, sample_time=0.5)])


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("tf", ["2", "2 exp(-2 s)", "0.2 exp(-2 s)/s"])
def test_the_plants_own_lag_takes_their_place(tf: str, seed: int) -> None:
    """The controller is not declared. Where a gain answers at once, OP explains the PV that it was computed from, but
    for steps of the set-point: such loads would make the plant the controller's inverse, -1 / Kc.
    """
    found = simulate(PLANT, LAW, alternating_steps(1200, 0.5, 60.0, [1.0]), 0.5, noise=0.05, seed=seed)
    columns = {"time": found.t, "sp": found.r[:, 0], "op": found.u[:, 0], "pv": found.y[:, 0]}
    analysis = tp.run(columns, loops=[tp.Loop("T", pv="pv", sp="sp", op="op")], model={("T", "T"): tf})
    (element,) = analysis.elements
    assert element.structure == "fopdt" and all(note["code"] != "load-step" for note in analysis.to_dict()["notes"])
    for parameter, truth, near in zip(element.parameters, (2.0, 10.0, 2.0), (0.04, 0.4, 0.2), strict=True):
        low, high = parameter.ci
        assert abs(parameter.plant - truth) < near and high - low < 2 * near
