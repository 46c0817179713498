"""What a record says beside the largest noise model that it bears.

A noise model of few coefficients takes slow noise to end somewhere, and a plant, a richer structure or a load may
explain what it does beyond: 1/f noise, drifts, what loads leave that nobody recorded. Whatever is claimed has to hold
beside a noise model that explains as much of that as the record lets it.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from trueplant.identify import levels
from trueplant.identify.covariance import joint_freedom, noise_freedom, scaled, student_factor
from trueplant.identify.estimate import largest_order, with_noise_of_order
from trueplant.identify.fit import RowFit, fit_row, restriction_of
from trueplant.identify.output import OutputEstimate


def beside_longest_noise(fit: RowFit) -> RowFit:
    """The fit with the largest noise model, to the end."""
    order = largest_order(fit.row, levels.LARGEST_ORDER)
    return with_noise_of_order(fit, order, levels.POLISHED_STEPS)


def restricted(fit: RowFit, by: RowFit | None = None) -> RowFit:
    """The fit of the largest restricted likelihood: that of its own row, or of the one that another fit has."""
    row = replace(fit.row, restricted=restriction_of(by or fit))
    return fit_row(row, fit.theta, fit.ar, weights=fit.weights, free=fit.free, reweight=False)


def estimate_beside_longest_noise(estimate: OutputEstimate, confidence: float) -> OutputEstimate:
    """The estimate with parameters, covariance and likelihood beside the largest noise model alone, restricted.

    What the fit took of the noise has been given back; what is left to count is that the noise is known from so many
    degrees of freedom.
    """
    fit = restricted(beside_longest_noise(estimate.fit))
    covariance = scaled(fit.covariance, student_factor(noise_freedom(fit), confidence))
    return replace(
        estimate,
        fit=fit,
        theta=fit.theta,
        covariance=covariance,
        unprofiled=covariance,
        beside_ratio=None,
        factor=np.ones(fit.theta.size),
        ratio_factor=np.ones(fit.theta.size),
        freedom=partial(joint_freedom, fit),
        rise=None,
    )
