"""What the curvature of the likelihood does not know of the uncertainty: slow noise, initial states, rounding."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import norm, t

from trueplant.arrays import Array
from trueplant.identify import levels
from trueplant.identify.fit import RowFit, linearised
from trueplant.identify.linear_algebra import inverse
from trueplant.identify.noise import whiten
from trueplant.identify.row import Row


def inflation(fit: RowFit, confidence: float) -> Array:
    """(size,) factors on the variances of theta for what is not known of the noise model.

    A parameter is known as well as the noise is small at the frequencies that tell it: by the coefficients a of A(q)
    its variance v moves as d log v/da = -2 rho (`Told`). The fit takes a share of the noise with it for each
    parameter, operating point and initial state, so that the noise looks smaller than it is; the restricted likelihood
    (Patterson and Thompson 1971) takes that back, here to first order. What is still not known of a gives the degrees
    of freedom of Student's quantile (Satterthwaite's rule, as in Kenward and Roger 1997).

    Slow noise is no autoregression for certain, and the first order not enough. Under AR(1) noise with the pole 1 - A a
    level is known from the record as well as from N A^2 white errors, and the variance of rho'a is 2/(N A): by that A
    each parameter has errors of its own, of which the fit takes one for each unknown. At least half are taken to be
    left: of noise that wanders without end the level tells nothing, and the parameters are then known from faster
    changes. The larger of the two counts.
    """
    told = Told.of(fit)
    spread = fit.variance * inverse(fit.information)[fit.theta.size :, fit.theta.size :]
    smaller = 2 * told.rho @ spread @ told.taken
    uncertain = np.einsum("ik,kl,il->i", told.rho, spread, told.rho)
    known = fit.count * np.minimum((2 / fit.count / np.maximum(uncertain, 1 / fit.count)) ** 2, 1.0)
    left = np.maximum(known - int(fit.free.sum()) - fit.row.nuisance_count, known / 2)
    tail = 0.5 + confidence / 2
    freedom = np.maximum(2 / (4 * uncertain + 2 / fit.left), levels.FEWEST_FREEDOM)
    quantile = t.ppf(tail, freedom) / norm.ppf(tail)
    taken = np.exp(np.clip(smaller, 0.0, levels.LARGEST_EXPONENT))
    return np.asarray(np.maximum(taken, known / left) * quantile**2)


def scaled(covariance: Array, factors: Array) -> Array:
    """Covariance (..., n, n) with variances larger by factors (n,), of the same correlations."""
    return np.asarray(covariance * np.sqrt(np.outer(factors, factors)))


@dataclass(frozen=True, eq=False)
class Told:
    """How what tells the parameters, and what the fit takes of the noise, move with the noise model."""

    rho: Array
    """(size, order) sum over time of what tells a parameter, whitened, times the same so many samples before, as it was
    before it was whitened; relative to the sum of squares of the first."""
    taken: Array
    """(order,) half the slope of the log determinant of the information on all parameters, operating points and initial
    states."""

    @classmethod
    def of(cls, fit: RowFit) -> Told:
        order, size, free = fit.ar.size, fit.theta.size, np.ix_(fit.free, fit.free)
        information, moments, taken = np.zeros((size, size)), np.zeros((order, size, size)), np.zeros(order)
        for piece in linearised(fit.row, fit.theta, fit.ar, fit.weights):
            plain = fit.weights[piece.number] * np.vstack([piece.moved, piece.unknown])
            white = whiten(fit.ar, plain.T)[piece.use].T
            inverted = inverse(white[size:] @ white[size:].T)
            shares = white[:size] @ white[size:].T @ inverted
            plain[:size] -= shares @ plain[size:]
            white[:size] -= shares @ white[size:]
            information += white[:size] @ white[:size].T
            for lag in range(1, order + 1):
                before = plain[:, order - lag : plain.shape[1] - lag].T[piece.use]
                moments[lag - 1] += white[:size] @ before[:, :size]
                taken[lag - 1] += np.sum(inverted * (white[size:] @ before[:, size:]))
        whole = np.zeros((size, size))
        prior = fit.variance * fit.row.prior.normal_equations(fit.theta)[0]
        whole[free] = inverse((information + np.diag(prior))[free])
        told = np.einsum("ia,kab,ib->ik", whole, moments, whole)
        own = np.einsum("ia,ab,ib->i", whole, information, whole)
        told_at_all = (own > levels.LOST * np.diag(whole))[:, None]
        rho = np.divide(told, own[:, None], out=np.zeros_like(told), where=told_at_all)
        return cls(rho, taken + np.einsum("ab,kab->k", whole, moments))


def initial_state_share(fit: RowFit) -> float:
    """Share of the covariance that is added to it in closed loop for operating points and initial states.

    They are estimated from later errors, to which the controller has responded: the prediction errors are then no
    longer independent of past OP, which biases the estimate (Nickell 1981). One initial state does not matter; many
    gaps in a record do.
    """
    return float((levels.INITIAL_STATE_BIAS * fit.row.nuisance_count) ** 2 / max(fit.count, 1))


def least_covariance(row: Row, theta: Array, timing: float) -> Array:
    """(size, size) covariance that the parameters have at least: recorded numbers and instants (`timing`) are rounded.

    An instant that is read wrongly moves all the dead times of an element alike.
    """
    least = np.diag((levels.RECORDED_DIGITS * np.abs(theta)) ** 2)
    for part in row.slices:
        late = np.zeros(row.size)
        late[part] = timing * row.is_dead_time[part]
        least += np.outer(late, late)
    return least
