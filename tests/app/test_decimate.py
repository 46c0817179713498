"""Decimation keeps every minimum and maximum, as a plain loop finds them."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from trueplant.app.levels import BLOCK, BLOCKS
from trueplant.app.screens.decimate import Signal, breaks, coarse, edges_of
from trueplant.arrays import Array, IntArray


def brute_force(x: Array, edges: IntArray) -> tuple[list[float], list[float]]:
    low, high = [], []
    for a, b in pairwise(edges.tolist()):
        known = [value for value in x[a:b].tolist() if value == value]
        low.append(min(known) if known else np.nan)
        high.append(max(known) if known else np.nan)
    return low, high


def record(n: int, seed: int) -> tuple[Array, Array]:
    """Times with gaps and uneven steps, and a signal with missing samples, long holes and spikes."""
    rng = np.random.default_rng(seed)
    t = np.cumsum(rng.choice([1.0, 1.0, 1.0, 1.5, 40.0], n, p=[0.5, 0.3, 0.1, 0.099, 0.001]))
    x = np.cumsum(rng.normal(size=n))
    x[rng.integers(0, n, n // 50)] = np.nan
    x[n // 3 : n // 3 + n // 10] = np.nan
    x[rng.integers(0, n, 20)] += 50.0
    return t, x


@pytest.mark.parametrize("n", [1, 2, BLOCK - 1, BLOCK, BLOCK + 1, 5000, 40 * BLOCK, 40 * BLOCK + 17])
@pytest.mark.parametrize("points", [2, 7, 50])
def test_every_extreme_of_every_view_is_kept(n: int, points: int) -> None:
    t, x = record(max(n, 20), n + points)
    t, x = t[:n], x[:n]
    signal = Signal.of(x)
    rng = np.random.default_rng(n)
    for start, end in [(t[0], t[-1]), *np.sort(rng.uniform(t[0] - 5, t[-1] + 5, (25, 2)), axis=1)]:
        edges = edges_of(t, start, end, points)
        low, high = signal.extremes(edges)
        expected = brute_force(signal.x, edges)
        np.testing.assert_array_equal(low, expected[0])
        np.testing.assert_array_equal(high, expected[1])
        assert np.all(np.diff(edges) > 0)
        assert edges.size - 1 <= points + 2
        inside = np.flatnonzero((t >= start) & (t <= end))
        if inside.size:
            assert edges[0] <= inside[0] and inside[-1] < edges[-1]


def test_struck_samples_are_gaps_and_set_no_extreme() -> None:
    t, x = record(60 * BLOCK + 5, 3)
    struck = np.zeros(x.size, dtype=bool)
    struck[100:130] = struck[17 * BLOCK : 19 * BLOCK + 3] = struck[-2:] = True
    signal = Signal.of(x).without(struck)
    expected = np.where(struck, np.nan, signal.x)
    for points in (4, 12, 4000, 10**6):
        edges = edges_of(t, t[0], t[-1], points)
        for found, brute in zip(signal.extremes(edges), brute_force(expected, edges), strict=True):
            np.testing.assert_array_equal(found, brute)
    again = signal.without(np.zeros(x.size, dtype=bool))
    whole = edges_of(t, t[0], t[-1], 4)
    np.testing.assert_array_equal(again.extremes(whole)[1], Signal.of(x).extremes(whole)[1])


def test_a_view_of_many_samples_is_made_from_blocks() -> None:
    x = np.arange(BLOCK * 1000, dtype=float)
    edges = edges_of(x, 0.0, x[-1], 20)
    assert coarse(edges, x.size) and edges[0] == 0 and edges[-1] == x.size
    widths = np.diff(edges)
    assert widths.min() > widths.max() - 2 * BLOCK * BLOCKS
    assert not coarse(edges_of(x, 10.0, 300.0, 20), x.size)


def test_stretches_are_equal_in_time_and_empty_ones_are_left_out() -> None:
    t = np.concatenate([np.arange(100.0), 1000 + np.arange(100.0)])
    edges = edges_of(t, t[0], t[-1], 11)
    begins = t[edges[:-1]]
    assert not np.any((begins > 100) & (begins < 1000))
    assert breaks(t, edges, 5.0).sum() == 1
    assert begins[breaks(t, edges, 5.0)] == [1000.0]


def test_a_view_beside_the_record_is_empty_but_for_its_nearest_sample() -> None:
    t = np.arange(10.0)
    assert edges_of(t, 20.0, 30.0, 5).tolist() == [9, 10]
    assert Signal.of(t).extremes(edges_of(t, 20.0, 30.0, 5))[0].tolist() == [9.0]
