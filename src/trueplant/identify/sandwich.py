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
from trueplant.identify.linear_algebra import inverse
from trueplant.identify.validate import ResidualTests, squares_p, weighted_errors


def homoscedastic_p(fit: RowFit) -> float:
    """p-value that the prediction errors of a fit keep their size."""
    return squares_p(weighted_errors(fit))


def uneven(tests: ResidualTests) -> bool:
    """Do the prediction errors change their size, or is colour left in them?"""
    return min(tests.size_p, tests.whiteness_p) < levels.UNEVEN


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
    wider = root @ (directions * np.sqrt(np.maximum(ratios - 1, 0.0)))
    return np.asarray(plain + wider @ wider.T * np.outer(scale, scale))


def plant_covariance(fit: RowFit) -> Array:
    """Covariance (size, size) of theta as the errors have it (Newey and West's weights)."""
    n = fit.theta.size
    scores = _scores(fit)
    return np.asarray(_sandwich(fit, scores, correlated_lags([one[:n] for one in scores]))[:n, :n])


def noise_covariance(fit: RowFit) -> Array:
    """Covariance (order, order) of the coefficients of the noise model, for prediction errors of uneven size.

    Without lags: what is left of colour is what the coefficients are about.
    """
    n = fit.theta.size
    return np.asarray(_sandwich(fit, _scores(fit), 0)[n:, n:])


def correlated_lags(scores: list[Array]) -> int:
    """Over how many lags to sum the correlations of scores (size, n) of each piece, no more than they ask for.

    Every lag scatters, and a covariance that is the larger of two takes the scatter for size. Andrews (1991),
    Econometrica 59, 817: the lags of the least mean square error of Bartlett's weights, where each score is an
    autoregression of first order.
    """
    whole = sum(np.einsum("ij,ij->i", one, one) for one in scores)
    next_to = sum(np.einsum("ij,ij->i", one[:, 1:], one[:, :-1]) for one in scores)
    rho = np.divide(next_to, whole, out=np.zeros_like(whole), where=whole > 0)
    rho = np.clip(rho, -levels.MOST_CORRELATED, levels.MOST_CORRELATED)
    curvature = np.mean(4 * rho**2 / ((1 - rho) ** 6 * (1 + rho) ** 2)) / np.mean((1 - rho) ** -4.0)
    return int(levels.BARTLETT * np.cbrt(curvature * sum(one.shape[1] for one in scores)))


def _scores(fit: RowFit) -> list[Array]:
    """(size + order, n) psi e of each piece."""
    return [piece.jacobian * piece.errors for piece in linearised(fit.row, fit.theta, fit.ar, fit.weights)]


def _sandwich(fit: RowFit, scores: list[Array], most_lags: int) -> Array:
    """Covariance (size + order, size + order) of theta and the noise model."""
    size = fit.theta.size + fit.ar.size
    meat = np.zeros((size, size))
    for one in scores:
        meat += one @ one.T
        lags = min(most_lags, one.shape[1] // 10)
        for lag in range(1, lags + 1):
            product = one[:, lag:] @ one[:, :-lag].T
            meat += (1 - lag / (lags + 1)) * (product + product.T)
    bread = inverse(fit.information)
    return np.asarray((bread @ meat @ bread) * fit.count / fit.left)
