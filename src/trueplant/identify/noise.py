"""Autoregressive noise models: filtering with missing samples, estimation, choice of the order."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trueplant.arrays import Array, BoolArray
from trueplant.compiled import compiled
from trueplant.identify import levels
from trueplant.identify.lagged import moments_of_past

BLOCK = 1024
"""Samples that are filtered at a time."""


def whiten(ar: Array, x: Array) -> Array:
    """``x[k] + a1 x[k-1] + ... `` along the first axis of x (n,) or (n, m), without the first len(ar) samples."""
    rows = np.ascontiguousarray(x.T, dtype=float).reshape(-1, len(x))
    out = np.empty((len(rows), max(rows.shape[1] - len(ar), 0)))
    filter_rows(np.concatenate([[1.0], ar]), rows, 0, out)
    return out[0] if x.ndim == 1 else out.T


@compiled
def filter_rows(taps: Array, rows: Array, first: int, out: Array) -> None:
    """``taps[0] x[k] + taps[1] x[k-1] + ...`` of rows x (m, N) into (m, n), from sample k = len(taps) - 1 + first on.

    In blocks that stay in the fastest cache, tap by tap.
    """
    p, n = taps.size - 1, out.shape[1]
    for i in range(out.shape[0]):
        for begin in range(0, n, BLOCK):
            end = min(begin + BLOCK, n)
            block = out[i, begin:end]
            block[:] = taps[0] * rows[i, begin + first + p : end + first + p]
            for tap in range(1, p + 1):
                past = rows[i, begin + first + p - tap : end + first + p - tap]
                for k in range(block.size):
                    block[k] += taps[tap] * past[k]


@compiled
def whitened_valid(order: int, valid: BoolArray) -> BoolArray:
    """Where a prediction error of this order uses measured samples only."""
    good = np.zeros(max(valid.size - order, 0), dtype=np.bool_)
    run = 0
    for k in range(valid.size):
        run = run + 1 if valid[k] else 0
        if k >= order:
            good[k - order] = run > order
    return good


@compiled
def measured_from(order: int, valid: BoolArray) -> tuple[int, bool]:
    """The first prediction error of this order that uses measured samples only, -1 for none; do all from there on?"""
    first, run = -1, 0
    for k in range(valid.size):
        if not valid[k]:
            if first >= 0:
                return first, False
            run = 0
            continue
        run += 1
        if first < 0 and run > order:
            first = k - order
    return first, True


def lagged(v: Array, order: int) -> Array:
    """v[k-1], ..., v[k-order] for k from order on: (n - order, order) of v (n,), (n - order, order m) of v (n, m)."""
    wide = v if v.ndim == 2 else v[:, None]
    columns = [wide[order - k : len(v) - k].T for k in range(1, order + 1)]
    return np.concatenate([np.zeros((0, max(len(v) - order, 0))), *columns]).T


@dataclass(frozen=True, eq=False)
class _Moments:
    """Sums of products of v and its lags up to an order, over samples where all of them were measured."""

    gram: Array
    moment: Array
    power: float
    count: int


def _moments(signals: Sequence[Array], valid: Sequence[BoolArray], order: int) -> _Moments:
    gram, moment, power, count = np.zeros((order, order)), np.zeros(order), 0.0, 0
    for v, ok in zip(signals, valid, strict=True):
        if len(v) <= order:
            continue
        use = whitened_valid(order, ok)
        now = v[order:][use]
        own, products = moments_of_past(np.where(ok, v, 0.0), use, order)
        moment += own
        gram += products
        power += float(now @ now)
        count += now.size
    return _Moments(gram, moment, power, count)


def _solve(sums: _Moments, order: int) -> tuple[Array, float]:
    """Coefficients and residual sum of squares of an order not above that of the sums."""
    gram, moment = sums.gram[:order, :order], sums.moment[:order]
    scale = np.trace(gram) / order if order else 0.0
    if scale <= 0 or sums.count <= order:
        return np.zeros(order), sums.power
    coefficients = np.asarray(np.linalg.solve(gram + 1e-12 * scale * np.eye(order), moment), dtype=float)
    return coefficients, max(sums.power - float(moment @ coefficients), 0.0)


def fit_ar(signals: Sequence[Array], valid: Sequence[BoolArray], order: int) -> tuple[Array, float, int]:
    """Least-squares AR coefficients (order,), residual variance and number of residuals."""
    sums = _moments(signals, valid, order)
    coefficients, power = _solve(sums, order)
    return -coefficients, power / max(sums.count - order, 1), sums.count


def choose_order(signals: Sequence[Array], valid: Sequence[BoolArray], largest: int) -> int:
    """Order with the least Bayesian criterion on common data.

    Akaike's larger orders fit what the structure leaves out as if it were noise, at the price of the low
    frequencies; on simulated data of the right structure the two agree in the estimates. More than the usual orders
    are looked at as long as nearly all of those looked at are asked for.
    """
    most = min(levels.USUAL_ORDER, largest)
    order = _best_order(signals, valid, most)
    while order + levels.SPARE_ORDERS >= most < largest:
        most = min(2 * most, largest)
        order = _best_order(signals, valid, most)
    return order


def _best_order(signals: Sequence[Array], valid: Sequence[BoolArray], largest: int) -> int:
    sums = _moments(signals, valid, largest)
    powers = _left_by_order(sums.gram, sums.moment, sums.power, levels.LOST**2)
    orders = np.arange(largest + 1)
    bearable = (sums.count >= levels.FEWEST_PER_ORDER * (orders + 2)) & (powers > 0)
    most = largest + 1 if bearable.all() else int(np.argmin(bearable))
    if most == 0:
        return 0
    criterion = sums.count * np.log(powers[:most] / sums.count) + np.log(sums.count) * orders[:most]
    return int(np.argmax(criterion <= criterion.min() + 1e-9))


@compiled
def _left_by_order(gram: Array, moment: Array, power: float, least: float) -> Array:
    """(order + 1,) residual sums of squares of all orders, from one Cholesky factor.

    A lag that those before it make up for, to the `least` share of the mean square, explains nothing.
    """
    order = moment.size
    left, taken, factor = np.full(order + 1, power), np.zeros(order), np.zeros((order, order))
    least *= np.trace(gram) / max(order, 1)
    for j in range(order):
        for k in range(j):
            if factor[k, k] > 0:
                factor[j, k] = (gram[j, k] - factor[j, :k] @ factor[k, :k]) / factor[k, k]
        pivot = gram[j, j] - factor[j, :j] @ factor[j, :j]
        if pivot > least:
            factor[j, j] = np.sqrt(pivot)
            taken[j] = (moment[j] - factor[j, :j] @ taken[:j]) / factor[j, j]
        left[j + 1] = max(left[j] - taken[j] ** 2, 0.0)
    return left
