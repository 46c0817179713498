"""From a row of elements and data to the fitted row: starting point, noise model, initial state, minimum."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from trueplant.identify.fit import RowFit, fit_row, residuals
from trueplant.identify.noise import choose_order, fit_ar
from trueplant.identify.predict import Row
from trueplant.identify.search import grid_start, initial_theta

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Options:
    """How a row is estimated."""

    largest_order: int = 30
    """Of the autoregressive noise model."""
    order: int | None = None
    """Fixed order of the noise model; None chooses it."""
    initial: str = "auto"
    """"rest", "free" (estimated initial state) or "auto" (what the Bayesian criterion prefers)."""


def largest_order(row: Row, limit: int) -> int:
    samples = sum(int(row.measured(k)[1].sum()) for k in range(len(row.pieces)))
    shortest = min(row.measured(k)[0].size for k in range(len(row.pieces)))
    return max(0, min(limit, samples // 40, shortest // 4))


def fit_noise(fit: RowFit, order: int | None, limit: int) -> Array:
    """AR coefficients of the output error of a fit; the order is chosen where none is given."""
    errors = residuals(fit)
    signals = [np.nan_to_num(v) * w for (v, _, _), w in zip(errors, fit.weights, strict=True)]
    valid = [np.isfinite(v) for v, _, _ in errors]
    energy = sum(float(np.sum(np.where(ok, row_y, 0.0) ** 2)) for (row_y, ok) in map(fit.row.measured, range(len(signals))))
    if sum(float(s @ s) for s in signals) <= 1e-18 * energy:
        return np.zeros(0)  # free of noise: what is left is rounding
    chosen = choose_order(signals, valid, limit) if order is None else order
    return fit_ar(signals, valid, chosen)[0]


def estimate_row(row: Row, time_scale: float, options: Options | None = None) -> RowFit:
    """The best fit of the row found from the grid and from the model, with its noise model.

    `time_scale` (time units) is where the search starts for elements that the model lacks.
    """
    options = options or Options()
    limit = largest_order(row, options.largest_order)
    free_row = replace(row, at_rest=options.initial == "rest")
    model = initial_theta(free_row, time_scale)
    none = np.zeros(0)
    start = grid_start(free_row, model, none)
    fit = fit_row(free_row, start, none, iterations=15)
    fit = _with_noise(fit, options.order, limit, iterations=25)
    # The grid again, now weighted by the noise model, and the model itself as another start.
    again = grid_start(free_row, fit.theta, fit.ar, rounds=1)
    for other in (again, model):
        rival = fit_row(free_row, other, fit.ar, weights=fit.weights, reweight=False, iterations=25)
        if rival.cost < fit.cost * (1 - 1e-9):
            fit = rival
    fit = _with_noise(fit, options.order, limit, iterations=60)
    if options.initial == "auto":
        at_rest = fit_row(replace(row, at_rest=True), fit.theta, fit.ar, weights=fit.weights, reweight=False)
        if at_rest.criterion < fit.criterion:
            fit = _with_noise(at_rest, options.order, limit, iterations=60)
    return fit


def _with_noise(fit: RowFit, order: int | None, limit: int, iterations: int) -> RowFit:
    ar = fit_noise(fit, order, limit)
    return fit_row(fit.row, fit.theta, ar, weights=fit.weights, iterations=iterations)
