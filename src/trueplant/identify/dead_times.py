"""Dead times: other minima of their cost, and those that neither the model nor the record shows."""

from __future__ import annotations

import numpy as np
from scipy.stats import chi2

from trueplant.arrays import Array
from trueplant.identify import levels
from trueplant.identify.fit import RowFit
from trueplant.identify.likelihood import held_at, rise
from trueplant.identify.linear_algebra import orthonormal
from trueplant.identify.noise import whiten, whitened_valid
from trueplant.identify.row import Row


def rival_dead_times(row: Row, theta: Array, ar: Array, weights: Array, reach: int) -> list[tuple[float, Array]]:
    """Other dead times that may fit as well: pairs of cost and theta, best first.

    Inputs that carry measurement noise give the cost of a dead time a minimum of its own in every sample
    interval. For the middle of each interval nearby, the cost is minimised over all other parameters to
    first order; what comes within a few units of the likelihood of the best is worth a fit of its own.
    """
    places = np.flatnonzero(row.is_dead_time)
    rivals = [rival for k in places for rival in _rivals(row, theta, ar, weights, int(k), reach)]
    return sorted(rivals, key=lambda rival: rival[0])


def _rivals(row: Row, theta: Array, ar: Array, weights: Array, index: int, reach: int) -> list[tuple[float, Array]]:
    m = row.element_of(index)
    spec, part = row.specs[m], row.slices[m]
    h = row.pieces[0].h
    here = int(theta[index] / h)
    middles = (np.arange(max(here - reach, 0), here + reach + 1) + 0.5) * h
    tried = np.concatenate([[theta[index]], middles[np.abs(middles - theta[index]) > 0.5 * h]])
    others = np.delete(np.arange(theta.size), index)
    gram, moment, power, count = 0.0, 0.0, 0.0, 0
    for k, piece in enumerate(row.pieces):
        y, valid = row.measured(k)
        if y.size <= ar.size + 1:
            continue
        use = whitened_valid(ar.size, valid)
        response, gradient = row.response_and_gradient(theta, k)
        candidates = np.empty((tried.size, y.size))
        for c, value in enumerate(tried):
            p = theta[part].copy()
            p[index - part.start] = value
            u, hold = piece.inputs[spec.column], piece.hold[spec.column]
            candidates[c] = spec.structure.response(p, u, piece.h, hold, row.stride)
        errors = np.where(valid, y - response + candidates[0] - candidates, 0.0)
        basis = orthonormal(whiten(ar, row.nuisance(theta, k))[use])
        e = weights[k] * np.compress(use, whiten(ar, errors.T).T, axis=1)
        j = weights[k] * np.compress(use, whiten(ar, gradient[:, others]).T, axis=1)
        e, j = e - e @ basis @ basis.T, j - j @ basis @ basis.T
        gram, moment, power = gram + j @ j.T, moment + j @ e.T, power + np.sum(e**2, axis=1)
        count += int(use.sum())
    scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    steps = np.linalg.lstsq(gram / np.outer(scale, scale), moment / scale[:, None], rcond=1e-12)[0]
    cost = power - np.sum(moment / scale[:, None] * steps, axis=0)
    close = cost[1:] < cost[0] * (1 + levels.RIVAL_NEAR / max(count, 1))
    lowest = np.r_[True, cost[2:] <= cost[1:-1]] & np.r_[cost[1:-1] <= cost[2:], True]
    found = []
    for c in np.flatnonzero(close & lowest)[:6] + 1:
        rival = theta.copy()
        rival[index] = tried[c]
        rival[others] += np.clip(steps[:, c] / scale, -np.abs(theta[others]) / 3, np.abs(theta[others]) / 3)
        found.append((float(cost[c]), rival))
    return sorted(found, key=lambda pair: pair[0])[:3]


def without_unseen_dead_times(fit: RowFit) -> RowFit:
    """The fit with dead times fixed at 0 where the model has none and the record shows none.

    Estimating a dead time next to its bound of 0 makes the time constant much less certain (splitter column: 1.5 times
    the Cramer-Rao bound). A small one may still be there: the caller adds how far the other parameters move with it.
    Where none is sought at 0 (`bounds`), none is fixed there.
    """
    for index in _undeclared(fit) if fit.row.per_look == 1 else ():
        without = held_at(fit, np.array([index]), np.zeros(1))
        if chi2.sf(rise(fit, without), 1) > levels.DEAD_TIME_UNSEEN:
            fit = without
    return fit


def _undeclared(fit: RowFit) -> list[int]:
    """Places of the dead times that the model has at 0."""
    places = []
    for spec, part in zip(fit.row.specs, fit.row.slices, strict=True):
        if spec.initial is not None:
            absent = spec.structure.is_dead_time & (np.array(spec.initial) == 0)
            places += [int(k) for k in part.start + np.flatnonzero(absent)]
    return places
