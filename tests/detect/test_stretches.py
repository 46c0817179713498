"""Two stretches of a record, simulated: noise and plant told apart, each test at its level whatever the errors are."""

from __future__ import annotations

import numpy as np
import pytest

from support.chance import most
from support.changing import changing_loop
from support.simulated import coloured, random_switching, segment_of
from trueplant.detect import TwoFits, likeliest_change
from trueplant.identify import Row, Spec, fit_row, pieces_of
from trueplant.loop import PID, Controller, simulate
from trueplant.lti import TransferMatrix
from trueplant.lti.structure import structure_of

PLANT = TransferMatrix.of([["2 exp(-3.3 s)/(10 s + 1)"]], "min")
LAW = Controller.diagonal([PID(Kc=0.66, Ti=10.0, sample_time=1.0)])
SAMPLES = 1500


def fitted(simulation, order=2):
    structure, theta = structure_of(PLANT[0, 0])
    row = Row((Spec(0, structure, tuple(theta)),), pieces_of([segment_of(simulation)], 0))
    return fit_row(row, np.array(theta), np.array([-0.5] + [0.0] * (order - 1)))


def recorded(seed, v, first=0.0, cut=0):
    """A record under the disturbance v (N, 1), its set-point `first` higher at the beginning."""
    r = random_switching(np.random.default_rng([seed, 1]), len(v), 1, 40.0)
    r[:20] += first
    segment = simulate(PLANT, LAW, r, 1.0, v=v)
    keep = {name: getattr(segment, name)[cut:] for name in ("t", "r", "u", "y")}
    return type(segment)(**{**vars(segment), **keep})


def halves(fit):
    """The halves as compared, and the rival explanation."""
    moved, total = likeliest_change(fit), sum(piece.y.size for piece in fit.row.pieces)
    return TwoFits.of(fit, moved.stretch(0, fit.row.middle), moved.stretch(fit.row.middle, total)), moved


def outliers(rng):
    v = 0.1 * rng.standard_normal((SAMPLES, 1))
    return v + np.where(rng.random((SAMPLES, 1)) < 0.01, rng.choice([-1.0, 1.0], (SAMPLES, 1)), 0.0)


NOISES = {
    "outliers": outliers,
    "Student t(3)": lambda rng: 0.06 * rng.standard_t(3, (SAMPLES, 1)),
    "AR": lambda rng: coloured(rng, SAMPLES, 1, [1, -0.8], [1], 0.1),
}


@pytest.mark.parametrize("kind", NOISES)
def test_the_same_noise_and_the_same_plant_keep_their_levels(kind):
    """80 records: each of three tests passes with 0.99 at 5 %, and with less than 0.05 at 20 %."""
    p = []
    for seed in range(80):
        found, moved = halves(fitted(recorded(seed, NOISES[kind](np.random.default_rng([seed, 2])))))
        p.append((found.size_p, found.colour_p, moved.p_value(0.95)))
    assert np.all(np.sum(np.array(p) < 0.05, axis=0) <= most(80, 0.05))


def test_a_start_far_from_rest_is_no_noise():
    """20 records that begin 22 min after a set-point move of 30, with noise of 0.1: at 5 %, 5 pass with 0.9997."""
    p = []
    for seed in range(20):
        v = NOISES["AR"](np.random.default_rng([seed, 3]))
        simulation = recorded(seed, v, first=30.0, cut=22)
        assert np.ptp(simulation.y[:20]) > 5
        found, moved = halves(fitted(simulation))
        p.append((found.size_p, found.colour_p, moved.p_value(0.95)))
    assert np.all(np.sum(np.array(p) < 0.05, axis=0) <= 5)


@pytest.mark.parametrize(("pole", "std", "which"), [(0.8, 0.2, "size"), (0.95, 0.1, "colour")])
def test_noise_that_changed_is_seen_and_the_plant_left_alone(pole, std, which):
    half = SAMPLES // 2
    for seed in range(3):
        rng = np.random.default_rng([seed, 4])
        parts = [
            coloured(rng, half, 1, [1, -a], [1], s) for a, s in ((0.8 if which == "size" else 0.5, 0.1), (pole, std))
        ]
        found, moved = halves(fitted(recorded(seed, np.vstack(parts))))
        assert getattr(found, f"{which}_p") < 1e-6
        assert moved.p_value(0.95) > 1e-3
        assert found.std[1] / found.std[0] == pytest.approx(std / 0.1, rel=0.4)


@pytest.mark.parametrize("share", [0.5, 0.75])
def test_a_gain_that_changed_is_seen_and_the_noise_left_alone(share):
    for seed in range(3):
        rng = np.random.default_rng([seed, 5])
        gain = 2 * np.where(np.arange(SAMPLES) < share * SAMPLES, 1.0, 1.4)
        r, v = random_switching(rng, SAMPLES, 1, 40.0), coloured(rng, SAMPLES, 1, [1, -0.8], [1], 0.1)
        fit = fitted(changing_loop(PLANT, LAW, r, v, (0, 0), gain, 10.0, 3.3))
        found, moved = halves(fit)
        assert moved.p_value(0.95) < 1e-3
        # a gain shows when OP has moved: about every 40 min
        assert moved.refined().time == pytest.approx(share * SAMPLES, abs=80)
        before, after = (fits.theta[0] for fits in (moved.refined().sides.one, moved.refined().sides.other))
        assert after / before == pytest.approx(1.4, rel=0.1)
        # Of what both halves leave with one plant for each, the changed one would show without its rival.
        assert found.noise_p > 1e-3


def test_the_halves_of_one_noise_differ_without_the_rival():
    """What a gain that changed late leaves looks like another noise: that is what the rival explanation is for."""
    rng = np.random.default_rng(6)
    gain = 2 * np.where(np.arange(SAMPLES) < 0.85 * SAMPLES, 1.0, 1.4)
    r, v = random_switching(rng, SAMPLES, 1, 40.0), coloured(rng, SAMPLES, 1, [1, -0.8], [1], 0.1)
    fit = fitted(changing_loop(PLANT, LAW, r, v, (0, 0), gain, 10.0, 3.3))
    piece, half = fit.row.pieces[0], SAMPLES // 2
    naive = TwoFits.of(fit, (piece.from_sample(0, half),), (piece.from_sample(half),))
    assert naive.noise_p < 1e-3 < halves(fit)[0].noise_p


def test_a_stretch_that_is_too_short_is_not_fitted():
    fit = fitted(recorded(7, NOISES["AR"](np.random.default_rng(7))))
    piece = fit.row.pieces[0]
    assert TwoFits.of(fit, (piece.from_sample(0, 15),), (piece.from_sample(15),)) is None
