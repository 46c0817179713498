"""Elements with leads, as every analysis searches for them: found whatever the start. All records are simulated."""

from __future__ import annotations

import numpy as np
import pytest

from support.simulated import WOOD_BERRY, coloured, random_switching, segment_of
from trueplant.identify import Spec, identify_matrix
from trueplant.loop import PID, Controller, simulate
from trueplant.lti import Structure, TransferMatrix, tf
from trueplant.lti.structure import structure_of

LAW = Controller.diagonal([PID(Kc=0.2, Ti=12, sample_time=1.0), PID(Kc=-0.05, Ti=25, sample_time=1.0)])
STRUCTURE = Structure.parse("sopdt+lead")
KNOWN = structure_of(WOOD_BERRY[1, 1])
INVERSE = "6.6 (-8 s + 1) exp(-3 s)/((10.9 s + 1)(5 s + 1))"
OVERSHOOT = "6.6 (25 s + 1) exp(-7 s)/((10.9 s + 1)(5 s + 1))"
LEADLESS = (6.6, 10.9, 0.545, 1.09, 7.4)
"""Where the search begins for a first-order model under this structure."""
CASES = {
    "inverse response, model without a lead": (INVERSE, LEADLESS),
    "inverse response, no model": (INVERSE, None),
    "overshoot, model without a lead": (OVERSHOOT, LEADLESS),
    "overshoot, no model": (OVERSHOOT, None),
}
"""Plant and start."""


def plant_with(element: str) -> TransferMatrix:
    return TransferMatrix((WOOD_BERRY.elements[0], (tf(element), WOOD_BERRY[1, 1])), "min")


def record(seed: int, element: str):
    rng = np.random.default_rng(seed)
    r, v = random_switching(rng, 3000, 2, 20.0), coloured(rng, 3000, 2, [1, -0.8], [1], 0.3)
    return segment_of(simulate(plant_with(element), LAW, r, 1.0, v=v))


@pytest.mark.parametrize("case", CASES)
def test_the_lead_is_found(case):
    element, start = CASES[case]
    segment = record(0, element)
    truth = structure_of(tf(element))[1]
    specs = {(1, 0): Spec(0, STRUCTURE, start, (2, 3)), (1, 1): Spec(1, KNOWN[0], tuple(KNOWN[1]))}
    model = plant_with("0" if start is None else "6.6 exp(-7.4 s)/(10.9 s + 1)")
    found = identify_matrix([segment], model, specs)[1]
    order = np.r_[STRUCTURE.sorted(found.theta[:5]), 5 : 5 + len(KNOWN[1])]
    theta, error = found.theta[order], np.sqrt(np.diag(found.covariance))[order]
    assert np.all(np.abs(theta - np.r_[truth, KNOWN[1]]) < 3.5 * error)
    # the sign of the lead is told for certain, and the start still says what the model was
    assert error[3] < 0.2 * abs(truth[3])
    assert found.row.specs[0].initial == start
