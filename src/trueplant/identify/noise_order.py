"""How the estimate depends on the order of the noise model."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from trueplant.arrays import Array
from trueplant.identify import levels
from trueplant.identify.between_experiments import refit_noise
from trueplant.identify.blocks import of_a_part
from trueplant.identify.fit import RowFit
from trueplant.identify.linear_algebra import inverse
from trueplant.identify.unanswered import Unanswered, WhyUnanswered


def order_dependence(
    fit: RowFit, covariance: Array, cross_p: Array, runs: Sequence[RowFit]
) -> tuple[dict[int, Unanswered], Array]:
    """Estimates with noise models of other orders, compared with the one given.

    `runs` are the fits of single experiments, or the fit itself: each moves by itself, as another noise model also
    weighs experiments anew, and what they differ by would pass for what it does. `cross_p` (n_columns,) says whether
    the prediction errors still follow the inputs.

    Returns the parameters that a noise model which may be right as well moves by more than chance and by more than a
    third, with the reason, and (n,) the furthest that they move, together, where the prediction errors still follow the
    inputs: then the structure is too simple, every noise model weighs its error differently, and none is right.
    """
    runs = [of_a_part(run) for run in runs]
    used = fit.ar.size
    undermodelled = bool(np.min(cross_p) < levels.UNDERMODELLED)
    limit = max(run.row.measured(k)[0].size for run in runs for k in range(len(run.row.pieces))) // 20
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
        others = [refit_noise(run, order) for run in runs]
        shift = np.mean([other.theta - run.theta for other, run in zip(others, runs, strict=True)], axis=0)
        other_sigma = np.sqrt(np.sum([np.diag(other.covariance) for other in others], axis=0)) / len(others)
        beyond = (np.abs(shift) > levels.NOISE_SHIFT_ERRORS * np.minimum(sigma, other_sigma)) & (
            np.abs(shift) > scale / levels.NOISE_SHIFT_SHARE
        )
        beyond &= all(_is_rival(other, run) for other, run in zip(others, runs, strict=True))
        for index in np.flatnonzero(beyond):
            there = fit.theta[index] + shift[index]
            text = f"{why.value}: {fit.theta[index]:.3g} with order {used}, {there:.3g} with order {order}"
            moved.setdefault(int(index), Unanswered(why, text))
        distance = float(shift @ precision @ shift)
        if undermodelled and distance > furthest:
            shifts, furthest = shift, distance
    return moved, shifts


def _is_rival(other: RowFit, fit: RowFit) -> bool:
    """Might the other noise model be the right one, by the Bayesian criterion?"""
    size = max(other.variance, np.finfo(float).tiny) / max(fit.variance, np.finfo(float).tiny)
    worse = fit.count * np.log(size) + np.log(fit.count) * (other.ar.size - fit.ar.size)
    return bool(worse < levels.RIVAL_NEAR)
