"""All outputs at once, with a vector autoregression for disturbances that reach several of them.

    y_i = sum_j G_ij(p; theta) u_j + offset + free response + v_i,    v[k] + sum_l A_l v[k - l] = e[k],   e white

The prediction errors of one output then know what the others have seen of the same disturbance, so that OP is
no longer related to them (Ljung 1999, section 8.4). Damped least squares (`descent`) on the determinant of the
covariance of e; offsets and initial states are projected out in every step.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from trueplant.arrays import Array, BoolArray, IntArray
from trueplant.identify import levels
from trueplant.identify.descent import Problem, descend
from trueplant.identify.fit import RowFit, residuals
from trueplant.identify.joint_errors import places_of
from trueplant.identify.joint_plant import JointPlant, JointPoint
from trueplant.identify.linear_algebra import inverse, with_held
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
    end: JointPlant

    @property
    def converged(self) -> bool:
        return self.end.found.converged

    def rise(self, row: int) -> JointRise:
        """That of the parameters of one row."""
        return JointRise(self.end, sum(theta.size for theta in self.theta[:row]))


@dataclass(frozen=True, eq=False)
class JointRise:
    """By how much -2 log likelihood rises when theta[index] of one row is held at values and all else is free."""

    end: JointPlant
    first: int
    """Of the row, among the parameters of all."""

    def __call__(self, index: IntArray, values: Array) -> float:
        return self.of(self.held(index, values))

    def of(self, held: JointPlant) -> float:
        """That of what is `held`."""
        return max(held.deviance - self.end.deviance, 0.0)

    def held(self, index: IntArray, values: Array) -> JointPlant:
        """All rows, with these held."""
        return self.end.held(self.first + index, values)


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

    initial = np.concatenate([theta, ar.ravel()])
    point = JointPoint.at(rows, initial, order, np.eye(n))
    if point.count < 2 * size:
        return None
    moving = np.concatenate([*(fit.free for fit in fits), np.ones(ar.size, dtype=bool)])
    problem = Problem(
        lambda x, near: JointPoint.at(rows, x, order, near.root),
        np.concatenate([low, -anywhere]),
        np.concatenate([high, anywhere]),
        moving,
        np.concatenate([*(row.is_dead_time for row in rows), np.zeros(ar.size, dtype=bool)]),
    )
    found = descend(problem, initial, problem.at(initial, point), levels.JOINT_ITERATIONS)
    unknown = sum(row.unknown_count for row in rows)
    left = max(found.point.count - (int(moving.sum()) + unknown) / n, 1.0)
    return _finished(rows, JointPlant(problem, found, left))


def _finished(rows: Sequence[Row], end: JointPlant) -> JointFit:
    point = end.found.point
    order, parts = len(point.ar), point.parts
    # the weight was the inverse of sigma without the degrees of freedom
    sigma = point.sigma * point.count / end.left
    covariance = inverse(with_held(point.information, end.problem.free)) * point.count / end.left
    errors = []
    for piece in point.errors:
        whole = np.full((len(piece.plain) + order, len(rows)), np.nan)
        whole[order:][piece.exist] = piece.plain[piece.exist]
        errors.append(whole)
    return JointFit(
        theta=tuple(parts),
        covariance=tuple(covariance[place, place] for place in places_of(rows)),
        moved=tuple(np.zeros(row.size) for row in rows),
        ar=point.ar,
        sigma=sigma,
        errors=tuple(errors),
        end=end,
    )


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
