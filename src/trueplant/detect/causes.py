"""A test that distinguishes causes: common factors of gains."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2, norm

from trueplant.arrays import Array


@dataclass(frozen=True)
class CommonFactor:
    """All gains of a row or a column have changed by the same factor."""

    kind: str
    """"row" (one output: its sensor) or "column" (one input: its actuator)."""
    index: int
    factor: float
    std_error: float
    p_equal: float
    """That the factors are the same."""


def common_factors(ratio: Array, covariance: Array, present: NDArray[np.bool_], level: float) -> list[CommonFactor]:
    """Rows and columns whose gains have all changed, and by the same factor.

    ratio (n_y, n_u): plant over model of each gain, NaN where it is not known; covariance (n_y n_u, n_y n_u) of them,
    row after row; present (n_y, n_u): the elements that there are. Every gain of the row or column has to differ from
    the model's by itself at `level` (two-sided, Bonferroni over the elements), and their equality must not be
    rejected at `level` (Wald test of the differences). One gain alone can come from anywhere and is not reported.
    """
    n_y, n_u = ratio.shape
    limit = norm.isf(level / (2 * max(int(present.sum()), 1)))
    index = np.arange(n_y * n_u).reshape(n_y, n_u)
    lines = [("row", i, index[i][present[i]]) for i in range(n_y)]
    lines += [("column", j, index[:, j][present[:, j]]) for j in range(n_u)]
    found = []
    for kind, k, members in lines:
        values = ratio.ravel()[members]
        if members.size < 2 or not np.isfinite(values).all():
            continue
        cov = covariance[np.ix_(members, members)]
        if np.any(np.abs(values - 1) < limit * np.sqrt(np.diag(cov))):
            continue
        weights = np.linalg.solve(cov, np.ones(members.size))
        factor = float(weights @ values / weights.sum())
        off = values - factor
        p_equal = float(chi2.sf(off @ np.linalg.solve(cov, off), members.size - 1))
        if p_equal >= level:
            found.append(CommonFactor(kind, k, factor, float(weights.sum() ** -0.5), p_equal))
    return found
