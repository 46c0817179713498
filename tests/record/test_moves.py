"""How set-points move is counted move by move, and noise of PV is what it does from sample to sample by itself."""

from __future__ import annotations

import numpy as np
import pytest

from trueplant.record.moves import moves_of, pv_noise


def test_moves_are_counted_with_their_sizes_and_times():
    x = np.concatenate([np.full(10, 5.0), np.full(20, 7.0), np.full(5, 6.5), np.full(3, 9.0)])
    moves = moves_of(0.5 * np.arange(38), x)
    assert moves.times.tolist() == [5.0, 15.0, 17.5] and moves.sizes.tolist() == [2.0, -0.5, 2.5] and not moves.always


def test_a_ramp_is_one_move_and_its_way_back_another():
    x = np.concatenate([np.zeros(50), np.linspace(0, 3, 7), np.linspace(2.5, 1, 4), np.full(60, 1.0)])
    moves = moves_of(np.arange(x.size, dtype=float), x)
    assert moves.sizes.tolist() == [3.0, -2.0]


def test_missing_samples_are_no_move():
    x = np.r_[np.zeros(10), np.full(5, np.nan), np.zeros(5), np.full(5, np.nan), np.ones(5)]
    assert moves_of(np.arange(30.0), x).sizes.tolist() == [1.0]
    assert moves_of(np.arange(30.0), np.full(30, np.nan)).sizes.size == 0


def test_what_always_changes_has_no_levels():
    assert moves_of(np.arange(400.0), np.sin(0.1 * np.arange(400))).always


@pytest.mark.parametrize("held", [1, 5])
def test_noise_is_that_of_the_samples_whatever_pv_does_slowly(held: int):
    """White noise of 0.2 on a slow sine and steps; PV may be held over several samples."""
    rng = np.random.default_rng(3)
    n = 20_000
    y = 0.2 * rng.standard_normal(n) + np.sin(np.arange(n) / 500) + 3 * (np.arange(n) // 4000)
    assert pv_noise(np.repeat(y, held)) == pytest.approx(0.2, rel=0.05)


def test_noise_below_a_quantum_is_that_of_rounding():
    y = np.round(np.cumsum(0.001 * np.random.default_rng(1).standard_normal(20_000)) / 0.01) * 0.01
    assert pv_noise(y) == pytest.approx(0.01 / np.sqrt(12), rel=1e-6)
