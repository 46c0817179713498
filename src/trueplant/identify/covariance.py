"""What the curvature of the likelihood does not know of the uncertainty: slow noise, initial states, rounding."""

from __future__ import annotations

import numpy as np
from scipy.stats import norm, t

from trueplant.arrays import Array, IntArray
from trueplant.identify import levels
from trueplant.identify.fit import RowFit, restriction_of
from trueplant.identify.lagged import at_samples, with_past
from trueplant.identify.linear_algebra import inverse, scaled_eigen
from trueplant.identify.memory import remembering
from trueplant.identify.restricted import Restriction
from trueplant.identify.row import Row


def inflated(fit: RowFit, confidence: float) -> Array:
    """Covariance (size, size) of theta with what is not known of the noise.

    How long it remembers is open, and the fit takes a share of the slow noise with it (`remembering`); what is not
    known of A(q) counts besides (`small_samples`). Of the two ways to see that the noise is larger the larger counts,
    for each independent sum of parameters.
    """
    growth = remembering(fit)
    factors = _widened(fit, confidence, growth.factors, growth.sums)
    variances = np.einsum("ia,ab,ib->i", growth.sums, fit.covariance, growth.sums)
    return np.asarray(fit.covariance + (growth.along * (factors - 1) * variances) @ growth.along.T)


def inflation(fit: RowFit, confidence: float) -> Array:
    """(size,) factors by which `inflated` has larger variances."""
    return growth_of(fit.covariance, inflated(fit, confidence))


def growth_of(covariance: Array, larger: Array) -> Array:
    """(size,) factors between variances; 1 for what is held."""
    own = np.diag(covariance)
    return np.divide(np.diag(larger), own, out=np.ones_like(own), where=own > 0)


def small_samples(fit: RowFit, confidence: float) -> Array:
    """(size,) the factors where the noise is an autoregression for certain, known from few errors.

    A parameter is known as well as the noise is small at the frequencies that tell it: by the coefficients a of A(q)
    its variance v moves as d log v/da = -2 rho (`told_at`). What is not known of a gives the degrees of freedom of
    Student's quantile (Satterthwaite's rule, as in Kenward and Roger 1997).

    Where the structure is simpler than the plant, A takes on what is left, and the first order is not enough. Under
    AR(1) noise with the pole 1 - A a level is known from the record as well as from N A^2 white errors, and the
    variance of rho'a is 2/(N A): by that A each parameter has errors of its own, of which the fit takes one for each
    unknown. At least half are taken to be left: of noise that wanders without end the level tells nothing, and the
    parameters are then known from faster changes.
    """
    return _widened(fit, confidence, np.ones(fit.theta.size))


def _widened(fit: RowFit, confidence: float, growth: Array, of: Array | None = None) -> Array:
    uncertain = _uncertain(fit, of)
    known = fit.count * np.minimum((2 / fit.count / np.maximum(uncertain, 1 / fit.count)) ** 2, 1.0)
    left = np.maximum(known - int(fit.free.sum()) - fit.row.nuisance_count, known / 2)
    return np.asarray(np.maximum(growth, known / left) * student_factor(_freedom(fit, uncertain), confidence))


def noise_freedom(fit: RowFit, of: Array | None = None) -> Array:
    """(size,) degrees of freedom of the noise at the frequencies that tell each parameter (Satterthwaite's rule).

    With `of` (m, size): (m,) at those that tell each of these sums of parameters.
    """
    return _freedom(fit, _uncertain(fit, of))


def _freedom(fit: RowFit, uncertain: Array) -> Array:
    return np.asarray(np.maximum(2 / (4 * uncertain + 2 / fit.left), levels.FEWEST_FREEDOM))


def _uncertain(fit: RowFit, of: Array | None = None) -> Array:
    """(size,) or (m,) variance of the logarithm of each standard error, as the noise model is uncertain."""
    rho = told_at(restriction_of(fit), fit.ar, of)
    spread = fit.variance * inverse(fit.information)[fit.theta.size :, fit.theta.size :]
    return np.asarray(np.einsum("ik,kl,il->i", rho, spread, rho))


def joint_freedom(fit: RowFit, index: IntArray) -> float:
    """Degrees of freedom of the noise for an F-test of theta[index] at once.

    Independent sums of the parameters each have their own, and the mean of their F is matched (Fai and Cornelius 1996):
    one that is hardly told does not make the test of the others blunt.
    """
    size, _, vectors = scaled_eigen(fit.covariance[np.ix_(index, index)])
    sums = np.zeros((index.size, fit.theta.size))
    sums[:, index] = vectors.T / size
    left = noise_freedom(fit, sums)
    beyond = float(np.sum(2 / (left - 2)))
    return 2 * (index.size + beyond) / beyond


def student_factor(freedom: Array, confidence: float) -> Array:
    """Of variances whose Student quantile stands for the normal one."""
    tail = 0.5 + confidence / 2
    return np.asarray((t.ppf(tail, freedom) / norm.ppf(tail)) ** 2)


def scaled(covariance: Array, factors: Array) -> Array:
    """Covariance (..., n, n) with variances larger by factors (n,), of the same correlations."""
    return np.asarray(covariance * np.sqrt(np.outer(factors, factors)))


def told_at(restriction: Restriction, ar: Array, of: Array | None = None) -> Array:
    """(size, order) rho: how what tells a parameter, or each sum `of` (m, size) them, moves with the noise model.

    The sum over time of what tells it, whitened, times the same so many samples before, as it was before it was
    whitened; relative to the sum of squares of the first.
    """
    order, size, told = ar.size, restriction.size, restriction.told(ar)
    sums = np.eye(size) if of is None else of
    whole, moving = sums @ told.covariance, np.zeros((len(sums), order))
    for piece in restriction.whitened(ar):
        raw, use = piece.moved.rows, piece.moved.use
        now = at_samples(whole @ piece.rows[:size], use, order, raw.shape[1])
        moving += with_past(now, whole @ (raw[:size] - piece.shares @ raw[size:]), order)
    own = np.einsum("ia,ab,ib->i", whole, told.information, whole)
    told_at_all = (own > levels.LOST * np.einsum("ia,ia->i", whole, sums))[:, None]
    return np.asarray(np.divide(moving, own[:, None], out=np.zeros_like(moving), where=told_at_all))


def initial_state_share(fit: RowFit) -> float:
    """Share of the covariance that is added to it in closed loop for operating points and initial states.

    They are estimated from later errors, to which the controller has responded: the prediction errors are then no
    longer independent of past OP, which biases the estimate (Nickell 1981). One initial state does not matter; many
    gaps in a record do.
    """
    return float((levels.INITIAL_STATE_BIAS * fit.row.nuisance_count) ** 2 / max(fit.count, 1))


def least_covariance(row: Row, theta: Array, timing: Array) -> Array:
    """(size, size) covariance that the parameters have at least: recorded numbers are rounded, and instants.

    `timing` (n_columns,) is the standard error of the instants of each input.

    An instant that is read wrongly moves all the dead times of an element alike.
    """
    least = np.diag((levels.RECORDED_DIGITS * np.abs(theta)) ** 2)
    for spec, part in zip(row.specs, row.slices, strict=True):
        late = np.zeros(row.size)
        late[part] = timing[spec.column] * row.is_dead_time[part]
        least += np.outer(late, late)
    return least
