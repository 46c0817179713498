"""Slow responses of the plant that its structure lacks: a test of the prediction errors, and the error they cause.

Correlation with the last samples of an input (`residual_tests`) hardly shows a response that lasts for hundreds of
them: its share of each is small. G (lead s + 1)/(lag s + 1) with a slow lag is G at lead = lag, and the score test by
the lead (Rao 1948) needs no fit of it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2, norm

from trueplant.arrays import Array
from trueplant.identify import levels
from trueplant.identify.fit import RowFit, evaluate, fit_row
from trueplant.identify.levels import UNDERMODELLED
from trueplant.identify.linear_algebra import inverse
from trueplant.identify.row import Row

Indices = NDArray[np.intp]


def slow_p(fit: RowFit) -> Array:
    """(n_columns,) p-value that no element responds more slowly than its structure describes.

    1 for inputs whose element is not estimated, integrates, or is so slow that the record does not show more.
    """
    p = np.ones(fit.row.pieces[0].inputs.shape[0])
    for m, spec in enumerate(fit.row.specs):
        if lags := slow_lags(fit, m):
            p[spec.column] = _score_p(fit, m, lags)
    return p


def slow_lags(fit: RowFit, m: int) -> list[float]:
    """The slow lags to try beside element m."""
    spec, p = fit.row.specs[m], fit.theta[fit.row.slices[m]]
    own = spec.structure.lag(p) + spec.structure.longest_dead_time(p)
    longest = max(piece.span for piece in fit.row.pieces) / levels.SLOW_SPANS
    if spec.structure.integrators or own <= 0 or levels.SLOW_LAGS[0] * own > longest:
        return []
    return list(dict.fromkeys(min(times * own, longest) for times in levels.SLOW_LAGS))


def _score_p(fit: RowFit, m: int, lags: list[float]) -> float:
    """p-value of the score by the leads of slow lags that they cancel, all other parameters estimated along."""
    row, theta, own = _with_slow(fit, m, lags, lags)
    point = evaluate(row, theta, fit.ar, fit.weights)
    noise = np.arange(theta.size, theta.size + fit.ar.size)
    known = np.concatenate([own[fit.free], noise])
    leads = np.setdiff1d(np.flatnonzero(row.is_lead), own)
    explained = [
        point.slope[of] @ inverse(point.information[np.ix_(of, of)]) @ point.slope[of]
        for of in (known, np.concatenate([known, leads]))
    ]
    return float(chi2.sf((explained[1] - explained[0]) / fit.variance, len(lags)))


def _with_slow(fit: RowFit, m: int, lags: list[float], leads: list[float]) -> tuple[Row, Array, Indices]:
    """The row with slow lags and leads in element m, its parameters, and the places of those of the fit in them."""
    spec = fit.row.specs[m]
    old = spec.structure
    wider = replace(old, lags=old.lags + len(lags), leads=old.leads + len(leads))
    slow = replace(spec, structure=wider, initial=None)
    row = replace(fit.row, specs=(*fit.row.specs[:m], slow, *fit.row.specs[m + 1 :]))
    first = fit.row.slices[m].start
    places = np.arange(fit.theta.size)
    places[fit.row.slices[m]] = [first + wider.names.index(name) for name in old.names]
    places[fit.row.slices[m].stop :] += len(lags) + len(leads)
    theta = np.empty(row.size)
    theta[places] = fit.theta
    for k, (lag, lead) in enumerate(zip(lags, leads, strict=True), start=1):
        theta[first + wider.names.index(f"tau{old.lags + k}")] = lag
        theta[first + wider.names.index(f"lead{old.leads + k}")] = lead
    return row, theta, places


def slow_errors(fit: RowFit, p: Array, confidence: float) -> Array:
    """(size,) standard errors for what a slow lag and lead would change where the row lacks them; 0 elsewhere.

    Intervals that they are added to reach as far as those of the fit that has both. `p` is that of `slow_p`. Where that
    fit finds no slow lag, the plant is of higher order than its structure, and nothing is said of its gain.
    """
    errors = np.zeros(fit.theta.size)
    for m, spec in enumerate(fit.row.specs):
        if p[spec.column] < UNDERMODELLED:
            wider, own = _refitted(fit, m)
            if _slowest(wider, m) < slow_lags(fit, m)[0]:
                continue
            shift = np.abs(wider.theta[own] - fit.theta)
            sigma = np.sqrt(np.diag(wider.covariance)[own])
            errors = np.maximum(errors, shift / norm.ppf(0.5 + confidence / 2) + sigma)
    return np.where(fit.free, errors, 0.0)


def _slowest(fit: RowFit, m: int) -> float:
    """The largest lag of element m."""
    return float(np.max(fit.theta[fit.row.slices[m]][fit.row.specs[m].structure.is_lag]))


def _refitted(fit: RowFit, m: int) -> tuple[RowFit, Indices]:
    """The fit with a slow lag and lead in element m, and the places of the parameters of the given one."""
    rivals = []
    for lag in slow_lags(fit, m):
        row, theta, own = _with_slow(fit, m, [lag], [lag])
        free = np.ones(theta.size, dtype=bool)
        free[own] = fit.free
        rivals.append(fit_row(row, theta, fit.ar, weights=fit.weights, free=free, reweight=False))
    return min(rivals, key=lambda rival: rival.cost), own
