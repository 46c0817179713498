"""How the estimate depends on the order of the noise model."""

from __future__ import annotations

import numpy as np

from trueplant.arrays import Array
from trueplant.identify import levels
from trueplant.identify.between_experiments import refit_noise
from trueplant.identify.blocks import of_a_part
from trueplant.identify.fit import RowFit
from trueplant.identify.levels import UNDERMODELLED
from trueplant.identify.linear_algebra import inverse
from trueplant.identify.unanswered import Unanswered, WhyUnanswered
from trueplant.identify.validate import ResidualTests


def order_dependence(fit: RowFit, covariance: Array, tests: ResidualTests) -> tuple[dict[int, Unanswered], Array]:
    """Estimates with noise models of other orders, compared with the one given.

    Returns the parameters that move by more than chance and by more than a third, with the reason,
    and (n,) the furthest that they move, together, where the prediction errors still follow the inputs: then the
    structure is too simple, every noise model weighs its error differently, and no one of them is right.
    """
    fit = of_a_part(fit)
    used = fit.ar.size
    undermodelled = bool(np.min(tests.cross_p) < UNDERMODELLED)
    limit = max(fit.row.measured(k)[0].size for k in range(len(fit.row.pieces))) // 20
    orders = {used // 2, min(used, 1), 2 * used + 2} | ({0} if undermodelled else set())
    sigma = np.sqrt(np.diag(covariance))
    scale = np.maximum(np.abs(fit.theta), fit.row.lag_of_dead_times(fit.theta))
    moved: dict[int, Unanswered] = {}
    why = WhyUnanswered.DEPENDS_ON_NOISE_MODEL
    shifts, furthest = np.zeros(fit.theta.size), 0.0
    precision = inverse(covariance)
    for order in sorted(orders - {used}):
        if order > limit or (order == 0 and not undermodelled):
            continue
        other = refit_noise(fit, order)
        shift = other.theta - fit.theta
        beyond = (np.abs(shift) > levels.NOISE_SHIFT_ERRORS * np.minimum(sigma, np.sqrt(np.diag(other.covariance)))) & (
            np.abs(shift) > scale / levels.NOISE_SHIFT_SHARE
        )
        beyond &= other.variance < levels.RIVAL_NOISE * fit.variance
        for index in np.flatnonzero(beyond):
            here, there = f"{fit.theta[index]:.3g} with order {used}", f"{other.theta[index]:.3g} with order {order}"
            moved.setdefault(int(index), Unanswered(why, f"{why.value}: {here}, {there}"))
        distance = float(shift @ precision @ shift)
        if undermodelled and distance > furthest:
            shifts, furthest = shift, distance
    return moved, shifts
