"""How small a change of an element the data would have shown, and which changes are worth it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.stats import norm

from trueplant.arrays import Array
from trueplant.detect import levels
from trueplant.lti import Structure


def worth_knowing_of(
    structure: Structure, theta: Array, model: Sequence[float | None], share: float, lag: float
) -> Array:
    """(n,) The change of each parameter that is worth knowing: a share of gain and lag, of dead time plus `lag`.

    Of the plant's `theta` (n,) or the model's values, whichever are larger.
    """
    more = np.maximum(np.abs([value or 0.0 for value in model]) - np.abs(theta), 0.0)
    return np.asarray(share * (structure.sizes(theta, lag) + more))


def detectable_change(
    structure: Structure,
    theta: Array,
    covariance: Array,
    elements: int,
    level: float,
    lag: float,
    scale: float | None = None,
) -> float:
    """The largest, over net gain, lag and dead time, of the changes that would just have been found.

    Each is a share: of the net gain, of the lag, and of dead time plus `lag` (how long the element takes to answer, of
    an integrator too) for the mean dead time. Just found is what
    a two-sided test at `level` over so many `elements` (Bonferroni) would find in levels.POWER of all records; the
    standard errors are those of these sums, so that parameters which can only be told together do no harm.
    `scale` stands for the net gain of an element that the model lacks. Infinite where nothing is known.
    """
    told = norm.isf(level / (2 * max(elements, 1))) + norm.ppf(levels.POWER)
    by_lag = np.where(structure.is_lag, 1.0, 0.0)
    by_lag[structure.is_frequency] = -1 / theta[structure.is_frequency] ** 2
    by_dead_time = structure.is_dead_time / max(int(structure.is_dead_time.sum()), 1)
    gain = abs(float(theta[structure.is_gain].sum())) if scale is None else scale
    slow = lag + float(by_dead_time @ theta)
    quantities = ((structure.is_gain.astype(float), gain), (by_lag, structure.lag(theta)), (by_dead_time, slow))
    if not np.isfinite(covariance).all():
        return np.inf
    shares = [
        told * np.sqrt(max(float(weights @ covariance @ weights), 0.0)) / size if size > 0 else np.inf
        for weights, size in (quantities if scale is None else quantities[:1])
        if np.any(weights)
    ]
    return float(max(shares, default=np.inf))
