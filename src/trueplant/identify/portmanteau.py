"""Portmanteau tests: are errors related to their own past, or to that of another signal?

The statistic sums the squared correlations over many lags (Box and Pierce 1970; for several outputs Hosking 1980), each
times the number of products that it is the mean of. Without any relation it is chi-square.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2, norm, rankdata

from trueplant.arrays import Array, BoolArray


@dataclass(frozen=True, eq=False)
class Correlogram:
    """Correlation of errors with the past of a signal."""

    value: Array
    """(lags, n, m) at 1, 2, ... samples: between errors and signals that were made white and of variance 1."""
    pairs: Array
    """(lags,) products in each mean; the variance of an entry without relation is one over it."""
    count: int
    """Errors that there are."""

    def p_value(self, estimated: int = 0) -> float:
        """That there is no relation. `estimated` parameters have taken their degrees of freedom."""
        statistic = float(self.pairs @ np.sum(self.value**2, axis=(1, 2)))
        freedom = int(np.sum(self.pairs > 0)) * self.value.shape[1] * self.value.shape[2] - estimated
        return float(chi2.sf(statistic, max(freedom, 1)))


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
