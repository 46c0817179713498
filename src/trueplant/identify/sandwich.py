"""Covariance of a fit whose prediction errors are not what its likelihood takes them for.

Where their size changes, or something is left of their colour, the curvature of the likelihood is not its variance:

    covariance = H^-1 M H^-1,    M = sum_l w_l sum_k s[k] s[k - l]',    s[k] = psi[k] e[k]

(Huber 1967; White 1980; with lags Newey and West 1987).
"""

from __future__ import annotations

import numpy as np

from trueplant.arrays import Array
from trueplant.identify import levels
from trueplant.identify.fit import RowFit, linearised
from trueplant.identify.levels import RESIDUAL_LAGS
from trueplant.identify.linear_algebra import inverse
from trueplant.identify.portmanteau import correlogram
from trueplant.identify.validate import ResidualTests, prediction_errors


def homoscedastic_p(fit: RowFit) -> float:
    """p-value that the prediction errors of a fit keep their size."""
    return squares_p(prediction_errors(fit))


def squares_p(e: Array, lags: int = RESIDUAL_LAGS) -> float:
    """p-value that errors e (n,), NaN where there are none, keep their size (McLeod and Li 1983).

    Squares of errors whose size changes are correlated over time.
    """
    there = np.isfinite(e)
    if int(there.sum()) <= 2 * lags:
        return 1.0
    squares = e**2 - np.mean(e[there] ** 2)
    return correlogram([squares], lags).p_value()


def uneven(tests: ResidualTests) -> bool:
    """Do the prediction errors change their size, or is colour left in them?"""
    return min(squares_p(tests.e), tests.whiteness_p) < levels.UNEVEN


def sandwich_covariance(fit: RowFit) -> Array:
    """Covariance (size, size) of theta, in no direction below that of the likelihood.

    With few errors that are large the meat is itself poorly known. Directions are those in which the one differs from
    the other: what two parameters tell together may be known though neither is.
    """
    plain, covariance = fit.covariance, plant_covariance(fit)
    scale = np.sqrt(np.maximum(np.diag(plain), np.finfo(float).tiny))
    values, vectors = np.linalg.eigh(plain / np.outer(scale, scale))
    root = vectors * np.sqrt(np.maximum(values, levels.LOST**2 * values[-1]))
    whitened = np.linalg.solve(root, np.linalg.solve(root, covariance / np.outer(scale, scale)).T)
    ratios, directions = np.linalg.eigh((whitened + whitened.T) / 2)
    wider = root @ (directions * np.sqrt(np.maximum(ratios, 1.0)))
    return np.asarray(wider @ wider.T * np.outer(scale, scale))


def plant_covariance(fit: RowFit) -> Array:
    """Covariance (size, size) of theta as the errors have it (Newey and West's weights)."""
    n = fit.theta.size
    return np.asarray(_sandwich(fit, RESIDUAL_LAGS)[:n, :n])


def noise_covariance(fit: RowFit) -> Array:
    """Covariance (order, order) of the coefficients of the noise model, for prediction errors of uneven size.

    Without lags: what is left of colour is what the coefficients are about.
    """
    n = fit.theta.size
    return np.asarray(_sandwich(fit, 0)[n:, n:])


def _sandwich(fit: RowFit, most_lags: int) -> Array:
    """Covariance (size + order, size + order) of theta and the noise model."""
    size = fit.theta.size + fit.ar.size
    meat = np.zeros((size, size))
    for piece in linearised(fit.row, fit.theta, fit.ar, fit.weights):
        scores = piece.jacobian * piece.errors
        meat += scores @ scores.T
        lags = min(most_lags, piece.errors.size // 10)
        for lag in range(1, lags + 1):
            product = scores[:, lag:] @ scores[:, :-lag].T
            meat += (1 - lag / (lags + 1)) * (product + product.T)
    bread = inverse(fit.information)
    return np.asarray((bread @ meat @ bread) * fit.count / fit.left)
