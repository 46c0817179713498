"""Autoregressive noise models by least squares, and how far back they look."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from trueplant.arrays import Array, BoolArray
from trueplant.compiled import compiled
from trueplant.identify import levels
from trueplant.identify.autoregression import Autoregression, Lags, bridge, furthest

CHUNK = 16_384
"""Samples whose past is written out at a time."""


def lagged(v: Array, order: int) -> Array:
    """v[k-1], ..., v[k-order] for k from order on: (n - order, order) of v (n,), (n - order, order m) of v (n, m)."""
    wide = v if v.ndim == 2 else v[:, None]
    columns = [wide[order - k : len(v) - k].T for k in range(1, order + 1)]
    return np.concatenate([np.zeros((0, max(len(v) - order, 0))), *columns]).T


@dataclass(frozen=True, eq=False)
class _Moments:
    """Sums of products of v and of what coefficients multiply, where all that the furthest reaches was measured."""

    gram: Array
    moment: Array
    power: float
    count: int

    def of(self, chosen: Array) -> _Moments:
        """Those of sums (order, n) of the coefficients."""
        return _Moments(chosen @ self.gram @ chosen.T, chosen @ self.moment, self.power, self.count)


@np.errstate(over="ignore", invalid="ignore")
def _moments(signals: Sequence[Array], valid: Sequence[BoolArray], lags: Lags) -> _Moments:
    """Signals of trials that are far off may overflow: what follows is no number, and the descent refuses it."""
    order, reach = lags.order, lags.reach
    gram, moment, power, count = np.zeros((order, order)), np.zeros(order), 0.0, 0
    for v, ok in zip(signals, valid, strict=True):
        if len(v) <= reach:
            continue
        known, whole = bridge(v, ok), lags.predicted(ok, reach)
        for begin in range(0, whole.size, CHUNK):
            use = whole[begin : begin + CHUNK]
            part = known[begin : begin + reach + use.size]
            now, past = part[reach:][use], np.compress(use, lags.past(part, reach), axis=1)
            gram += past @ past.T
            moment += past @ now
            power += float(now @ now)
            count += now.size
    return _Moments(gram, moment, power, count)


def _solve(sums: _Moments) -> tuple[Array, float]:
    """Coefficients and residual sum of squares."""
    order = sums.moment.size
    scale = np.trace(sums.gram) / order if order else 0.0
    if scale <= 0 or sums.count <= order:
        return np.zeros(order), sums.power
    size = np.sqrt(np.maximum(np.diag(sums.gram), levels.LOST**2 * scale))
    normal = sums.gram / np.outer(size, size) + 1e-12 * np.eye(order)
    coefficients = np.asarray(np.linalg.solve(normal, sums.moment / size) / size, dtype=float)
    return coefficients, max(sums.power - float(sums.moment @ coefficients), 0.0)


def fit_ar(signals: Sequence[Array], valid: Sequence[BoolArray], order: int) -> tuple[Array, float, int]:
    """Least-squares coefficients (order,) of single lags, residual variance and number of residuals."""
    sums = _moments(signals, valid, Lags(order))
    coefficients, power = _solve(sums)
    return -coefficients, power / max(sums.count - order, 1), sums.count


def fit_autoregression(signals: Sequence[Array], valid: Sequence[BoolArray], lags: Lags) -> Autoregression:
    """The noise model of least squares with these lags."""
    return Autoregression(-_solve(_moments(signals, valid, lags))[0], lags)


def choose_lags(signals: Sequence[Array], valid: Sequence[BoolArray], furthest_back: int) -> Lags:
    """Lags with the least Bayesian criterion on common data, none beyond the furthest that the data bear.

    Akaike's larger orders fit what the structure leaves out as if it were noise, at the price of the low
    frequencies; on simulated data of the right structure the two agree in the estimates. Further ones than usual
    are looked at as long as nearly all of those looked at are asked for: they cost the first samples.
    """
    most = min(levels.USUAL_REACH, furthest_back)
    lags = _best_lags(signals, valid, most)
    while with_spare(lags).reach >= most < furthest_back:
        most = min(2 * most, furthest_back)
        lags = _best_lags(signals, valid, most)
    return lags


def with_spare(lags: Lags) -> Lags:
    """With `SPARE_ORDERS` more, of single lags and of groups where there are any."""
    return Lags(lags.single + levels.SPARE_ORDERS, lags.groups + (levels.SPARE_ORDERS if lags.groups else 0))


def _best_lags(signals: Sequence[Array], valid: Sequence[BoolArray], reach: int) -> Lags:
    """Of all numbers of single lags, and of those of groups behind single lags up to where a group begins."""
    singles = min(levels.SINGLE_LAGS, reach)
    most = furthest(singles, reach)
    sums = _moments(signals, valid, most)
    orders = np.arange(reach + 1)
    bearable = sums.count >= levels.FEWEST_PER_ORDER * (orders + 2)
    best, least = Lags(), np.inf
    for single in sorted({*furthest(0, singles).ends.tolist(), singles}):
        lags = furthest(single, reach)
        own = sums.of(_sums_of(most, lags))
        powers = _left_by_order(own.gram, own.moment, own.power, levels.LOST**2)
        allowed = bearable[: powers.size] & (powers > 0)
        powers = powers[: powers.size if allowed.all() else int(np.argmin(allowed))]
        criterion = sums.count * np.log(powers / sums.count) + np.log(sums.count) * orders[: powers.size]
        order = int(np.argmax(criterion <= criterion.min(initial=np.inf) + 1e-9)) if powers.size else 0
        if powers.size and criterion[order] <= least + 1e-9:
            best, least = Lags(min(order, lags.single), max(order - lags.single, 0)), float(criterion[order])
    return best


@lru_cache(maxsize=256)
def _sums_of(of: Lags, lags: Lags) -> Array:
    """(order, order) which coefficients of others each coefficient is the sum of."""
    return np.array(
        [(of.starts >= first) & (of.ends <= last) for first, last in zip(lags.starts, lags.ends, strict=True)],
        dtype=float,
    ).reshape(lags.order, of.order)


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
