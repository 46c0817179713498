"""From a row of elements and data to the fitted row: initial guess, noise model, initial state, minimum."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trueplant.arrays import Array, BoolArray
from trueplant.identify import levels
from trueplant.identify.blocks import most_moved
from trueplant.identify.dead_times import rival_dead_times
from trueplant.identify.fit import RowFit, fit_row, residuals
from trueplant.identify.noise import choose_order, fit_ar, whitened_valid
from trueplant.identify.row import Row
from trueplant.identify.search import grid_guess, initial_theta
from trueplant.identify.validate import residual_tests


@dataclass(frozen=True)
class Options:
    """How a row is estimated."""

    largest_order: int = levels.LARGEST_ORDER
    """Of the autoregressive noise model."""
    order: int | None = None
    """Fixed order of the noise model; None chooses it."""
    start: RowFit | None = None
    """A fit of the row on nearly the same data to start from, instead of a search."""


def largest_order(row: Row, limit: int) -> int:
    """The largest order of a noise model that these data bear, at most `limit`.

    Samples bear it whose past is measured that far back, or up to where their piece begins.
    """
    measured = [row.measured(k)[1] for k in range(len(row.pieces))]
    samples = sum(int(ok.sum()) for ok in measured)
    most = max(0, min(limit, samples // levels.SAMPLES_PER_ORDER, min(ok.size for ok in measured) // 4))

    def bearing(order: int) -> int:
        return sum(order + int(whitened_valid(order, ok).sum()) for ok in measured)

    return next((k for k in range(most, 0, -1) if bearing(k) >= levels.SAMPLES_PER_ORDER * k), 0)


def noise_signals(fit: RowFit) -> tuple[list[Array], list[BoolArray]]:
    """Output errors of each piece, levelled by its weight, and where they were measured."""
    errors = residuals(fit)
    signals = [np.nan_to_num(v) * w for (v, _, _), w in zip(errors, fit.weights, strict=True)]
    return signals, [np.isfinite(v) for v, _, _ in errors]


def free_of_noise(fit: RowFit) -> bool:
    """Is what is left of the output, or of its prediction, rounding?"""
    signals, _ = noise_signals(fit)
    left, energy = sum(float(s @ s) for s in signals), fit.row.energy
    return left <= levels.NOISE_FREE * energy or fit.cost <= levels.EXACT * energy


def fit_noise(fit: RowFit, order: int | None, limit: int) -> Array:
    """AR coefficients of the output error of a fit; the order is chosen where none is given."""
    if free_of_noise(fit):
        return np.zeros(0)
    signals, valid = noise_signals(fit)
    chosen = min(choose_order(signals, valid, limit) + levels.SPARE_ORDERS, limit) if order is None else order
    return fit_ar(signals, valid, chosen)[0]


def estimate_row(row: Row, time_scale: float, options: Options | None = None) -> RowFit:
    """The best fit of the row found from the grid and from the model, with its noise model.

    `time_scale` (time units) is where the search starts for elements that the model lacks.
    """
    options = options or Options()
    part = most_moved(row)
    fit = options.start or _searched(part, time_scale, options)
    if options.start is not None or part is not row:
        fit = _on_the_whole(row, fit, options)
    limit = largest_order(row, options.largest_order)
    return fit if options.order is not None else _whitened(fit, limit)


def _searched(row: Row, time_scale: float, options: Options) -> RowFit:
    """The best minimum, from the grid and from the model."""
    limit = largest_order(row, options.largest_order)
    model = initial_theta(row, time_scale)
    fit = _from_grid(row, model, options.order, limit)
    if all(spec.initial is not None for spec in row.specs):
        fit = _better(row, fit, _from_model(row, model, options.order, limit))
    return best_dead_times(_with_noise(fit, options.order, limit, iterations=60))


def _from_grid(row: Row, model: Array, order: int | None, limit: int) -> RowFit:
    fit = fit_row(row, grid_guess(row, model, np.zeros(0)), np.zeros(0))
    row = row.without_unseen(fit.theta)
    fit = fit_row(row, fit.theta, np.zeros(0))
    fit = _with_noise(fit, order, limit, iterations=25)
    # The grid again, now weighted by the noise model, and the model itself as another initial guess.
    fit = _tried(fit, model)
    while (better := _tried(fit, grid_guess(row, fit.theta, fit.ar, rounds=1))) is not fit:
        fit = better
    return fit


def _tried(fit: RowFit, theta: Array) -> RowFit:
    """The fit, or a better one from another initial guess."""
    rival = fit_row(fit.row, theta, fit.ar, weights=fit.weights, reweight=False, iterations=25)
    gain = fit.left * np.log(max(fit.cost, np.finfo(float).tiny) / max(rival.cost, np.finfo(float).tiny))
    return rival if gain > levels.TRIED_SETTLED else fit


def _from_model(row: Row, model: Array, order: int | None, limit: int) -> RowFit:
    """From the model with the noise model that it leaves: beside a plant that explains disturbances as well there is
    another noise, under which the right plant may look worse than it is."""
    row = row.without_unseen(model)
    kept = fit_row(row, model, np.zeros(0), free=np.zeros(model.size, dtype=bool))
    fit = fit_row(row, model, fit_noise(kept, order, limit), weights=kept.weights, iterations=25)
    return _with_noise(fit, order, limit, iterations=25)


def _better(row: Row, one: RowFit, other: RowFit) -> RowFit:
    """The better one of two fits, on the samples that both of them can use."""
    longest = max((one.theta, other.theta), key=lambda theta: float(np.max(theta[row.is_dead_time], initial=0.0)))
    both = row.without_unseen(longest)
    again = [fit_row(both, fit.theta, fit.ar, iterations=10) for fit in (one, other)]
    return one if is_better(*again) else other


def is_better(one: RowFit, other: RowFit) -> bool:
    """Has one fit of a row the lower Bayesian criterion?

    Noise models of another order leave other numbers of prediction errors where samples are missing: what counts is
    the likelihood of an error, times as many as both have.
    """
    count = min(one.count, other.count)

    def criterion(fit: RowFit) -> float:
        size = max(fit.cost, np.finfo(float).tiny) / fit.count
        return float(count * np.log(size) + np.log(count) * fit.ar.size)

    return criterion(one) <= criterion(other)


def _on_the_whole(row: Row, part: RowFit, options: Options) -> RowFit:
    """The fit of a long record, started from that of a part of it: only dead times within reach are tried again."""
    limit = largest_order(row, options.largest_order)
    sigma = np.sqrt(np.diag(part.covariance)[row.is_dead_time])
    reach = min(levels.DEAD_TIME_REACH, 1 + int(np.ceil(4 * float(np.max(sigma, initial=0.0)) / row.pieces[0].h)))
    fit = fit_row(row.without_unseen(part.theta), part.theta, part.ar)
    return best_dead_times(_with_noise(fit, options.order, limit, iterations=60), reach)


def _whitened(fit: RowFit, limit: int) -> RowFit:
    """The fit with a larger noise model, as long as its prediction errors are not white.

    The Bayesian criterion is content with less, at the price of intervals that are a little too narrow.
    Where the errors follow the inputs, the structure is at fault and a larger noise model no cure.
    """
    while fit.ar.size < limit:
        tests = residual_tests(fit)
        if tests.whiteness_p > levels.NOT_WHITE or np.min(tests.cross_p) < levels.UNDERMODELLED:
            break
        order = min(fit.ar.size + max(2, fit.ar.size // 2), limit)
        ar = fit_noise(fit, order, limit)
        if ar.size != order:
            break
        fit = fit_row(fit.row, fit.theta, ar, weights=fit.weights, iterations=60)
    return fit


def best_dead_times(fit: RowFit, reach: int = levels.DEAD_TIME_REACH, rounds: int = 4) -> RowFit:
    """The fit, or a better one whose dead times lie in other sample intervals, up to `reach` samples away."""
    row = fit.row
    low, high = row.bounds()
    for _ in range(rounds):
        best = fit
        for _, theta in rival_dead_times(row, fit.theta, fit.ar, fit.weights, reach):
            rival = fit_row(row, np.clip(theta, low, high), fit.ar, weights=fit.weights, reweight=False, iterations=25)
            if rival.cost < best.cost * (1 - levels.BETTER):
                best = rival
        if best is fit:
            return fit
        fit = best
    return fit


def _with_noise(
    fit: RowFit, order: int | None, limit: int, iterations: int, reweight: bool = True, settled: float = levels.SETTLED
) -> RowFit:
    ar = fit_noise(fit, order, limit)
    return fit_row(
        fit.row,
        fit.theta,
        ar,
        weights=fit.weights,
        free=fit.free,
        reweight=reweight,
        iterations=iterations,
        settled=settled,
    )


def polished(fit: RowFit) -> RowFit:
    """The fit with a noise model of its own, chosen once more when the plant has found its place."""
    return with_own_noise(with_own_noise(fit, levels.TRIED_STEPS), levels.POLISHED_STEPS)


def with_noise_of_order(fit: RowFit, order: int, iterations: int) -> RowFit:
    """The fit with a noise model of that order, under the weights that it has."""
    return _with_noise(fit, order, order, iterations, reweight=False)


def with_own_noise(fit: RowFit, iterations: int) -> RowFit:
    """The fit with its noise model chosen anew, under the weights that it has: others would make costs incomparable.

    As far as comparisons need it.
    """
    limit = largest_order(fit.row, levels.LARGEST_ORDER)
    return _with_noise(fit, None, limit, iterations, reweight=False, settled=levels.TRIED_SETTLED)
