"""Portmanteau tests: are errors related to their own past, or to that of another signal?

The statistic sums the squared correlations over many lags (Box and Pierce 1970; for several outputs Hosking 1980), each
times the number of products that it is the mean of. Without any relation it is chi-square.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.stats import chi2, norm, rankdata

from trueplant.arrays import Array, BoolArray
from trueplant.identify.autoregression import Lags
from trueplant.identify.levels import LOST


@dataclass(frozen=True, eq=False)
class Correlogram:
    """Correlation of errors with the past of a signal."""

    value: Array
    """(lags, n, m) at 1, 2, ... samples: between errors and signals that were made white and of variance 1."""
    pairs: Array
    """(lags,) products in each mean; the variance of an entry without relation is one over it."""
    count: int
    """Errors that there are."""

    def p_value(self, estimated: int = 0, beyond: Relation | None = None) -> float:
        """That there is no relation, `beyond` these lags either.

        `estimated` parameters have taken their degrees of freedom.
        """
        statistic = float(self.pairs @ np.sum(self.value**2, axis=(1, 2)))
        freedom = int(np.sum(self.pairs > 0)) * self.value.shape[1] * self.value.shape[2] - estimated
        if beyond is not None:
            statistic, freedom = statistic + beyond.statistic, freedom + beyond.freedom
        return float(chi2.sf(statistic, max(freedom, 1)))


class Relation(NamedTuple):
    """What a signal explains of errors."""

    statistic: float
    """Chi-square without relation."""
    freedom: int


def relation_beyond(errors: Sequence[Array], past: Sequence[Array], lags: Lags) -> Relation:
    """Of errors, one (N,) a record, with the past of a signal in groups of lags, beside what its single lags explain.

    An element answers for as long as its lag and dead time are; sampled finely, that is far beyond a few samples, and
    no single one of so many shows.
    """
    gram, moment, squares, count = np.zeros((lags.order, lags.order)), np.zeros(lags.order), 0.0, 0
    for e, x in zip(errors, past, strict=True):
        if len(e) <= lags.reach:
            continue
        now = e[lags.reach :]
        there = np.isfinite(now)
        before = np.compress(there, lags.past(x, lags.reach), axis=1)
        gram += before @ before.T
        moment += before @ now[there]
        squares += float(now[there] @ now[there])
        count += int(there.sum())
    if not lags.groups or not squares > 0:
        return Relation(0.0, 0)
    near, far = slice(0, lags.single), slice(lags.single, None)
    shares = np.linalg.lstsq(gram[near, near], gram[near, far], rcond=LOST)[0].T
    left, told = gram[far, far] - shares @ gram[near, far], moment[far] - shares @ moment[near]
    weights, _, rank, _ = np.linalg.lstsq(left, told, rcond=LOST)
    return Relation(float(told @ weights) / (squares / count), int(rank))


def correlogram(errors: Sequence[Array], lags: int, past: Sequence[Array] | None = None) -> Correlogram:
    """Of errors, one (N,) or (N, n) a record, with their own past or with that of other signals (N,) or (N, m).

    NaN stands for what was not measured; a sample counts where all of it was.
    """
    own = [_measured(e) for e in errors]
    other = own if past is None else [_measured(x) for x in past]
    n, m = own[0][0].shape[1], other[0][0].shape[1]
    products, pairs = np.zeros((lags, n, m)), np.zeros(lags)
    for (e, there), (x, also) in zip(own, other, strict=True):
        for lag in range(1, min(lags + 1, len(e))):
            products[lag - 1] += e[lag:].T @ x[:-lag]
            pairs[lag - 1] += there[lag:] @ also[:-lag]
    left, right = _whitening(own), _whitening(other)
    value = left @ (products / np.maximum(pairs, 1.0)[:, None, None]) @ right.T
    return Correlogram(value, pairs, int(sum(there.sum() for _, there in own)))


def normal_scores(series: Sequence[Array]) -> list[Array]:
    """Errors of one distribution, (N,) each, NaN kept, as normal ones of the same order (van der Waerden).

    The mean of products is normal where one factor is, however seldom the other one moves. Where both have outliers,
    and in closed loop those of PV come back in OP, a single product can pass for a relation.
    """
    e = np.concatenate(series)
    there = np.isfinite(e)
    scores = np.full(e.size, np.nan)
    scores[there] = norm.ppf((rankdata(e[there]) - 0.5) / max(int(there.sum()), 1))
    return np.split(scores, np.cumsum([x.size for x in series])[:-1])


def _measured(x: Array) -> tuple[Array, Array]:
    """Samples (N, n), 0 where not all of one was measured, and 1 where it was (N,)."""
    columns = x.reshape(len(x), -1)
    there: BoolArray = np.all(np.isfinite(columns), axis=1)
    return np.where(there[:, None], columns, 0.0), there.astype(float)


def _whitening(series: Sequence[tuple[Array, Array]]) -> Array:
    """(n, n) that makes the series uncorrelated and of mean square 1; 0 in directions without any power."""
    power = sum(x.T @ x for x, _ in series) / max(sum(float(there.sum()) for _, there in series), 1.0)
    values, vectors = np.linalg.eigh(power)
    kept = values > 1e-14 * max(float(values[-1]), 1e-300)
    root = np.zeros(values.size)
    root[kept] = 1 / np.sqrt(values[kept])
    return np.asarray((vectors * root) @ vectors.T)
