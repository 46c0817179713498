"""Estimates that are wrong on purpose."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from trueplant.identify import OutputEstimate, fit_row
from trueplant.identify.estimate import fit_noise, largest_order
from trueplant.identify.validate import validate


def forced(estimate: OutputEstimate, values: Mapping[int, float]) -> OutputEstimate:
    """The estimate with some places of theta held at these values, all else (noise model too) fitted again."""
    theta, free = estimate.fit.theta.copy(), estimate.fit.free.copy()
    for k, value in values.items():
        theta[k], free[k] = value, False
    row = estimate.row.without_unseen(theta)
    plain = fit_row(row, theta, np.zeros(0), free=free)
    ar = fit_noise(plain, None, largest_order(row, 30))
    fit = fit_row(row, plain.theta, ar, free=free, weights=plain.weights)
    held = validate(fit)
    if held is not None:
        held = replace(held, trained=fit_row(held.trained.row, fit.theta, fit.ar, free=free))
    return replace(estimate, fit=fit, theta=fit.theta, covariance=fit.covariance, runs=None, validation=held)
