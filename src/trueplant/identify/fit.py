"""Structure-preserving fit of one row of the plant by prediction errors with an autoregressive noise model.

    y = sum_j G_j(p; theta) u_j + offset + free response + v,    A(q) v = e, e white

Damped least squares (`descent`) in theta and the AR coefficients; offsets and initial states are linear and projected
out in every step (variable projection, Golub and Pereyra 1973, with the full derivative).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from trueplant.arrays import Array, BoolArray
from trueplant.identify import levels
from trueplant.identify.descent import Problem, descend
from trueplant.identify.initial_state import Unknown
from trueplant.identify.lagged import at_samples, gram_of_past, with_past
from trueplant.identify.linear_algebra import eliminated, identifiable_columns, inverse, remove, with_held
from trueplant.identify.noise import filter_rows, measured_from, whiten, whitened_valid
from trueplant.identify.restricted import Moved, Restriction
from trueplant.identify.row import Row


@dataclass(frozen=True, eq=False)
class RowFit:
    """Estimate of one row: parameters of its elements, noise model, covariance."""

    row: Row
    theta: Array
    """(row.size,) parameters of the elements, stacked in the order of row.specs."""
    ar: Array
    """(order,) coefficients a1, a2, ... of A(q) = 1 + a1 q^-1 + ..."""
    variance: float
    """Of the prediction error e."""
    information: Array
    """(size + order, size + order) Gauss-Newton information of theta and ar, in units of 1/variance."""
    cost: float
    """Sum of squares of the weighted prediction errors, times what the prior makes of it (`evaluate`)."""
    count: int
    """Prediction errors used."""
    weights: Array
    """(n_pieces,) 1/relative standard deviation of the prediction errors in each piece."""
    converged: bool
    free: BoolArray
    """(size,) parameters that were estimated; the others are fixed."""

    @property
    def deviance(self) -> float:
        """-2 log likelihood up to a constant, of errors as many as are free: with many pieces fewer than there are."""
        return float(self.left * np.log(max(self.cost, 1e-300) / self.count))

    @property
    def covariance(self) -> Array:
        """(size, size) of theta; a very large variance where the data do not determine a parameter."""
        n = self.theta.size
        return self.variance * inverse(self.information)[:n, :n]

    @property
    def covariance_by_data(self) -> Array:
        """(size, size) what the record alone says of theta, without the prior: very large where it says nothing."""
        n = self.theta.size
        information = self.information.copy()
        prior = self.row.prior.normal_equations(self.theta)[0] * self.variance * self.left / max(self.count, 1)
        whole = np.diag(information)[:n].copy()
        information[np.arange(n), np.arange(n)] -= np.where(self.free, prior, 0.0)
        silent = np.flatnonzero(np.diag(information)[:n] <= levels.LOST * whole)
        information[silent, :] = information[:, silent] = 0.0  # what is left of these is rounding
        return self.variance * inverse(information)[:n, :n]

    @property
    def standard_errors_by_data(self) -> Array:
        """(size,) those of `covariance_by_data`."""
        return np.asarray(np.sqrt(np.diag(self.covariance_by_data)))

    @property
    def left(self) -> int:
        """Degrees of freedom that parameters, noise model and nuisance terms leave, all of them counted as free."""
        return max(self.count - self.theta.size - self.ar.size - self.row.unknown_count, 1)


@dataclass(frozen=True, eq=False)
class Point:
    """Where the fit stands: the cost, and its derivatives by theta and ar, one after the other."""

    cost: float
    information: Array
    """(size + order, size + order)"""
    slope: Array
    """(size + order,) half of the gradient."""
    count: int
    """Prediction errors."""
    power: Array
    """(n_pieces, 2) weighted sum of squares and number of errors of each piece."""
    weights: Array
    """(n_pieces,)"""

    @property
    def unit(self) -> float:
        return self.cost / max(self.count, 1)


@np.errstate(over="ignore", invalid="ignore")
def evaluate(row: Row, theta: Array, ar: Array, weights: Array) -> Point:
    """Cost and normal equations at theta and ar, operating points and initial states projected out.

    The prior of theta is in both: the fit is the most probable plant. Trials may be far off enough that numbers
    overflow: the cost is then not finite, and the descent refuses them.
    """
    size = theta.size + ar.size
    information, slope = np.zeros((size, size)), np.zeros(size)
    power = np.zeros((len(row.pieces), 2))
    for piece in linearised(row, theta, ar, weights):
        power[piece.number] = piece.errors @ piece.errors, piece.errors.size
        told, down = piece.normal_equations()
        information += told
        slope += down
    squares, count = float(power[:, 0].sum()), int(power[:, 1].sum())
    unit = squares / max(count, 1)
    diagonal, pull = row.prior.normal_equations(theta)
    information[np.arange(theta.size), np.arange(theta.size)] += unit * diagonal
    slope[: theta.size] += unit * pull
    penalty = row.prior.penalty(theta)
    if row.restricted is not None:
        more, pull = row.restricted.penalty(ar)
        penalty, slope[theta.size :] = penalty + more, slope[theta.size :] + unit * pull
    # so that count log(cost), which is -2 log likelihood, rises by the penalty
    cost = squares * np.exp(min(penalty / max(count, 1), levels.LARGEST_EXPONENT))
    return Point(float(cost), information, slope, count, power, weights)


@dataclass(frozen=True, eq=False)
class Linearised:
    """Weighted prediction errors of one piece and their derivatives, operating points and initial states taken out."""

    number: int
    """Of the piece."""
    use: slice | BoolArray
    """The prediction errors that there are."""
    errors: Array
    """(n_used,)"""
    ar: Array
    """(order,)"""
    weight: float
    output_errors: Array
    """(n,) weighted."""
    basis: Array
    """(n_used, rank) what operating points and initial states span."""
    moved: Array
    """(size, n) the output by theta."""
    unknown: Array
    """(n_z, n) responses to operating points and initial states, as far as they can be told."""
    largest: Array
    """(n_z,) amplitude that each of them may have."""

    @cached_property
    def jacobian(self) -> Array:
        """(size + order, n_used) by theta and ar."""
        return self._derivatives(self.ar.size)

    def normal_equations(self) -> tuple[Array, Array]:
        """Information (size + order, size + order) and half the gradient (size + order,)."""
        order, size = self.ar.size, len(self.moved)
        if order <= levels.WRITTEN_OUT:
            return self.jacobian @ self.jacobian.T, self.jacobian @ self.errors
        by_theta, basis, past = self._derivatives(0), self.basis.T, self.output_errors
        rows = np.vstack([by_theta, self.errors, basis])
        products = with_past(at_samples(rows, self.use, order, past.size), past, order)
        across, slope, spanned = products[:size], products[size], products[size + 1 :]
        noise = gram_of_past(past, self.use, order) - spanned.T @ spanned
        information = np.block([[by_theta @ by_theta.T, across], [across.T, noise]])
        return information, np.concatenate([by_theta @ self.errors, slope])

    def _derivatives(self, lags: int) -> Array:
        """(size + lags, n_used) by theta and so many coefficients, without what `basis` spans."""
        out = _derivatives(self.moved, self.output_errors, self.weight, self.ar, self.use, lags)
        remove(self.basis.T, out)
        return out


def linearised(row: Row, theta: Array, ar: Array, weights: Array) -> Iterator[Linearised]:
    """The pieces that have prediction errors."""
    order = ar.size
    for k in range(len(row.pieces)):
        y, valid = row.measured(k)
        if y.size <= order + 1:
            continue
        use = _used(order, valid)
        if use is None:
            continue
        response, gradient = row.response_and_gradient(theta, k)
        unknown = row.unknown(theta, k)
        v = np.where(valid, y - response, 0.0)
        coefficients, basis = _weights_of_unknowns(unknown, v, ar, use)
        v = np.where(valid, v - unknown.columns @ coefficients, 0.0)
        errors = weights[k] * whiten(ar, v)[use]
        moved = np.ascontiguousarray(gradient.T)
        unknown.add_gradient(coefficients, moved)
        told, weight = coefficients != 0, float(weights[k])
        yield Linearised(
            k, use, errors, ar, weight, weight * v, basis, moved, unknown.rows[told], unknown.largest[told]
        )


def _derivatives(moved: Array, v: Array, weight: float, ar: Array, use: slice | BoolArray, lags: int) -> Array:
    """(size + lags, n_used) of the weighted prediction errors, by theta and the first coefficients of the noise model.

    `moved` (size, n) is what theta does to the output, v (n,) the weighted output errors.
    """
    order, size = ar.size, len(moved)
    first = use.start if isinstance(use, slice) else 0
    out = np.empty((size + lags, v.size - order - first))
    filter_rows(-weight * np.concatenate([[1.0], ar]), moved, first, out[:size])
    for lag in range(1, lags + 1):
        out[size + lag - 1] = v[order + first - lag : v.size - lag]
    return out if isinstance(use, slice) else np.compress(use, out, axis=1)


def _weights_of_unknowns(unknown: Unknown, v: Array, ar: Array, use: slice | BoolArray) -> tuple[Array, Array]:
    """Weights (n_z,) of the unknowns in the output errors v (n,), 0 where not identifiable, and what they span.

    The basis (n_used, rank) is that of the unknowns in the prediction errors that `use` picks.
    """
    columns, errors = whiten(ar, unknown.columns)[use], whiten(ar, v)[use]
    identifiable = identifiable_columns(columns, errors, unknown.largest)
    weights = np.zeros(identifiable.size)
    weights[identifiable], basis = eliminated(columns.T[identifiable].T, errors)
    return weights, basis


@dataclass(frozen=True, eq=False)
class Whitening:
    """How changes of the response of one piece reach its prediction errors, at the end of a fit."""

    ar: Array
    weight: float
    use: slice | BoolArray
    basis: Array
    """(n_used, rank) what operating points and initial states span."""
    jacobian: Array
    """(size + order, n_used) of the prediction errors, without what those span."""
    errors: Array
    """(n_used,)"""

    @classmethod
    def of(cls, fit: RowFit) -> tuple[Whitening | None, ...]:
        """One a piece; None for a piece that has no prediction errors."""
        found: list[Whitening | None] = [None] * len(fit.row.pieces)
        for piece in linearised(fit.row, fit.theta, fit.ar, fit.weights):
            found[piece.number] = cls(fit.ar, piece.weight, piece.use, piece.basis, piece.jacobian, piece.errors)
        return tuple(found)

    def __call__(self, responses: Array) -> Array:
        """(m, n_used) what each of the responses (m, n), subtracted from PV, takes off the prediction errors."""
        filtered = self.weight * whiten(self.ar, responses.T)[self.use].T
        return np.asarray(filtered - (filtered @ self.basis) @ self.basis.T)


def restriction_of(fit: RowFit) -> Restriction:
    """The restricted likelihood of the fit's row, by how it responds where the fit is."""
    prior = fit.variance * fit.row.prior.normal_equations(fit.theta)[0]
    moved = _Moved(fit)
    kept = moved if fit.count > levels.SEARCHED_ERRORS else tuple(moved)
    return Restriction(fit.theta.size, kept, prior, fit.free, fit.ar)


@dataclass(frozen=True, eq=False)
class _Moved:
    """What parameters and unknowns do to the output of each piece, worked out anew each time."""

    fit: RowFit

    def __iter__(self) -> Iterator[Moved]:
        fit = self.fit
        for piece in linearised(fit.row, fit.theta, fit.ar, fit.weights):
            rows = fit.weights[piece.number] * np.vstack([piece.moved, piece.unknown])
            yield Moved(rows, piece.use, fit.variance / np.maximum(piece.largest, np.finfo(float).tiny) ** 2)


def _used(order: int, valid: BoolArray) -> slice | BoolArray | None:
    """The prediction errors that rest on measured outputs alone; None where there are none."""
    first, rest = measured_from(order, valid)
    if first < 0:
        return None
    return slice(first, None) if rest else whitened_valid(order, valid)


def fit_row(
    row: Row,
    theta: Array,
    ar: Array,
    *,
    weights: Array | None = None,
    free: BoolArray | None = None,
    reweight: bool = True,
    iterations: int = 100,
    settled: float = levels.SETTLED,
) -> RowFit:
    """Least prediction errors from an initial guess.

    `free` marks the parameters of theta that may move. With several pieces, each is weighted by its own
    prediction-error level, re-estimated as the fit proceeds unless `reweight` is False.
    """
    weights = np.ones(len(row.pieces)) if weights is None else weights
    free = np.ones(theta.size, dtype=bool) if free is None else free
    n = theta.size
    low, high = row.bounds()
    anywhere = np.full(ar.size, np.inf)
    moving = np.concatenate([free, np.ones(ar.size, dtype=bool)])

    def at(x: Array, near: Point) -> Point:
        return evaluate(row, x[:n], x[n:], near.weights)

    def reweighted(x: Array, point: Point, step: int) -> Point | None:
        if not reweight or len(row.pieces) == 1 or step not in levels.REWEIGHTED:
            return None
        return evaluate(row, x[:n], x[n:], _level_weights(point.power, point.weights))

    problem = Problem(
        at,
        np.concatenate([low, -anywhere]),
        np.concatenate([high, anywhere]),
        moving,
        np.concatenate([row.is_dead_time, np.zeros(ar.size, dtype=bool)]),
        levels.EXACT * max(row.energy, 1e-300),
        settled,
        reweighted,
    )
    found = descend(problem, np.concatenate([theta, ar]), evaluate(row, theta, ar, weights), iterations)
    theta, ar, point = found.x[:n], found.x[n:], found.point
    left = max(point.count - int(moving.sum()) - row.unknown_count, 1)
    information = with_held(point.information, moving)
    variance = float(point.power[:, 0].sum()) / left
    return RowFit(row, theta, ar, variance, information, point.cost, point.count, point.weights, found.converged, free)


def refitted(fit: RowFit, theta: Array, free: BoolArray) -> RowFit:
    """The fit from other parameters, some of them free, as far as profiles and the search for other minima need it."""
    return fit_row(
        fit.row,
        theta,
        fit.ar,
        weights=fit.weights,
        free=free,
        reweight=False,
        iterations=levels.PROFILED_STEPS,
        settled=levels.TRIED_SETTLED,
    )


def _level_weights(power: Array, weights: Array) -> Array:
    """Weights that level the prediction errors of the pieces, held within a factor of 10 of the typical one."""
    spread = np.sqrt(power[:, 0] / np.maximum(power[:, 1], 1)) / weights
    typical = np.median(spread[power[:, 1] > 0]) if (power[:, 1] > 0).any() else 1.0
    if typical <= 0:
        return weights
    levelled: Array = np.clip(typical / np.maximum(spread, 1e-300), 0.1, 10.0)
    return levelled


def residuals(fit: RowFit) -> list[tuple[Array, Array, BoolArray]]:
    """For each piece: the output error v (NaN where not measured), the prediction error e, and where e is valid."""
    out = []
    row, order = fit.row, fit.ar.size
    for k in range(len(row.pieces)):
        y, valid = row.measured(k)
        response = row.response(fit.theta, k)
        v = np.where(valid, y - response, 0.0)
        e = np.full(y.size, np.nan)
        if y.size > order + 1 and (use := whitened_valid(order, valid)).any():
            unknown = row.unknown(fit.theta, k)
            v = v - unknown.columns @ _weights_of_unknowns(unknown, v, fit.ar, use)[0]
            e[order:][use] = whiten(fit.ar, np.where(valid, v, 0.0))[use]
        out.append((np.where(valid, v, np.nan), e, np.isfinite(e)))
    return out
