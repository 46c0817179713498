"""Tests of a fitted row that do not rest on its curvature: likelihood ratio, and the test of an absent element.

The Wald test takes the estimate to be normal about the truth. Where two lags are equal, where a dead time has
many minima, or in short records it is not, and the likelihood ratio still is what it says. An element that
is not in the model has no lag and no dead time to test against: searching for the pair that fits best and
then testing its gain would find something in any noise (Davies 1987). What the search gains in noise was
measured on simulated records, and is counted as further degrees of freedom.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from trueplant.identify.fit import RowFit, fit_row

Array = NDArray[np.float64]

SEARCHED = 5
"""Degrees of freedom that the search for lag and dead time adds to those of the parameters.

Mean of the statistic over 120 simulated Wood-Berry records without the element: 8.0 with 3 parameters.
"""


def likelihood_ratio_p(fit: RowFit, index: Array, values: Array) -> float:
    """p-value that the parameters theta[index] have these values, all others re-fitted.

    The deviance counts the degrees of freedom that are left, which keeps the level in short records.
    """
    theta = fit.theta.copy()
    low, high = fit.row.bounds()
    theta[index] = np.clip(values, low[index], high[index])
    free = fit.free.copy()
    free[index] = False
    held = fit_row(fit.row, theta, fit.ar, weights=fit.weights, free=free, reweight=False)
    left = max(fit.count - fit.theta.size - fit.ar.size - fit.row.nuisance_count(fit.theta), 1)
    ratio = left * np.log(max(held.cost, 1e-300) / max(fit.cost, 1e-300))
    return float(chi2.sf(max(ratio, 0.0), len(index)))


def absence_p(fit: RowFit, m: int) -> float:
    """p-value that element m of the row is absent: the fit without it is as good as a search in noise would make it."""
    kept = [k for k in range(len(fit.row.specs)) if k != m]
    row = replace(fit.row, specs=tuple(fit.row.specs[k] for k in kept))
    parts = [fit.theta[fit.row.slices[k]] for k in kept]
    without = fit_row(row, np.concatenate([np.zeros(0), *parts]), fit.ar, weights=fit.weights, reweight=False)
    left = max(fit.count - fit.theta.size - fit.ar.size - fit.row.nuisance_count(fit.theta), 1)
    ratio = left * np.log(max(without.cost, 1e-300) / max(fit.cost, 1e-300))
    return float(chi2.sf(max(ratio, 0.0), SEARCHED + len(fit.row.specs[m].structure.names)))
