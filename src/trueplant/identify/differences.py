"""What the differences of a record say, from one sample to the next.

A finite autoregression takes slow noise to end somewhere, and a plant may explain what it does beyond: loads that step,
drifts, 1/f noise. Of differences all of that is hardly a part. They say less, but what they say does not rest on a
level that the noise may not have.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from trueplant.identify.covariance import inflation, scaled
from trueplant.identify.estimate import polished
from trueplant.identify.fit import RowFit, fit_row
from trueplant.identify.output import OutputEstimate
from trueplant.identify.row import differenced


def of_differences(fit: RowFit) -> RowFit:
    """The fit of the differences, to the end, with a noise model of its own."""
    begun = fit_row(differenced(fit.row), fit.theta, np.zeros(0), weights=fit.weights, free=fit.free)
    return polished(begun)


def estimate_of_differences(estimate: OutputEstimate, confidence: float) -> OutputEstimate:
    """The estimate with parameters, covariance and likelihood of the differences alone."""
    fit = of_differences(estimate.fit)
    factor = inflation(fit, confidence)
    covariance = scaled(fit.covariance, factor)
    return replace(
        estimate, fit=fit, theta=fit.theta, covariance=covariance, unprofiled=covariance, factor=factor, rise=None
    )
