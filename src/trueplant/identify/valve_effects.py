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
from trueplant.loop.valve import Valve

BATCH = 8
"""Valves that are gone through at a time: what they change in long records stays in the cache."""


def behind(fit: RowFit, valves: Mapping[int, Valve]) -> RowFit:
    """The fit with the positions of the valves' stems for their inputs, by column.

    Where a stem stands is not known at first, nor behind a gap. No row is struck for that here, as `behind_valves`
    does: likelihoods of one band and another are of the same rows.
    """
    pieces = []
    for piece in fit.row.pieces:
        inputs = piece.inputs.copy()
        for column, valve in valves.items():
            inputs[column] = valve.positions(piece.recorded[column], start=0.0)
        pieces.append(replace(piece, inputs=inputs, sent=piece.recorded))
    row = replace(fit.row, pieces=tuple(pieces))
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
        distances, slopes = self._expected(told)
        jacobian = np.vstack([told.T, slopes[:, self._free]])
        rivals = np.vstack([rivals.T, np.zeros((distances.size, len(rivals)))])
        self._errors = np.concatenate([*(whitening.errors for _, whitening in self._parts), distances])
        size = np.sqrt(np.einsum("nk,nk->k", jacobian, jacobian))
        size[size == 0] = 1.0
        self._renewed = np.linalg.pinv(jacobian / size, rcond=levels.LOST) / size[:, None]
        self._bases = bases = orthonormal(jacobian), orthonormal(np.hstack([jacobian, rivals]))
        self._left = left = [float(one[0]) for one in _left(self._errors[None], bases)]
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
            changes.append(whitening(np.array([self._response(piece, valve) for valve in valves])))
        changes.append(np.zeros((len(valves), 2 * self._fit.theta.size)))
        changed = np.hstack(changes)
        after = _left(self._errors - changed, self._bases)
        alone, beyond = (self._fit.left * np.log(before / one) for before, one in zip(self._left, after, strict=True))
        return alone, beyond, changed @ self._renewed.T

    def _expected(self, told: Array) -> tuple[Array, Array]:
        """Errors (2 size,) besides those of prediction, and their derivatives by theta and A(q).

        Distances from the model and from the fit: where the record says little of a parameter, first order holds about
        as far as it is large. `told` (n_free, n) has what those that are free do to predictions.
        """
        fit, noise = self._fit, np.sqrt(self._fit.variance)
        distances, slopes = noise * np.array(fit.row.prior.errors(fit.theta))
        alone = np.zeros(self._free.size)
        alone[self._free] = np.einsum("kn,kn->k", told, told)
        n = fit.theta.size
        largest = np.square(np.abs(fit.theta) + fit.row.lag_of_dead_times(fit.theta))
        weighed = np.maximum(largest * alone[:n] + fit.variance, np.finfo(float).tiny)
        kept = noise * np.sqrt(alone[:n] / weighed)
        by = np.zeros((2 * n, self._free.size))
        by[np.arange(n), np.arange(n)], by[np.arange(n, 2 * n), np.arange(n)] = slopes, kept
        return np.concatenate([distances, np.zeros(n)]), by

    def _response(self, piece: Piece, valve: Valve) -> Array:
        """(n,) by how much the piece's response is larger where the valve's stem moves it."""
        moved = valve.positions(piece.recorded[self._column], start=0.0) - piece.inputs[self._column]
        return _element_response(self._fit, self._m, piece, moved)


def _left(errors: Array, bases: Sequence[Array]) -> list[Array]:
    """(m,) each: sums of squares that each of some orthonormal bases (n, k) leaves of errors (m, n)."""
    squares = np.einsum("mn,mn->m", errors, errors)
    return [np.maximum(squares - np.sum((errors @ basis) ** 2, axis=1), 1e-300) for basis in bases]


def _element_response(fit: RowFit, m: int, piece: Piece, u: Array) -> Array:
    """Response (n,) of element m to u (N,) at the strided samples."""
    row = fit.row
    spec, part = row.specs[m], row.slices[m]
    return spec.structure.response(fit.theta[part], u, piece.h, piece.hold[spec.column], row.stride)


def _rivals(fit: RowFit, m: int, piece: Piece) -> Array:
    """(n_rivals, n) what else could explain the errors: a gain that varies with OP, another structure."""
    op = piece.inputs[fit.row.specs[m].column]
    squared = _element_response(fit, m, piece, (op - op.mean()) ** 2)
    return np.vstack([squared, _beyond(fit, m, piece)])


def _beyond(fit: RowFit, m: int, piece: Piece) -> Array:
    """(n_directions, n) what a structure richer than that of element m adds to its response, to first order."""
    row, spec = fit.row, fit.row.specs[m]
    answer = _element_response(fit, m, piece, piece.inputs[spec.column])
    step = row.stride * piece.h
    faster = np.gradient(answer, step)
    directions = [faster, np.gradient(faster, step)]
    own = spec.structure.lag(fit.theta[row.slices[m]])
    longest = max(of.span for of in row.pieces) / levels.SLOW_SPANS
    for times in levels.RICHER_LAGS:
        pole = float(np.exp(-step / np.clip(times * own, step, max(longest, step))))
        directions.append(np.asarray(lfilter([1 - pole], [1.0, -pole], answer)))
    return np.array(directions)
