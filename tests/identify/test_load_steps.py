"""Load steps: found where they are, taken along, and not read into records without them. Simulated records."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from support.simulated import coloured, segment_of
from trueplant.identify import Row, Spec, fit_row, identify_output, pieces_of
from trueplant.identify.estimate import fit_noise
from trueplant.identify.fit import Whitening
from trueplant.identify.load_steps import load_gains, with_load_steps
from trueplant.identify.noise import whiten
from trueplant.identify.rivals import rivals
from trueplant.loop import PID, Controller, Step, simulate
from trueplant.lti import Structure, TransferMatrix

FOPDT = Structure.parse("fopdt")
TRUTH = np.array([2.0, 10.0, 4.6])
PLANT = TransferMatrix(((FOPDT.transfer(TRUTH),),), "min")
LAW = Controller.diagonal([PID(Kc=0.4, Ti=10.0, sample_time=1.0)])
SPEC = Spec(0, FOPDT, (1.7, 12.0, 4.0))


def record(seed, loads=(), pole=0.0, std=0.02, samples=1500, noise=None):
    """One loop whose set-point moves three times, under loads at the plant's input."""
    rng = np.random.default_rng(seed)
    r = np.zeros((samples, 1))
    r[samples // 5 :] = 1.0
    r[samples // 2 :] = 0.3
    r[4 * samples // 5 :] = 0.8
    v = coloured(rng, samples, 1, [1, -pole], [1], std) if noise is None else noise
    steps = [Step(at, (size,)) for at, size in loads]
    return segment_of(simulate(PLANT, LAW, r, 1.0, v=v, input_disturbance=steps))


LOADS = ((450.0, 0.12), (980.0, -0.1), (1350.0, 0.08))


def test_load_steps_are_found_and_the_gain_is_right_with_them():
    """8 records: each load within a time constant of where PV begins to answer it; the gain within its interval."""
    missed, covered, narrower = 0, 0, []
    for seed in range(8):
        estimate = identify_output([record(seed, LOADS)], 0, [SPEC])
        found = np.array(estimate.row.pieces[0].loads)
        missed += sum(not np.any(np.abs(found - at - TRUTH[2]) < TRUTH[1]) for at, _ in LOADS)
        low, high = estimate.intervals[0]
        covered += low <= TRUTH[0] <= high
        row = replace(estimate.row, pieces=tuple(replace(p, loads=()) for p in estimate.row.pieces))
        without = fit_row(row, estimate.fit.theta, fit_noise(fit_row(row, estimate.fit.theta, np.zeros(0)), 10, 10))
        narrower.append(np.sqrt(estimate.fit.covariance[0, 0] / without.covariance[0, 0]))
    assert missed <= 1
    assert covered >= 7
    assert np.median(narrower) < 0.5, "what the loads are worth"


@pytest.mark.parametrize(
    "kind", ["white", "AR", pytest.param("random walk", marks=pytest.mark.slow), "Student t", "outliers"]
)
def test_none_is_read_into_a_record_without_any(kind):
    """10 records each: at a chance of 1 % more than one has a chance of 0.4 %."""
    with_some = 0
    for seed in range(10):
        rng = np.random.default_rng([seed, 7])
        noise = {
            "white": 0.02 * rng.standard_normal((1500, 1)),
            "AR": coloured(rng, 1500, 1, [1, -0.95], [1], 0.05),
            "random walk": 0.004 * np.cumsum(rng.standard_normal((1500, 1)), axis=0),
            "Student t": 0.02 * rng.standard_t(3, (1500, 1)),
            "outliers": 0.02 * rng.standard_normal((1500, 1)) * np.where(rng.random((1500, 1)) < 0.01, 10.0, 1.0),
        }[kind]
        estimate = identify_output([record(seed, noise=noise)], 0, [SPEC])
        with_some += bool(estimate.row.pieces[0].loads)
    assert with_some <= 1


def test_what_a_load_gains_is_what_least_squares_gains():
    """Against columns built one by one, for theta and noise model as they are."""
    row = Row((SPEC,), pieces_of([record(1, LOADS[:1])], 0))
    fit = fit_row(row, TRUTH, np.array([-0.3, -0.2]))
    gains = load_gains(fit)[0]
    best = int(np.argmax(gains))
    assert abs(best + fit.ar.size - LOADS[0][0] - TRUTH[2]) < 3
    start = best + fit.ar.size
    t = np.arange(row.pieces[0].y.size, dtype=float) - start
    tau = fit.theta[1]
    columns = [t == 0, np.where(t >= 0, np.exp(-np.maximum(t, 0) / tau), 0.0), t >= 0]
    misread = whiten(fit.ar, (t == 0).astype(float))
    one = np.eye(t.size)[start]
    white = [misread, one[fit.ar.size :], *(whiten(fit.ar, np.asarray(c, dtype=float)) for c in columns[1:])]
    (whitening,) = Whitening.of(fit)
    known = np.column_stack([whitening.jacobian.T, whitening(rivals(fit, 0, row.pieces[0])).T, whitening.basis])

    errors = whitening.errors

    def left(more):
        x = np.column_stack([known, *more])
        x = x / np.linalg.norm(x, axis=0)
        return np.sum((errors - x @ np.linalg.lstsq(x, errors, rcond=None)[0]) ** 2)

    variance = left([]) / fit.left
    assert gains[best] == pytest.approx((left(white[:2]) - left(white)) / variance, rel=1e-3)


def test_a_fit_without_loads_is_left_as_it_is():
    row = Row((SPEC,), pieces_of([record(2)], 0))
    fit = fit_row(row, TRUTH, np.zeros(0))
    assert with_load_steps(fit) is fit
