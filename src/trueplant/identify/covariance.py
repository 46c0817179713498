"""What the curvature of the likelihood does not know of the uncertainty: slow noise, initial states, rounding."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.stats import norm, t

from trueplant.arrays import Array, BoolArray
from trueplant.identify import levels
from trueplant.identify.fit import RowFit, linearised
from trueplant.identify.linear_algebra import inverse, log_determinant
from trueplant.identify.noise import whiten
from trueplant.identify.row import Row


def inflation(fit: RowFit, confidence: float) -> Array:
    """(size,) factors on the variances of theta for what is not known of the noise model.

    A parameter is known as well as the noise is small at the frequencies that tell it: by the coefficients a of A(q)
    its variance v moves as d log v/da = -2 rho (`Told`). The fit takes a share of the noise with it for each
    parameter, operating point and initial state, so that the noise looks smaller than it is; the restricted likelihood
    (Patterson and Thompson 1971) takes that back (`restricted_growth`). What is still not known of a gives the degrees
    of freedom of Student's quantile (Satterthwaite's rule, as in Kenward and Roger 1997).

    Slow noise is no autoregression for certain, and the first order not enough. Under AR(1) noise with the pole 1 - A a
    level is known from the record as well as from N A^2 white errors, and the variance of rho'a is 2/(N A): by that A
    each parameter has errors of its own, of which the fit takes one for each unknown. At least half are taken to be
    left: of noise that wanders without end the level tells nothing, and the parameters are then known from faster
    changes. The larger of the two counts.
    """
    rows = Rows.of(fit)
    told = Told.of(rows, fit.ar)
    spread = fit.variance * inverse(fit.information)[fit.theta.size :, fit.theta.size :]
    uncertain = np.einsum("ik,kl,il->i", told.rho, spread, told.rho)
    known = fit.count * np.minimum((2 / fit.count / np.maximum(uncertain, 1 / fit.count)) ** 2, 1.0)
    left = np.maximum(known - int(fit.free.sum()) - fit.row.nuisance_count, known / 2)
    tail = 0.5 + confidence / 2
    freedom = np.maximum(2 / (4 * uncertain + 2 / fit.left), levels.FEWEST_FREEDOM)
    quantile = t.ppf(tail, freedom) / norm.ppf(tail)
    return np.asarray(np.maximum(restricted_growth(rows, fit.ar, told.taken, spread), known / left) * quantile**2)


def restricted_growth(rows: Rows, ar: Array, taken: Array, spread: Array) -> Array:
    """(size,) variances under the noise model of the largest restricted likelihood, relative to those of the fit.

    It is looked for on the way on which that likelihood rises from the fit's `ar` (order,), whose covariance is
    `spread`.
    """
    length = float(np.sqrt(taken @ spread @ taken))
    if length == 0:
        return np.ones(rows.size)
    way = -spread @ taken / length

    def deviance(errors: float) -> float:
        return errors**2 + 2 * rows.whitened(ar + errors * way).half_log_determinant

    furthest = min(length, levels.RESTRICTED_FURTHEST)
    best = minimize_scalar(deviance, bounds=(0.0, furthest), options={"xatol": levels.RESTRICTED_SETTLED}).x
    here, there = (np.diag(rows.whitened(a).covariance) for a in (ar, ar + best * way))
    return np.maximum(np.divide(there, here, out=np.ones(rows.size), where=here > 0), 1.0)


def scaled(covariance: Array, factors: Array) -> Array:
    """Covariance (..., n, n) with variances larger by factors (n,), of the same correlations."""
    return np.asarray(covariance * np.sqrt(np.outer(factors, factors)))


@dataclass(frozen=True, eq=False)
class Rows:
    """What parameters, operating points and initial states do to the output of each piece, not whitened."""

    size: int
    """Parameters."""
    pieces: tuple[tuple[Array, slice | BoolArray, Array], ...]
    """Of each the rows (size + n_z, n), the prediction errors that there are, and what the prior says of the n_z.

    That is part of what is known of them: what a noise model takes away nearly whole is told by nothing else.
    """
    prior: Array
    """(size,) the same of the parameters."""
    free: BoolArray
    """(size,)"""

    @classmethod
    def of(cls, fit: RowFit) -> Rows:
        pieces = []
        for piece in linearised(fit.row, fit.theta, fit.ar, fit.weights):
            rows = fit.weights[piece.number] * np.vstack([piece.moved, piece.unknown])
            may_be = fit.variance / np.maximum(piece.largest, np.finfo(float).tiny) ** 2
            pieces.append((rows, piece.use, may_be))
        prior = fit.variance * fit.row.prior.normal_equations(fit.theta)[0]
        return cls(fit.theta.size, tuple(pieces), prior, fit.free)

    def whitened(self, ar: Array) -> Whitened:
        """What they tell under a noise model."""
        size = self.size
        shares, inverses, rows, half_log_determinant = [], [], [], 0.0
        information = np.zeros((size, size))
        for plain, use, may_be in self.pieces:
            white = whiten(ar, plain.T)[use].T
            unknown = white[size:] @ white[size:].T + np.diag(may_be)
            inverses.append(inverse(unknown))
            shares.append(white[:size] @ white[size:].T @ inverses[-1])
            white[:size] -= shares[-1] @ white[size:]
            information += white[:size] @ white[:size].T
            half_log_determinant += log_determinant(unknown) / 2
            rows.append(white)
        free = np.ix_(self.free, self.free)
        whole, covariance = (information + np.diag(self.prior))[free], np.zeros((size, size))
        covariance[free] = inverse(whole)
        half_log_determinant += log_determinant(whole) / 2
        return Whitened(half_log_determinant, information, covariance, rows, shares, inverses)


@dataclass(frozen=True, eq=False)
class Whitened:
    """The rows of all pieces under a noise model."""

    half_log_determinant: float
    """Of the information on all parameters, operating points and initial states."""
    information: Array
    """(size, size) on the parameters, without what operating points and initial states do, by the record alone."""
    covariance: Array
    """(size, size) with the prior, relative to the variance of the noise."""
    rows: list[Array]
    """Of each piece (size + n_z, n_used); those of the parameters without what the others do."""
    shares: list[Array]
    """(size, n_z) by which that was taken out."""
    inverses: list[Array]
    """(n_z, n_z) of the information on operating points and initial states."""


@dataclass(frozen=True, eq=False)
class Told:
    """How what tells the parameters, and what the fit takes of the noise, move with the noise model."""

    rho: Array
    """(size, order) sum over time of what tells a parameter, whitened, times the same so many samples before, as it was
    before it was whitened; relative to the sum of squares of the first."""
    taken: Array
    """(order,) slope of `Whitened.half_log_determinant`."""

    @classmethod
    def of(cls, rows: Rows, ar: Array) -> Told:
        order, size = ar.size, rows.size
        moments, taken, white = np.zeros((order, size, size)), np.zeros(order), rows.whitened(ar)
        parts = zip(rows.pieces, white.rows, white.shares, white.inverses, strict=True)
        for (plain, use, _), whitened, shares, inverted in parts:
            alone = plain.copy()
            alone[:size] -= shares @ plain[size:]
            for lag in range(1, order + 1):
                before = alone[:, order - lag : alone.shape[1] - lag].T[use]
                moments[lag - 1] += whitened[:size] @ before[:, :size]
                taken[lag - 1] += np.sum(inverted * (whitened[size:] @ before[:, size:]))
        whole = white.covariance
        told = np.einsum("ia,kab,ib->ik", whole, moments, whole)
        own = np.einsum("ia,ab,ib->i", whole, white.information, whole)
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
