"""What the curvature of the likelihood does not know of the uncertainty: slow noise, initial states, rounding."""

from __future__ import annotations

import numpy as np
from scipy.stats import norm, t

from trueplant.arrays import Array
from trueplant.identify import levels
from trueplant.identify.fit import RowFit
from trueplant.identify.row import Row


def inflation(fit: RowFit, confidence: float) -> float:
    """Factor on the covariance for noise so slow that the record says little of it.

    A level is known from the record as well as from n = N A(1)^2 white errors. The fit takes one of them with it for
    each parameter and offset, so that slow noise looks smaller than it is. At least half are taken to be left: a noise
    that wanders without end has none, and the parameters are then known from faster changes. The level of the noise is
    itself an estimate: what is left of it, or what the uncertainty of A(1) says (Satterthwaite's rule for
    the variance 1/A(1)^2), gives the degrees of freedom of Student's quantile.
    """
    level = float(1 + np.sum(fit.ar))
    n = fit.count * min(level**2, 1.0)
    taken = int(fit.free.sum()) + fit.row.nuisance_count
    left = max(n - taken, n / 2)
    tail = 0.5 + confidence / 2
    known = level**2 / max(2 * _level_variance(fit), 1e-300)
    quantile = t.ppf(tail, max(min(left, known), levels.FEWEST_FREEDOM)) / norm.ppf(tail)
    return float(n / left * quantile**2) if n > 0 else float(2 * quantile**2)


def _level_variance(fit: RowFit) -> float:
    """Variance of A(1), the sum of the noise model's coefficients."""
    block = fit.information[fit.theta.size :, fit.theta.size :]
    ones = np.ones(len(block))
    return float(fit.variance * ones @ np.linalg.lstsq(block, ones, rcond=1e-12)[0]) if ones.size else 0.0


def initial_state_share(fit: RowFit) -> float:
    """Share of the covariance that is added to it in closed loop for operating points and initial states.

    They are estimated from later errors, to which the controller has responded: the prediction errors are then no
    longer independent of past OP, which biases the estimate (Nickell 1981). One initial state does not matter; many
    gaps in a record do.
    """
    return float((levels.INITIAL_STATE_BIAS * fit.row.nuisance_count) ** 2 / max(fit.count, 1))


def least_variance(row: Row, theta: Array, timing: float) -> Array:
    """(size,) variance that every parameter has at least: recorded numbers and instants (`timing`) are rounded."""
    return np.asarray((levels.RECORDED_DIGITS * np.abs(theta)) ** 2 + np.where(row.is_dead_time, timing**2, 0.0))
