"""What valves that do not follow OP do to the fit of one output."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import lfilter

from trueplant.arrays import Array
from trueplant.identify import levels
from trueplant.identify.fit import RowFit, Whitening, fit_row
from trueplant.identify.linear_algebra import orthonormal
from trueplant.identify.pieces import Piece
from trueplant.identify.row import Row
from trueplant.loop.valve import Valve

BATCH = 8
"""Valves that are gone through at a time: what they change in long records stays in the cache."""


def row_behind(row: Row, valves: Mapping[int, Valve]) -> Row:
    """The row with the positions of the valves' stems for their inputs, by column."""
    pieces = []
    for piece in row.pieces:
        inputs = piece.inputs.copy()
        for column, valve in valves.items():
            inputs[column] = valve.positions(piece.recorded[column], start=0.0)
        pieces.append(replace(piece, inputs=inputs, sent=piece.recorded))
    return replace(row, pieces=tuple(pieces))


def behind(fit: RowFit, valves: Mapping[int, Valve]) -> RowFit:
    """The fit with the positions of the valves' stems for their inputs, by column.

    Where a stem stands is not known at first, nor behind a gap. No row is struck for that here, as `behind_valves`
    does: likelihoods of one band and another are of the same rows.
    """
    row = row_behind(fit.row, valves)
    return fit_row(row, fit.theta, fit.ar, weights=fit.weights, free=fit.free, reweight=False)


@dataclass(frozen=True, eq=False)
class Effects:
    """What each of several valves does to the fit of one output, the plant renewed to first order."""

    alone: Array
    """(n_valves,) what it gains in -2 log likelihood."""
    evidence: Array
    """(n_valves,) log of the ratio of likelihoods, beside what else could explain the errors as far as the record needs
    that."""
    beyond: Array
    """(n_valves,) what it gains in -2 log likelihood where all else that could explain the errors is there."""
    shifts: Array
    """(n_valves, size) by how much the plant's parameters would be larger."""


class ValveTest:
    """The prediction errors of one output, ready for what valves in one of its inputs would change.

    The fit may stand on the positions of a stem already. What is expected of the plant makes errors besides: behind a
    wide band one beyond all bounds would be as likely to first order.
    """

    def __init__(self, fit: RowFit, column: int) -> None:
        self._fit, self._column = fit, column
        self._m = next(m for m, spec in enumerate(fit.row.specs) if spec.column == column)
        every = zip(fit.row.pieces, Whitening.of(fit), strict=True)
        self._parts = [(piece, of_piece) for piece, of_piece in every if of_piece is not None]
        self._free = np.concatenate([fit.free, np.ones(fit.ar.size, dtype=bool)])
        told = np.hstack([whitening.jacobian[self._free] for _, whitening in self._parts])
        rivals = np.hstack([whitening(_rivals(fit, self._m, piece)) for piece, whitening in self._parts])
        alone = np.zeros(self._free.size)
        alone[self._free] = np.einsum("kn,kn->k", told, told)
        distances, of_theta = expected(fit.row, fit.theta, alone[: fit.theta.size], fit.variance)
        slopes = np.hstack([of_theta, np.zeros((distances.size, fit.ar.size))])
        jacobian = np.vstack([told.T, slopes[:, self._free]])
        rivals = np.vstack([rivals.T, np.zeros((distances.size, len(rivals)))])
        self._errors = np.concatenate([*(whitening.errors for _, whitening in self._parts), distances])
        size = np.sqrt(np.einsum("nk,nk->k", jacobian, jacobian))
        size[size == 0] = 1.0
        self._renewed = np.linalg.pinv(jacobian / size, rcond=levels.LOST) / size[:, None]
        self._bases = bases = orthonormal(jacobian), orthonormal(np.hstack([jacobian, rivals]))
        self._left = left = [float(what_is_left(self._errors[None], basis)[0]) for basis in bases]
        more = bases[1].shape[1] - bases[0].shape[1]
        gained = fit.left * np.log(left[0] / left[1])
        # log odds that what else could explain the errors is needed, by the Bayesian criterion
        self._needed = (gained - more * np.log(told.shape[1])) / 2

    def of(self, valves: Sequence[Valve]) -> Effects:
        batches = [self._batch(valves[k : k + BATCH]) for k in range(0, len(valves), BATCH)]
        alone, beyond, moved = (np.concatenate(of_each) for of_each in zip(*batches, strict=True))
        shifts = np.zeros((len(valves), self._free.size))
        shifts[:, self._free] = moved
        evidence = np.logaddexp(alone / 2, self._needed + beyond / 2) - np.logaddexp(0.0, self._needed)
        return Effects(alone, evidence, beyond, shifts[:, : self._fit.theta.size])

    def _batch(self, valves: Sequence[Valve]) -> tuple[Array, Array, Array]:
        """(m,) what each valve gains alone, (m,) beside all else, and (m, n_free) by how much it moves what is free."""
        changes = []
        for piece, whitening in self._parts:
            changes.append(whitening(responses_behind(self._fit.row, self._fit.theta, self._m, piece, valves)))
        changes.append(np.zeros((len(valves), 2 * self._fit.theta.size)))
        changed = np.hstack(changes)
        after = [what_is_left(self._errors - changed, basis) for basis in self._bases]
        alone, beyond = (self._fit.left * np.log(before / one) for before, one in zip(self._left, after, strict=True))
        return alone, beyond, changed @ self._renewed.T


def expected(row: Row, theta: Array, told: Array, variance: float) -> tuple[Array, Array]:
    """Errors (2 size,) besides those of prediction, whose variance this is, and their derivatives by theta (2 size,
    size).

    Distances from the model and from the fit: where the record says little of a parameter, first order holds about
    as far as it is large. `told` (size,) are the squares of what each does to predictions.
    """
    n, noise = theta.size, np.sqrt(variance)
    distances, slopes = noise * np.array(row.prior.errors(theta))
    largest = np.square(np.abs(theta) + row.lag_of_dead_times(theta))
    weighed = np.maximum(largest * told + variance, np.finfo(float).tiny)
    kept = noise * np.sqrt(told / weighed)
    return np.concatenate([distances, np.zeros(n)]), np.vstack([np.diag(slopes), np.diag(kept)])


def what_is_left(errors: Array, basis: Array) -> Array:
    """(m,) sums of squares that an orthonormal basis (n, k) leaves of errors (m, n)."""
    squares = np.einsum("mn,mn->m", errors, errors)
    return np.asarray(np.maximum(squares - np.sum((errors @ basis) ** 2, axis=1), 1e-300))


def responses_behind(row: Row, theta: Array, m: int, piece: Piece, valves: Sequence[Valve]) -> Array:
    """(n_valves, n) by how much the piece's response is larger where each valve's stem moves element m."""
    column = row.specs[m].column
    op, now = piece.recorded[column], piece.inputs[column]
    return np.array([_response(row, theta, m, piece, valve.positions(op, start=0.0) - now) for valve in valves])


def _response(row: Row, theta: Array, m: int, piece: Piece, u: Array) -> Array:
    """Response (n,) of element m to u (N,) at the strided samples."""
    spec, part = row.specs[m], row.slices[m]
    return spec.structure.response(theta[part], u, piece.h, piece.hold[spec.column], row.stride)


def _rivals(fit: RowFit, m: int, piece: Piece) -> Array:
    """(n_rivals, n) what else could explain the errors: a gain that varies with OP, another structure."""
    op = piece.inputs[fit.row.specs[m].column]
    squared = _response(fit.row, fit.theta, m, piece, (op - op.mean()) ** 2)
    return np.vstack([squared, _beyond(fit, m, piece)])


def _beyond(fit: RowFit, m: int, piece: Piece) -> Array:
    """(n_directions, n) what a structure richer than that of element m adds to its response, to first order."""
    row, spec = fit.row, fit.row.specs[m]
    answer = _response(row, fit.theta, m, piece, piece.inputs[spec.column])
    step = row.stride * piece.h
    faster = np.gradient(answer, step)
    directions = [faster, np.gradient(faster, step)]
    own = spec.structure.lag(fit.theta[row.slices[m]])
    longest = max(of.span for of in row.pieces) / levels.SLOW_SPANS
    for times in levels.RICHER_LAGS:
        pole = float(np.exp(-step / np.clip(times * own, step, max(longest, step))))
        directions.append(np.asarray(lfilter([1 - pole], [1.0, -pole], answer)))
    return np.array(directions)
