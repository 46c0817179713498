"""Autoregressive noise models: filtering with missing samples, estimation, choice of the order."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
BoolArray = NDArray[np.bool_]


def whiten(ar: Array, x: Array) -> Array:
    """``x[k] + a1 x[k-1] + ... `` along the first axis, without the first len(ar) samples."""
    p, n = len(ar), len(x)
    out = x[p:].copy()
    for k, a in enumerate(ar, start=1):
        out += a * x[p - k : n - k]
    return out


def whitened_valid(order: int, valid: BoolArray) -> BoolArray:
    """Where a prediction error of this order uses measured samples only."""
    bad = np.concatenate([[0], np.cumsum(~valid)])
    good: BoolArray = bad[order + 1 :] == bad[: len(bad) - order - 1]
    return good


def lagged(v: Array, order: int) -> Array:
    """Columns v[k-1], ..., v[k-order] for k from order on."""
    return np.column_stack([v[order - k : len(v) - k] for k in range(1, order + 1)]) if order else np.zeros((len(v), 0))


def fit_ar(
    signals: Sequence[Array], valid: Sequence[BoolArray], order: int, skip: int | None = None
) -> tuple[Array, float, int]:
    """Least-squares AR coefficients, residual variance and number of residuals.

    `skip` (default: the order) samples are left out at each start, so that orders can be compared on equal data.
    """
    skip = order if skip is None else skip
    gram, moment, power, count = np.zeros((order, order)), np.zeros(order), 0.0, 0
    for v, ok in zip(signals, valid, strict=True):
        if len(v) <= skip:
            continue
        use = whitened_valid(skip, ok)
        columns = lagged(v, order)[skip - order :][use]
        now = v[skip:][use]
        gram += columns.T @ columns
        moment += columns.T @ now
        power += float(now @ now)
        count += now.size
    if order and count > order:
        scale = np.trace(gram) / order
        coefficients = np.linalg.solve(gram + 1e-12 * scale * np.eye(order), moment) if scale > 0 else np.zeros(order)
    else:
        coefficients = np.zeros(order)
    variance = (power - float(moment @ coefficients)) / max(count - order, 1)
    return -coefficients, max(variance, 0.0), count


def choose_order(signals: Sequence[Array], valid: Sequence[BoolArray], largest: int) -> int:
    """Order with the least Bayesian criterion on common data.

    Akaike's larger orders fit what the structure leaves out as if it were noise, at the price of the low
    frequencies; on simulated data of the right structure the two agree in the estimates.
    """
    best, order = np.inf, 0
    for p in range(largest + 1):
        _, variance, count = fit_ar(signals, valid, p, skip=largest)
        if count < 5 * (p + 2) or variance <= 0:
            break
        criterion = count * np.log(variance * (count - p) / count) + np.log(count) * p
        if criterion < best - 1e-9:
            best, order = criterion, p
    return order
