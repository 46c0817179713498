"""What the differences of a record say.

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


def of_differences(fit: RowFit, over: int = 1) -> RowFit:
    """The fit of the differences over so many samples, to the end, with a noise model of its own."""
    begun = fit_row(differenced(fit.row, over), fit.theta, np.zeros(0), weights=fit.weights, free=fit.free)
    return polished(begun)


def estimate_of_differences(estimate: OutputEstimate, confidence: float) -> OutputEstimate:
    """The estimate with parameters, covariance and likelihood of the differences alone.

    Over a time in which the plant answers: what changes from one sample to the next is mostly noise where samples come
    fast.
    """
    row = estimate.row
    lags = [spec.structure.lag(estimate.fit.theta[part]) for spec, part in zip(row.specs, row.slices, strict=True)]
    shortest = min(len(row.measured(k)[0]) for k in range(len(row.pieces)))
    over = int(np.clip(max(lags) / (row.pieces[0].h * row.stride), 1, max(shortest // 4, 1)))
    fit = of_differences(estimate.fit, over)
    factor = inflation(fit, confidence)
    covariance = scaled(fit.covariance, factor)
    return replace(
        estimate, fit=fit, theta=fit.theta, covariance=covariance, unprofiled=covariance, factor=factor, rise=None
    )
