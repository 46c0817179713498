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

    Of the plant's `theta` (n,) or the model's values, whichever are larger. A lag that the model has at 0 is measured
    as a dead time is.
    """
    more = np.maximum(np.abs([value or 0.0 for value in model]) - np.abs(theta), 0.0)
    more = more + np.where(
        structure.is_lag & np.array([value == 0 for value in model]), structure.longest_dead_time(theta), 0.0
    )
    return np.asarray(share * (structure.sizes(theta, lag) + more))


def detectable_change(
    structure: Structure,
    theta: Array,
    covariance: Array,
    elements: int,
    level: float,
    lag: float,
    scale: float | None = None,
    model: Sequence[float | None] = (),
) -> float:
    """The largest, over net gain, lag and dead time, of the changes that would just have been found.

    Each is a share: of the net gain, of the lag, and of dead time plus `lag` (how long the element takes to answer, of
    an integrator too) for the mean dead time. Just found is what
    a two-sided test at `level` over so many `elements` (Bonferroni) would find in levels.POWER of all records; the
    standard errors are those of these sums, so that parameters which can only be told together do no harm.
    `scale` stands for the net gain of an element that the model lacks. Where the `model` (n,) has its lags at 0, they
    are measured as the dead time is. Infinite where nothing is known.
    """
    told = norm.isf(level / (2 * max(elements, 1))) + norm.ppf(levels.POWER)
    return float(told * max(_relative_errors(structure, theta, covariance, lag, scale, model).values(), default=np.inf))


def least_known(
    structure: Structure, theta: Array, covariance: Array, lag: float, model: Sequence[float | None] = ()
) -> str:
    """Which of "gain", "lag" and "dead time" a change would have to be largest of to be found, in those shares."""
    errors = _relative_errors(structure, theta, covariance, lag, None, model)
    return max(errors, key=lambda name: errors[name], default="")


def _relative_errors(
    structure: Structure,
    theta: Array,
    covariance: Array,
    lag: float,
    scale: float | None,
    model: Sequence[float | None],
) -> dict[str, float]:
    """Standard errors of net gain, lag and mean dead time as the shares that `detectable_change` tells."""
    by_lag = np.where(structure.is_lag, 1.0, 0.0)
    by_lag[structure.is_frequency] = -1 / theta[structure.is_frequency] ** 2
    by_dead_time = structure.is_dead_time / max(int(structure.is_dead_time.sum()), 1)
    gain = abs(float(theta[structure.is_gain].sum())) if scale is None else scale
    slow = lag + float(by_dead_time @ theta)
    of_lags = [value for value, is_lag in zip(model, structure.is_lag, strict=False) if is_lag]
    at_once = len(of_lags) > 0 and all(value == 0 for value in of_lags)
    quantities = {
        "gain": (structure.is_gain.astype(float), gain),
        "lag": (by_lag, slow if at_once else structure.lag(theta)),
        "dead time": (by_dead_time, slow),
    }
    if not np.isfinite(covariance).all():
        return {}
    return {
        name: float(np.sqrt(max(float(weights @ covariance @ weights), 0.0)) / size) if size > 0 else np.inf
        for name, (weights, size) in quantities.items()
        if np.any(weights) and (scale is None or name == "gain")
    }
