"""What one PV shows about its own sensor and historian: held, quantised, spiking, frozen."""

from __future__ import annotations

import numpy as np

from trueplant.arrays import Array, BoolArray
from trueplant.record.runs import equal_runs, spread

_SPIKE_SCALE = 4.5
"""Spikes exceed this many standard deviations of the changes between updates, on both sides."""
_SPIKE_SAMPLES = 3
_FROZEN_TIMES = 10


def update_every(y: Array) -> float:
    """Samples between two real updates of a PV that is held in between; 1 if it is not held.

    A held PV changes only after (about) whole multiples of the same number of samples.
    """
    begin, _ = equal_runs(y)
    gaps = np.diff(begin[1:])
    if gaps.size < 20:
        return 1.0
    shortest = float(np.quantile(gaps, 0.02))
    if shortest < 2:
        return 1.0
    k = float(np.mean(gaps[gaps <= 1.7 * shortest]))
    near = gaps[gaps <= 3.3 * k]
    fits = np.abs(near - k * np.round(near / k)) <= 0.3 * k
    return k if np.mean(fits) >= 0.9 else 1.0


def quantum(y: Array) -> float:
    """The smallest increment of which nearly all small changes of y are whole multiples; 0 if there is none."""
    d = np.abs(np.diff(y))
    # what a settled signal moves by in its last digits is no quantisation
    d = d[d > 1e-9 * np.max(np.abs(y), initial=0.0)]
    if d.size < 20:
        return 0.0
    low = float(np.quantile(d, 0.05, method="lower"))
    q = float(np.median(d[(d >= low * (1 - 1e-9)) & (d <= 1.3 * low)]))
    for _ in range(3):
        k = np.round(d / q)
        use = (k >= 1) & (k <= 10)
        if np.sum(use) < 10:
            return 0.0
        q = float(np.sum(d[use] * k[use]) / np.sum(k[use] ** 2))
    k = np.round(d / q)
    use = (k >= 1) & (k <= 10)
    rest = np.abs(d[use] / q - k[use])
    distinct = np.unique(np.round(d / q, 3)).size
    return q if np.quantile(rest, 0.95) < 0.12 and distinct < 0.5 * d.size else 0.0


def spikes(y: Array, every: float, q: float) -> BoolArray:
    """Where y leaves its neighbours for up to three samples (or one update, if it is held) and comes back.

    Updates are compared with the medians of the three before and the three after, which agree on a spike and differ
    on a step. The scale is the median absolute change between updates (a Hampel identifier on changes), at least a
    few quanta; an excursion must also stand out from how its own neighbours differ.
    """
    begin, length = equal_runs(y)
    v = y[begin]
    out = np.zeros(y.size, dtype=bool)
    if v.size < 9:
        return out
    change = np.abs(np.diff(v))
    floor = max(_SPIKE_SCALE * 1.4826 * float(np.median(change)), 3.5 * q)
    longest = max(_SPIKE_SAMPLES, round(1.5 * every))
    for m in (1, 2, 3):
        a = np.arange(3, v.size - m - 2)
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
        hit = (size > floor) & (size > 2 * smooth) & (samples <= longest)
        for i in range(m):
            out |= spread(begin[a[hit] + i], length[a[hit] + i], y.size)
    return out


def _middle(a: Array, b: Array, c: Array) -> Array:
    """Elementwise median of three."""
    return np.maximum(np.minimum(a, b), np.minimum(np.maximum(a, b), c))


def frozen(y: Array, u: Array) -> BoolArray:
    """Where y stays at one value far longer than it ever does otherwise, although OP (N, n_u) moves.

    Only a stop that cannot be a real rest counts: before it (after it, at the start of a record) y was noisy or was
    moving in large steps, so that a simulated or coarsely rounded loop at rest is not taken for a dead sensor.
    """
    begin, length = equal_runs(y)
    out = np.zeros(y.size, dtype=bool)
    if begin.size < 20:
        return out
    candidates = np.flatnonzero(length > max(10.0, _FROZEN_TIMES * float(np.quantile(length, 0.95))))
    v, span = y[begin], np.ptp(u, axis=0)
    change = np.diff(v)
    smallest = float(np.min(np.abs(change)))
    for k in candidates:
        around = change[max(0, k - 20) : k] if k >= 5 else -change[k : k + 20][::-1]
        turns = float(np.mean(np.diff(np.sign(around)) != 0)) if around.size > 4 else 0.0
        noisy = turns > 0.25 and bool(np.median(np.abs(around)) > 1e-6 * np.ptp(y))
        last = np.abs(around[-5:])
        moving = k >= 5 and bool(np.min(last) > max(1e-4 * np.ptp(y), 2 * smallest))
        piece = u[begin[k] : begin[k] + length[k]]
        if (noisy or moving) and np.any(np.ptp(piece, axis=0) > 0.05 * span):
            out |= spread(begin[k : k + 1], length[k : k + 1], y.size)
    return out
