"""All outputs at once, with a vector autoregression for disturbances that reach several of them.

    y_i = sum_j G_ij(p; theta) u_j + offset + free response + v_i,    v[k] + sum_l A_l v[k - l] = e[k],   e white

The prediction errors of one output then know what the others have seen of the same disturbance, so that OP is
no longer related to them (Ljung 1999, section 8.4). Damped least squares (`descent`) on the determinant of the
covariance of e; offsets and initial states are projected out in every step.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from trueplant.arrays import Array, BoolArray, IntArray
from trueplant.identify import levels
from trueplant.identify.descent import Descent, Problem, descend
from trueplant.identify.fit import RowFit, residuals
from trueplant.identify.linear_algebra import eliminated, identifiable_columns, inverse, with_held
from trueplant.identify.noise import lagged, whitened_valid
from trueplant.identify.portmanteau import correlogram
from trueplant.identify.row import Row


@dataclass(frozen=True, eq=False)
class JointFit:
    """Estimate of all rows together."""

    theta: tuple[Array, ...]
    """One vector a row."""
    covariance: tuple[Array, ...]
    """One matrix a row."""
    moved: tuple[Array, ...]
    """One vector a row: how far the last increase of the order moved theta; its square is in the covariance."""
    ar: Array
    """(order, n_y, n_y)."""
    sigma: Array
    """(n_y, n_y) covariance of the prediction errors."""
    errors: tuple[Array, ...]
    """Prediction errors (n, n_y) of each piece, NaN where an output was not measured."""
    end: _Descended

    @property
    def converged(self) -> bool:
        return self.end.found.converged

    def rise(self, row: int, index: IntArray, values: Array) -> float:
        """By how much -2 log likelihood rises when theta[row][index] is held at values and all else is free."""
        return self.end.rise(sum(theta.size for theta in self.theta[:row]) + index, values)


@dataclass(frozen=True, eq=False)
class _Errors:
    """Prediction errors, and what the weighted ones depend on."""

    plain: tuple[Array, ...]
    """(n - order, n_y) of each piece, 0 where they do not exist."""
    exist: tuple[BoolArray, ...]
    information: Array
    """(size, size) of theta and ar, one after the other."""
    slope: Array


@dataclass(frozen=True, eq=False)
class _Point:
    """All rows at one set of parameters: -2 log likelihood, and its derivatives where they are asked for."""

    rows: Sequence[Row]
    theta: Array
    ar: Array
    errors: _Errors
    """Without derivatives."""
    unit: float = 1.0

    @classmethod
    def at(cls, rows: Sequence[Row], theta: Array, ar: Array, root: Array) -> _Point:
        """`root` weights the errors where operating points and initial states are taken out of them."""
        return cls(rows, theta, ar, _evaluate(rows, theta, ar, root, derivatives=False))

    @cached_property
    def count(self) -> int:
        return int(sum(use.sum() for use in self.errors.exist))

    @cached_property
    def sigma(self) -> Array:
        """(n_y, n_y) covariance of the prediction errors."""
        return np.asarray(sum(e.T @ e for e in self.errors.plain) / max(self.count, 1))

    @cached_property
    def root(self) -> Array:
        """L with L' L the inverse of sigma."""
        return np.asarray(np.linalg.inv(np.linalg.cholesky(self.sigma)))

    @cached_property
    def cost(self) -> float:
        """-2 log likelihood up to a constant."""
        prior = sum(row.prior.penalty(part) for row, part in zip(self.rows, self._parts, strict=True))
        return float(self.count * np.linalg.slogdet(self.sigma)[1] + prior)

    @property
    def _parts(self) -> list[Array]:
        """theta, row by row."""
        return np.split(self.theta, np.cumsum([row.size for row in self.rows])[:-1])

    @cached_property
    def _linearised(self) -> _Errors:
        return _evaluate(self.rows, self.theta, self.ar, self.root)

    @cached_property
    def _prior(self) -> tuple[Array, Array]:
        """Diagonal of the information, and the slope, of the priors; 0 for the noise model."""
        both = [row.prior.normal_equations(part) for row, part in zip(self.rows, self._parts, strict=True)]
        of_noise = np.zeros(self.ar.size)
        return np.concatenate([*(d for d, _ in both), of_noise]), np.concatenate([*(s for _, s in both), of_noise])

    @property
    def information(self) -> Array:
        return np.asarray(self._linearised.information + np.diag(self._prior[0]))

    @property
    def slope(self) -> Array:
        return np.asarray(self._linearised.slope + self._prior[1])


@dataclass(frozen=True, eq=False)
class _Descended:
    """Where all rows together ended, and the problem of which that is the end."""

    problem: Problem[_Point]
    found: Descent[_Point]
    left: float
    """Degrees of freedom of the prediction errors of an output."""

    def rise(self, place: IntArray, values: Array) -> float:
        """By how much -2 log likelihood rises when parameters are held (all rows on end), as far as bounds allow."""
        end, problem = self.found.point, self.problem
        x, free = self.found.x.copy(), problem.free.copy()
        x[place], free[place] = np.clip(values, problem.low[place], problem.high[place]), False
        held = descend(replace(problem, free=free), x, problem.at(x, end), levels.JOINT_ITERATIONS)
        return max(held.point.cost - end.cost, 0.0) * self.left / end.count


def fit_jointly(fits: Sequence[RowFit], order: int | None = None) -> JointFit | None:
    """The rows of `fits` together, started from them, what they hold held; None where they do not share their samples,
    too few have their whole past measured, or they are too many.

    order: of the autoregression; None chooses it by Akaike's criterion.
    """
    rows = [fit.row for fit in fits]
    if not _share_samples(rows):
        return None
    v, valid = _output_errors(fits)
    order = _chosen_order(v, valid, fits) if order is None else order
    theta, n = np.concatenate([fit.theta for fit in fits]), len(rows)
    size = theta.size + order * n * n
    if sum(x.size for x in v) * size > levels.LARGEST_JACOBIAN or max(map(len, v)) <= order:
        return None
    ar = _vector_ar(v, valid, order, order)[0]
    low, high = (np.concatenate(ends) for ends in zip(*(row.bounds() for row in rows), strict=True))
    anywhere = np.full(ar.size, np.inf)

    def at(x: Array, root: Array) -> _Point:
        return _Point.at(rows, x[: theta.size], x[theta.size :].reshape(ar.shape), root)

    initial = np.concatenate([theta, ar.ravel()])
    point = at(initial, np.eye(n))
    if point.count < 2 * size:
        return None
    moving = np.concatenate([*(fit.free for fit in fits), np.ones(ar.size, dtype=bool)])
    problem = Problem(
        lambda x, near: at(x, near.root),
        np.concatenate([low, -anywhere]),
        np.concatenate([high, anywhere]),
        moving,
        np.concatenate([*(row.is_dead_time for row in rows), np.zeros(ar.size, dtype=bool)]),
    )
    found = descend(problem, initial, at(initial, point.root), levels.JOINT_ITERATIONS)
    unknown = sum(row.unknown_count for row in rows)
    left = max(found.point.count - (int(moving.sum()) + unknown) / n, 1.0)
    return _finished(rows, _Descended(problem, found, left))


def _evaluate(rows: Sequence[Row], theta: Array, ar: Array, root: Array, derivatives: bool = True) -> _Errors:
    """Prediction errors, and the normal equations of theta and ar under the weight root' root."""
    order, n_y = ar.shape[0], len(rows)
    ends = np.cumsum([row.size for row in rows])
    places = [slice(int(end) - row.size, int(end)) for row, end in zip(rows, ends, strict=True)]
    size = theta.size + ar.size
    information, slope = np.zeros((size, size)), np.zeros(size)
    errors, exist = [], []
    for k in range(len(rows[0].pieces)):
        measured = [row.measured(k) for row in rows]
        whole = np.all([ok for _, ok in measured], axis=0)
        use = whitened_valid(order, whole)
        exist.append(use)
        n = whole.size
        if not use.any():
            errors.append(np.zeros((max(n - order, 0), n_y)))
            continue
        parts = [theta[place] for place in places]
        responses = [row.response_and_gradient(part, k) for row, part in zip(rows, parts, strict=True)]
        v = np.column_stack([y - f for (y, _), (f, _) in zip(measured, responses, strict=True)])
        unknown = [row.unknown(part, k) for row, part in zip(rows, parts, strict=True)]
        nuisance = [of_row.columns for of_row in unknown]
        filtered = [_filtered(ar, z, i) for i, z in enumerate(nuisance)]
        columns = _stacked(root, np.concatenate(filtered, axis=2), use)
        e = _stacked(root, _prediction_errors(ar, v)[:, :, None], use)[:, 0]
        identifiable = identifiable_columns(columns, e[::n_y], np.concatenate([of_row.largest for of_row in unknown]))
        columns, all_weights = columns[:, identifiable], np.zeros(identifiable.size)
        all_weights[identifiable], basis = eliminated(columns, e)
        weights = np.split(all_weights, np.cumsum([z.shape[1] for z in nuisance])[:-1])
        v -= np.column_stack([z @ w for z, w in zip(nuisance, weights, strict=True)])
        v[~whole] = 0.0
        plain = _prediction_errors(ar, v)
        plain[~use] = 0.0
        errors.append(plain)
        if not derivatives:
            continue
        jacobian = np.zeros((n - order, n_y, size))
        for i, place in enumerate(places):
            gradient = responses[i][1] + unknown[i].gradient(weights[i])
            jacobian[:, :, place] = -_filtered(ar, gradient, i)
        past = lagged(v, order).reshape(n - order, order, n_y)
        of_ar = jacobian[:, :, theta.size :].reshape(n - order, n_y, order, n_y, n_y)
        for i in range(n_y):
            of_ar[:, i, :, i, :] = past
        jacobian[:, :, theta.size :] = of_ar.reshape(n - order, n_y, -1)
        J = _stacked(root, jacobian, use)
        J -= basis @ (basis.T @ J)
        information += J.T @ J
        slope += J.T @ _stacked(root, plain[:, :, None], use)[:, 0]
    return _Errors(tuple(errors), tuple(exist), information, slope)


def _finished(rows: Sequence[Row], end: _Descended) -> JointFit:
    point = end.found.point
    theta, ar = point.theta, point.ar
    ends = np.cumsum([row.size for row in rows])
    # the weight was the inverse of sigma without the degrees of freedom
    sigma = point.sigma * point.count / end.left
    covariance = inverse(with_held(point.information, end.problem.free)) * point.count / end.left
    places = [slice(int(end) - row.size, int(end)) for row, end in zip(rows, ends, strict=True)]
    order = ar.shape[0]
    errors = []
    for e, use in zip(point.errors.plain, point.errors.exist, strict=True):
        whole = np.full((len(e) + order, len(rows)), np.nan)
        whole[order:][use] = e[use]
        errors.append(whole)
    return JointFit(
        theta=tuple(theta[place] for place in places),
        covariance=tuple(covariance[place, place] for place in places),
        moved=tuple(np.zeros(row.size) for row in rows),
        ar=ar,
        sigma=sigma,
        errors=tuple(errors),
        end=end,
    )


def _stacked(root: Array, x: Array, use: BoolArray) -> Array:
    """(n n_y, columns) of x (n, n_y, columns) where all outputs were measured, weighted by root."""
    return np.asarray(np.einsum("ij,tjc->tic", root, x[use])).reshape(-1, x.shape[2])


def fit_until_white(fits: Sequence[RowFit]) -> JointFit | None:
    """`fit_jointly` with an order beyond the one at which the prediction errors are white; None if none is.

    One output may predict another almost exactly, which takes a long autoregression to describe: how far the last
    increase of the order moved the estimate is added to its covariance.
    """
    fit = fit_jointly(fits)
    while fit is not None:
        order = fit.ar.shape[0]
        white = whiteness_p(fit) > levels.NOT_WHITE
        longer = (
            fit_jointly(fits, min(order * 3 // 2 + 2, levels.JOINT_LARGEST_ORDER))
            if order < levels.JOINT_LARGEST_ORDER
            else None
        )
        if white:
            return _with_shift(fit, longer or fit)
        fit = longer
    return None


def _with_shift(fit: JointFit, longer: JointFit) -> JointFit | None:
    """The longer fit, its covariance enlarged by how far it moved; None if it did not converge."""
    moved = tuple(theta - before for before, theta in zip(fit.theta, longer.theta, strict=True))
    larger = tuple(own + np.diag(by**2) for own, by in zip(longer.covariance, moved, strict=True))
    return replace(longer, covariance=larger, moved=moved) if longer.converged else None


def whiteness_p(fit: JointFit) -> float:
    """p-value that the prediction errors are white, over JOINT_LAGS lags beyond the order (Hosking 1980)."""
    order, n_y = fit.ar.shape[:2]
    return correlogram(fit.errors, order + levels.JOINT_LAGS).p_value(n_y**2 * order)


def _share_samples(rows: Sequence[Row]) -> bool:
    """Have all rows the same pieces, sampled at the same instants?"""
    first = rows[0]
    return all(
        row.stride == first.stride
        and len(row.pieces) == len(first.pieces)
        and all(
            a.experiment == b.experiment and a.y.size == b.y.size for a, b in zip(row.pieces, first.pieces, strict=True)
        )
        for row in rows[1:]
    )


def _output_errors(fits: Sequence[RowFit]) -> tuple[list[Array], list[BoolArray]]:
    """Output errors (n, n_y) of each piece, and where all of them were measured."""
    columns = [[v for v, _, _ in residuals(fit)] for fit in fits]
    stacked = [np.column_stack(piece) for piece in zip(*columns, strict=True)]
    return [np.nan_to_num(v) for v in stacked], [np.isfinite(v).all(axis=1) for v in stacked]


def _vector_ar(v: Sequence[Array], valid: Sequence[BoolArray], order: int, past: int) -> tuple[Array, float, int]:
    """Least-squares coefficients (order, n_y, n_y), log determinant of the residual covariance, number of residuals.

    Of the samples of which `past` before them, at least `order`, were measured.
    """
    n = v[0].shape[1]
    pairs = [(x, whitened_valid(past, ok)) for x, ok in zip(v, valid, strict=True) if len(x) > past]
    before = np.vstack([lagged(x, order)[past - order :][use] for x, use in pairs])
    now = np.vstack([x[past:][use] for x, use in pairs])
    weights = np.linalg.lstsq(before, now, rcond=1e-10)[0] if order else np.zeros((0, n))
    rest = now - before @ weights
    determinant = np.linalg.slogdet(rest.T @ rest / max(len(rest), 1))[1]
    return np.asarray(-weights.reshape(order, n, n).transpose(0, 2, 1)), float(determinant), len(rest)


def _chosen_order(v: Sequence[Array], valid: Sequence[BoolArray], fits: Sequence[RowFit]) -> int:
    """By Akaike's criterion, all on the same samples: fewer of them would count as likelier in some units of PV."""
    n = len(fits)
    most = min(levels.JOINT_LARGEST_ORDER, max(2 * max(fit.ar.size for fit in fits), 4))

    def bearing(order: int) -> int:
        return sum(int(whitened_valid(order, ok).sum()) for ok in valid)

    largest = next((k for k in range(most, 0, -1) if bearing(k) >= 8 * n * k), 0)
    scores = []
    for order in range(largest + 1):
        _, determinant, count = _vector_ar(v, valid, order, largest)
        scores.append(count * determinant + 2 * order * n * n)
    return int(np.argmin(scores))


def _prediction_errors(ar: Array, v: Array) -> Array:
    """(n - order, n_y) of output errors v (n, n_y)."""
    order, n = ar.shape[0], len(v)
    out = v[order:].copy()
    for k in range(order):
        out += v[order - k - 1 : n - k - 1] @ ar[k].T
    return out


def _filtered(ar: Array, x: Array, source: int) -> Array:
    """(n - order, n_y, columns): what columns x (n, columns) in output `source` do to all prediction errors."""
    order, n_y = ar.shape[:2]
    n = len(x)
    out = np.zeros((n - order, n_y, x.shape[1]))
    out[:, source] = x[order:]
    for k in range(order):
        out += ar[k, :, source][None, :, None] * x[order - k - 1 : n - k - 1][:, None, :]
    return out
