"""What one PV shows about its own sensor and historian: held, quantised, spiking, frozen."""

from __future__ import annotations

from itertools import product

import numpy as np

from trueplant.arrays import Array, BoolArray, IntArray
from trueplant.record import levels
from trueplant.record.runs import equal_runs, spread, true_runs


def update_every(y: Array) -> float:
    """Samples between two real updates of a PV that is held in between; 1 if it is not held.

    A held PV changes only after (about) whole multiples of the same number of samples.
    """
    begin, _ = equal_runs(y)
    gaps = np.diff(begin[1:])
    if gaps.size < levels.FEWEST_UPDATES:
        return 1.0
    shortest = float(np.quantile(gaps, levels.SHORTEST_UPDATE))
    if shortest < levels.HELD_SAMPLES:
        return 1.0
    k = float(np.mean(gaps[gaps <= levels.SINGLE_UPDATES * shortest]))
    near = gaps[gaps <= levels.FEW_UPDATES * k]
    fits = np.abs(near - k * np.round(near / k)) <= levels.WHOLE_UPDATE * k
    return k if np.mean(fits) >= levels.HELD_SHARE else 1.0


def quantum(y: Array) -> float:
    """The smallest increment of which nearly all small changes of y are whole multiples; 0 if there is none."""
    d = np.abs(np.diff(y))
    d = d[d > levels.SETTLED_MOVE * np.max(np.abs(y), initial=0.0)]
    d = d[:: max(1, d.size // levels.QUANTUM_MOVES)]
    if d.size < levels.FEWEST_UPDATES:
        return 0.0
    low = float(np.quantile(d, levels.SMALLEST_MOVES, method="lower"))
    q = float(np.median(d[(d >= low * (1 - 1e-9)) & (d <= levels.SAME_QUANTUM * low)]))
    for _ in range(levels.QUANTUM_ROUNDS):
        k = np.round(d / q)
        use = (k >= 1) & (k <= levels.MOST_QUANTA)
        if np.sum(use) < levels.FEWEST_QUANTA:
            return 0.0
        q = float(np.sum(d[use] * k[use]) / np.sum(k[use] ** 2))
    k = np.round(d / q)
    use = (k >= 1) & (k <= levels.MOST_QUANTA)
    rest = np.abs(d[use] / q - k[use])
    distinct = np.unique(np.round(d / q, 3)).size
    whole = bool(np.quantile(rest, levels.WHOLE_QUANTUM_SHARE) < levels.WHOLE_QUANTUM)
    return q if whole and distinct < levels.DISTINCT_MOVES * d.size else 0.0


def spikes(y: Array, every: float, q: float) -> BoolArray:
    """Where y leaves its neighbours for up to three samples (or one update, if it is held) and comes back.

    Updates are compared with the medians of the three before and the three after, which agree on a spike and differ
    on a step. The scale is the median absolute change between updates (a Hampel identifier on changes), at least a
    few quanta; an excursion must also stand out from how its own neighbours differ.
    """
    begin, length = equal_runs(y)
    v = y[begin]
    if v.size < levels.SPIKE_UPDATES:
        return np.zeros(y.size, dtype=bool)
    change = np.abs(np.diff(v))
    floor = max(levels.SPIKE_SCALE * levels.NORMAL_MAD * float(np.median(change)), levels.SPIKE_QUANTA * q)
    longest = max(levels.SPIKE_SAMPLES, round(levels.SPIKE_HELD * every))
    found: list[IntArray] = []
    for m, first in product((1, 2, 3), range(3, v.size, levels.BLOCK)):
        a = np.arange(first, min(first + levels.BLOCK, v.size - m - 2))
        before, after = v[a - 1], v[a + m]
        left = _middle(before, v[a - 2], v[a - 3])
        right = _middle(after, v[a + m + 1], v[a + m + 2])
        block = np.stack([v[a + i] for i in range(m)])
        up = np.min(block, axis=0) - np.max([left, right, before, after], axis=0)
        down = np.min([left, right, before, after], axis=0) - np.max(block, axis=0)
        size = np.maximum(up, down)
        # a smooth peak falls off faster farther away, a decay after a step differs between its two sides
        smooth = np.max([np.abs(before - left), np.abs(after - right), np.abs(left - right)], axis=0)
        samples = begin[a + m - 1] + length[a + m - 1] - begin[a]
        hit = a[(size > floor) & (size > levels.SPIKE_SMOOTH * smooth) & (samples <= longest)]
        found += [hit + i for i in range(m)]
    hits = np.unique(np.concatenate(found))
    return spread(begin[hits], length[hits], y.size)


def asked_for(spike: BoolArray, y: Array, r: Array) -> BoolArray:
    """Which of these excursions of y the set-point r made before it, about as far: a fast loop follows."""
    at, length = equal_runs(r)
    before, there, after = r[at[:-2]], r[at[1:-1]], r[at[2:]]
    size = np.maximum(np.minimum(there - before, there - after), np.minimum(before - there, after - there))
    short = (length[1:-1] <= levels.SPIKE_SAMPLES) & (size > 0)
    asked = np.zeros(y.size + levels.ANSWER_SAMPLES)
    asked[at[1:-1][short] + levels.ANSWER_SAMPLES] = size[short]
    begin, last = true_runs(spike)
    lately = np.lib.stride_tricks.sliding_window_view(asked, levels.ANSWER_SAMPLES + 1)[begin].max(axis=1)
    gone = np.abs(y[begin] - y[begin - 1])
    own = lately >= levels.ANSWER_SHARE * gone
    return spread(begin[own], last[own], y.size)


def _middle(a: Array, b: Array, c: Array) -> Array:
    """Elementwise median of three."""
    return np.maximum(np.minimum(a, b), np.minimum(np.maximum(a, b), c))


def frozen(y: Array, u: Array, at: IntArray | slice) -> BoolArray:
    """Where y (n,), the samples `at` of a record, stays at one value far longer than ever else, although OP moves.

    u (N, n_u) is OP of the whole record; where it is missing it counts as 0.

    Only a stop that cannot be a real rest counts: before it (after it, at the start of a record) y was noisy or was
    moving in large steps, so that a simulated or coarsely rounded loop at rest is not taken for a dead sensor.
    """
    begin, length = equal_runs(y)
    out = np.zeros(y.size, dtype=bool)
    if begin.size < levels.FEWEST_UPDATES:
        return out
    usual = float(np.quantile(length, levels.FROZEN_USUAL))
    candidates = np.flatnonzero(length > max(levels.FROZEN_SAMPLES, levels.FROZEN_TIMES * usual))
    if candidates.size == 0:
        return out
    u = np.nan_to_num(u[at])
    v, span = y[begin], np.ptp(u, axis=0)
    change = np.diff(v)
    smallest = float(np.min(np.abs(change)))
    few, many = levels.FROZEN_BEFORE, levels.FROZEN_AROUND
    for k in candidates:
        around = change[max(0, k - many) : k] if k >= few else -change[k : k + many][::-1]
        turns = float(np.mean(np.diff(np.sign(around)) != 0)) if around.size >= few else 0.0
        noisy = turns > levels.FROZEN_TURNS and bool(np.median(np.abs(around)) > levels.FROZEN_NOISE * np.ptp(y))
        least = max(levels.FROZEN_MOVING * np.ptp(y), levels.FROZEN_QUANTA * smallest)
        moving = k >= few and bool(np.min(np.abs(around[-few:])) > least)
        piece = u[begin[k] : begin[k] + length[k]]
        if (noisy or moving) and np.any(np.ptp(piece, axis=0) > levels.FROZEN_OP * span):
            out |= spread(begin[k : k + 1], length[k : k + 1], y.size)
    return out
