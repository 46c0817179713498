"""How far each element of a plant may be off: for weights that cover what the data leave open."""

from __future__ import annotations

import numpy as np
from scipy.stats import chi2

from trueplant.arrays import Array, BoolArray, ComplexArray
from trueplant.lti import Structure, UncertainPlant
from trueplant.lti.uncertain import responses
from trueplant.robust import covariance_weight


def element_errors(known: UncertainPlant, w: Array, confidence: float) -> Array:
    """Size (n_w, n_y, n_u + n_d) of each element's error within the joint confidence region of all parameters.

    As `covariance_weight`, to first order; but where the error of a dead time has turned the phase, that counts as
    twice the size of its term at most.
    """
    found = np.zeros((w.size, *known.nominal.shape))
    if not known.varying:
        return found
    reach = float(chi2.ppf(confidence, known.varying))
    for i, row in known.rows.items():
        for j, structure, part in zip(row.columns, row.structures, row.slices, strict=True):
            theta, covariance = row.theta[part], row.covariance[part, part]
            free = np.diag(covariance) > 0
            if not free.any():
                continue
            # the joint region seen from these parameters alone: their ellipsoid, with the radius of all
            larger = covariance * reach / float(chi2.ppf(confidence, int(free.sum())))
            dead = structure.is_dead_time
            steady = np.where(dead[:, None] | dead[None, :], 0.0, larger)
            linear, limited = (
                _first_order(structure, theta, free, spread, w, confidence) for spread in (larger, steady)
            )
            late = np.sqrt(reach * np.diag(covariance))[dead]
            found[:, i, j] = np.minimum(linear, limited + _turned(structure, theta, late, w))
    return found


def _first_order(
    structure: Structure, theta: Array, free: BoolArray, spread: Array, w: Array, confidence: float
) -> Array:
    def response(values: Array) -> ComplexArray:
        p = theta.copy()
        p[free] = values
        # a small negative dead time is allowed here: it is only half of a difference
        return np.asarray(responses(structure, p[None, :], w)[0][:, None, None])

    return covariance_weight(response, theta[free], spread[np.ix_(free, free)], "additive", confidence)


def _turned(structure: Structure, theta: Array, late: Array, w: Array) -> Array:
    """(n_w,) the most that errors of the dead times up to `late` do, term by term."""
    bound = np.zeros(w.size)
    for k, most in enumerate(late):
        alone = theta.copy()
        alone[: structure.delayed] = 0.0
        alone[k] = theta[k]
        bound += np.abs(structure.transfer(alone)(1j * w)) * np.minimum(w * most, 2.0)
    return bound
