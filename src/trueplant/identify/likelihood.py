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
from scipy.stats import chi2, f

from trueplant.arrays import Array, BoolArray, IntArray
from trueplant.identify.fit import RowFit, fit_row
from trueplant.identify.row import Row, Spec


def ratio_p(rise: float, freedom: int, left: float = np.inf) -> float:
    """p-value of a rise of -2 log likelihood by so many restrictions.

    `left` is the degrees of freedom from which the noise is known; finite, they make an F-test of it (Kenward and Roger
    1997).
    """
    if np.isinf(left):
        return float(chi2.sf(max(rise, 0.0), freedom))
    return float(f.sf(max(rise, 0.0) / freedom, freedom, left))


def held_at(fit: RowFit, index: IntArray, values: Array) -> RowFit:
    """The fit with theta[index] held at these values, as far as its limits let them be."""
    theta, free = fit.theta.copy(), fit.free.copy()
    low, high = fit.row.limits()
    theta[index] = np.clip(values, low[index], high[index])
    free[index] = False
    return fit_row(fit.row, theta, fit.ar, weights=fit.weights, free=free, reweight=False)


def at_model(fit: RowFit) -> RowFit:
    """The fit with its free parameters at their model, where they have one, to start another from."""
    both = zip(fit.row.specs, fit.row.slices, strict=True)
    initial = [fit.theta[part] if spec.initial is None else spec.initial for spec, part in both]
    theta = np.clip(np.concatenate([np.zeros(0), *initial]), *fit.row.bounds())
    return replace(fit, theta=np.where(fit.free, theta, fit.theta))


def rise(fit: RowFit, other: RowFit) -> float:
    """By how much -2 log likelihood rises from a fit to a more restricted one."""
    return max(float(fit.left * np.log(max(other.cost, 1e-300) / max(fit.cost, 1e-300))), 0.0)


def without_element(fit: RowFit, m: int) -> RowFit:
    """The fit of the others of its row."""
    kept = [k for k in range(len(fit.row.specs)) if k != m]
    row = replace(fit.row, specs=tuple(fit.row.specs[k] for k in kept))
    parts = [fit.theta[fit.row.slices[k]] for k in kept]
    return fit_row(row, np.concatenate([np.zeros(0), *parts]), fit.ar, weights=fit.weights, reweight=False)


def with_element(fit: RowFit, m: int, spec: Spec) -> tuple[Row, BoolArray]:
    """The row with another element m, and which parameters are free: all of that one."""
    part = fit.row.slices[m]
    specs = (*fit.row.specs[:m], spec, *fit.row.specs[m + 1 :])
    new = np.ones(len(spec.structure.names), dtype=bool)
    free = np.concatenate([fit.free[: part.start], new, fit.free[part.stop :]])
    return replace(fit.row, specs=specs, restricted=None), free


def with_parameters(fit: RowFit, m: int, p: Array) -> Array:
    """theta with other parameters for element m."""
    part = fit.row.slices[m]
    return np.concatenate([fit.theta[: part.start], p, fit.theta[part.stop :]])
