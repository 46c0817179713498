"""Excitation: how much, over which frequencies, and in how many directions the signals move."""

from __future__ import annotations

import numpy as np
import pytest

from trueplant.errors import DataError
from trueplant.record import Segment, excitation

N, H = 4000, 0.5


def segment(r: np.ndarray, noise: float = 0.01, u: np.ndarray | None = None) -> Segment:
    n, m = r.shape
    y = r + noise * np.random.default_rng(3).standard_normal(r.shape)
    u = r if u is None else u
    return Segment(0, H, np.arange(n) * H, r, u, y, np.zeros((n, 0)), np.ones((n, m), bool), ("zoh",) * m)


def steps(seed: int, every: int = 100, n: int = N) -> np.ndarray:
    return np.repeat(np.random.default_rng(seed).choice([-1.0, 1.0], n // every), every)


def test_independent_signals_are_well_conditioned() -> None:
    e = excitation([segment(np.column_stack([steps(1, 20), steps(2, 20)]))])
    assert e.rank == 2
    assert e.sufficient
    assert e.sentences == ()
    assert np.all(e.condition >= 1)
    assert np.median(e.condition) < 10


def test_the_same_proportion_is_rank_one() -> None:
    r = np.column_stack([steps(1), -2.5 * steps(1)])
    e = excitation([segment(r)], names=("top", "bottom"))
    assert e.rank == 1
    assert np.min(e.condition) > 1e6
    assert len(e.sentences) == 1
    assert "top and bottom always move together in the same proportion" in e.sentences[0]


def test_moving_at_the_same_instants_is_fine() -> None:
    rng = np.random.default_rng(5)
    r = np.repeat(rng.standard_normal((40, 2)), 100, axis=0)
    e = excitation([segment(r)])
    assert e.rank == 2
    assert e.sentences == ()


def test_two_experiments_make_up_for_each_other() -> None:
    same = segment(np.column_stack([steps(1), steps(1)]))
    opposite = segment(np.column_stack([steps(2), -steps(2)]))
    assert excitation([same]).rank == 1
    assert excitation([opposite]).rank == 1
    both = excitation([same, opposite])
    assert both.rank == 2
    assert np.median(both.condition) < 100


def test_a_sum_of_others_is_named() -> None:
    a, b = steps(1), steps(2)
    e = excitation([segment(np.column_stack([a, b, a + b]))])
    assert e.rank == 2
    assert "only 2 independent directions" in e.sentences[0]


def test_constant_signals() -> None:
    e = excitation([segment(np.column_stack([steps(1), np.full(N, 7.0)]))])
    assert e.rank == 1
    assert e.bands[1] is None
    assert "set-point 2 is constant" in e.sentences[0]
    assert excitation([segment(np.full((N, 1), 7.0))]).rank == 0
    unknown = excitation([segment(np.full((N, 1), np.nan))])
    assert unknown.rank == 0
    assert not unknown.sufficient


def test_counts() -> None:
    r = np.zeros((N, 1))
    r[1000:] += 2.0
    r[3000:] -= 5.0
    e = excitation([segment(r)])
    assert e.changes.tolist() == [2]
    assert e.total_variation[0] == pytest.approx(7.0)
    assert e.std[0] == pytest.approx(np.std(r))


def test_quanta_of_a_stepped_signal() -> None:
    rng = np.random.default_rng(0)
    u = 0.25 * np.cumsum(rng.integers(-3, 4, (N, 1)), axis=0)
    e = excitation([segment(u, u=u)], "u")
    assert e.quanta[0] == pytest.approx(np.std(u) / 0.25, rel=1e-6)
    assert "OP 1" in e.names


def test_the_band_ends_where_noise_begins() -> None:
    # white noise through a lag at 0.05 rad/s, seen in white noise: the spectra cross at a known frequency
    rng = np.random.default_rng(0)
    n, pole = 200_000, np.exp(-0.05 * H)
    from scipy.signal import lfilter

    r = lfilter([1 - pole], [1, -pole], rng.standard_normal((n, 1)), axis=0)
    noise = 0.05
    e = excitation([segment(r, noise)])
    z = np.exp(-1j * e.w * H)
    crossing = e.w[np.argmax(np.abs((1 - pole) / (1 - pole * z)) ** 2 < noise**2)]
    band = e.bands[0]
    assert band is not None
    assert band[0] == pytest.approx(e.w[0])
    # eight windows: the periodogram scatters, so that the first drop below the noise comes somewhat early
    assert 0.3 * crossing < band[1] <= 1.3 * crossing
    assert e.power_share[0] > 0.9


def test_wrong_use() -> None:
    with pytest.raises(DataError, match="at least one segment"):
        excitation([])
    with pytest.raises(DataError, match="excitation of 'y'"):
        excitation([segment(np.zeros((N, 1)))], "y")  # type: ignore[arg-type]
