"""Initial guesses for rows of several inputs, in closed loop too: step responses of a long ARX model for each."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from trueplant.arrays import Array
from trueplant.errors import Refused
from trueplant.identify import levels
from trueplant.identify.instrumental.order import Order
from trueplant.identify.instrumental.samples import Samples


def step_records(orders: Sequence[Order], samples: Sequence[Samples]) -> list[Samples]:
    """For each element a record of its own: a unit step and the response that a long ARX model foretells.

    y[k] = sum_i a_i y[k-i] + sum_j sum_i b_ji u_j[k-i] + c, i from 1 to the lags with the least Akaike criterion: a
    model of plant and noise that is long enough for either, and so consistent in closed loop.
    """
    total = sum(s.t.size for s in samples)
    thin = max(1, -(-total // levels.ARX_MOST_SAMPLES))
    columns = [order.column for order in orders]
    steps = {s.h for s in samples}
    if None in steps:
        raise Refused("rows of several inputs need records on a uniform grid, or a start: resample the records to one")
    h = thin * float(max(x for x in steps if x is not None))
    series = [_thinned(s, columns, thin) for s in samples]
    best: tuple[float, Array, int] | None = None
    longest = max(levels.ARX_LAGS)
    for lags in levels.ARX_LAGS:
        phi, target = _regression(series, lags, longest)
        if len(target) < 3 * phi.shape[1]:
            break
        weights = np.asarray(np.linalg.lstsq(phi, target, rcond=1e-12)[0], dtype=float)
        left = target - phi @ weights
        criterion = target.size * np.log(max(float(left @ left), 1e-300)) + 2 * phi.shape[1]
        if best is None or criterion < best[0]:
            best = criterion, weights, lags
    if best is None:
        raise Refused("the records are too short for a first look at several inputs: give a start, or fewer elements")
    _, weights, lags = best
    past = np.r_[1.0, -weights[:lags]]
    count = levels.ARX_HORIZON * lags
    found = []
    for j, order in enumerate(orders):
        ahead = np.r_[0.0, weights[(1 + j) * lags : (2 + j) * lags]]
        response = lfilter(ahead, past, np.ones(count))
        inputs = np.zeros((max(columns) + 1, count + 1))
        inputs[order.column, 1:] = 1.0
        y = np.r_[0.0, np.where(np.isfinite(response), response, 0.0)]
        hold = tuple("zoh" for _ in range(len(inputs)))
        t = np.asarray(h * np.arange(count + 1), dtype=float)
        found.append(Samples(t, y, np.ones(y.size, bool), inputs, hold, True, (), h))
    return found


def _thinned(samples: Samples, columns: Sequence[int], thin: int) -> tuple[Array, Array, NDArray[np.bool_]]:
    """y, inputs (N, n) averaged over each step, and where y was measured."""
    count = samples.t.size // thin
    inputs = samples.inputs[list(columns), : count * thin].reshape(len(columns), count, thin).mean(axis=2).T
    return samples.y[: count * thin : thin], np.asarray(inputs), samples.valid[: count * thin : thin]


def _regression(
    series: Sequence[tuple[Array, Array, NDArray[np.bool_]]], lags: int, longest: int
) -> tuple[Array, Array]:
    rows, targets = [], []
    for y, inputs, valid in series:
        if y.size <= longest + 1:
            continue
        windows = [np.lib.stride_tricks.sliding_window_view(x, lags + 1)[longest - lags :] for x in [y, *inputs.T]]
        whole = np.lib.stride_tricks.sliding_window_view(valid, lags + 1)[longest - lags :].all(axis=1)
        blocks = [w[:, lags - 1 :: -1] if lags > 1 else w[:, :1] for w in windows]
        rows.append(np.hstack([*blocks, np.ones((whole.size, 1))])[whole])
        targets.append(windows[0][whole, -1])
    if not rows:
        return np.zeros((0, 1)), np.zeros(0)
    return np.vstack(rows), np.concatenate(targets)
