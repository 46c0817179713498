"""What structures have in common, against transfer functions: gain and mean time of an impulse response."""

from __future__ import annotations

import numpy as np
import pytest

from support.simulated import random_switching, segment_of
from trueplant.identify import Row, Spec, fit_row, pieces_of
from trueplant.identify.moments import apart, in_row
from trueplant.loop import PID, Controller, simulate
from trueplant.lti import Structure, TransferMatrix

FIRST, SECOND = Structure.parse("fopdt"), Structure.parse("sopdt")
TRUTH = np.array([2.0, 10.0, 3.0])


def fit_of(structure: Structure, p: np.ndarray, column: int = 0):
    plant = TransferMatrix(((FIRST.transfer(TRUTH),),), "min")
    law = Controller.diagonal([PID(Kc=0.4, Ti=10.0, sample_time=1.0)])
    r = random_switching(np.random.default_rng(1), 200, 1, 60.0)
    segment = segment_of(simulate(plant, law, r, 1.0))
    row = Row((Spec(column, structure, tuple(p)),), pieces_of([segment], 0))
    return fit_row(row, p, np.zeros(1), free=np.zeros(p.size, dtype=bool))


def gain_and_time(structure: Structure, p: np.ndarray) -> tuple[float, float]:
    """By the transfer function near rest: G(iw) = K (1 - iw T + ...)."""
    w = 1e-5
    (value,) = structure.transfer(p)(np.array([1j * w]))
    return float(value.real), float(-value.imag / value.real / w)


def test_shifts_in_another_structure_move_gain_and_time_as_much():
    first, there = fit_of(FIRST, TRUTH), np.array([2.2, 7.0, 2.0, 3.5])
    second, step = fit_of(SECOND, there), np.array([[0.01, 0.05, 0.02]])
    (moved,) = in_row(step, first, second.row, there)
    before, after = gain_and_time(SECOND, there), gain_and_time(SECOND, there + moved)
    wanted = np.subtract(gain_and_time(FIRST, TRUTH + step[0]), gain_and_time(FIRST, TRUTH))
    np.testing.assert_allclose(np.subtract(after, before), wanted, rtol=1e-3)
    assert moved[3] == pytest.approx(0.02)
    np.testing.assert_array_equal(in_row(step, first, first.row, TRUTH), step)


def test_plants_of_two_structures_are_as_far_apart_as_gain_and_time():
    first, there = fit_of(FIRST, TRUTH), np.array([2.2, 7.0, 2.0, 3.5])
    second = fit_of(SECOND, there)
    moved = there + apart(first, second.row, there)
    np.testing.assert_allclose(gain_and_time(SECOND, moved), gain_and_time(FIRST, TRUTH), rtol=1e-6)
    np.testing.assert_allclose(apart(first, first.row, np.array([1.0, 8.0, 2.0])), [1.0, 2.0, 1.0])


def test_an_element_that_one_row_lacks_or_that_integrates_there_does_not_move():
    first, step = fit_of(FIRST, TRUTH), np.array([[0.01, 0.05, 0.02]])
    ramp = Structure.parse("integrator")
    integrating = fit_of(ramp, np.array([0.2, 3.0]))
    assert not in_row(step, first, integrating.row, integrating.theta).any()
    assert not apart(first, integrating.row, integrating.theta).any()
