"""What valves that do not follow OP do to the fit of one output."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.signal import lfilter

from trueplant.arrays import Array, BoolArray
from trueplant.identify import levels
from trueplant.identify.fit import RowFit, Whitening, fit_row
from trueplant.identify.linear_algebra import orthonormal
from trueplant.identify.pieces import Piece
from trueplant.identify.row import Row
from trueplant.loop.valve import Valve, positions_of

BATCH = 16
"""Valves that are gone through at a time: what they change in long records stays in the cache."""


def row_behind(row: Row, valves: Mapping[int, Valve]) -> Row:
    """The row with the positions of the valves' stems for their inputs, by column."""
    pieces = []
    for piece in row.pieces:
        inputs, sent, origin = piece.inputs.copy(), piece.recorded.copy(), piece.about.copy()
        for column, valve in valves.items():
            (inputs[column],), (begun,) = stems(piece, column, [valve])
            sent[column] -= begun
            origin[column] += begun
        pieces.append(replace(piece, inputs=inputs, sent=sent, origin=origin))
    return replace(row, pieces=tuple(pieces))


def stems(piece: Piece, column: int, valves: Sequence[Valve]) -> tuple[Array, Array]:
    """(n_valves, N) how far the stem of each has gone since it began, and (n_valves,) how far from OP it began.

    Where stems stand at first is not known, but for those that are at their ends: they begin where OP does.
    """
    at, about = piece.recorded[column], float(piece.about[column])
    begun = np.array([np.clip(0.0, valve.low - about, valve.high - about) for valve in valves])
    return positions_of(valves, at, 0.0, about) - begun[:, None], begun


def behind(fit: RowFit, valves: Mapping[int, Valve]) -> RowFit:
    """The fit with the positions of the valves' stems for their inputs, by column.

    Where a stem stands is not known at first, nor behind a gap. No row is struck for that here, as `behind_valves`
    does: likelihoods of one band and another are of the same rows.
    """
    row = row_behind(fit.row, valves)
    settled = levels.TRIED_SETTLED
    return fit_row(row, fit.theta, fit.ar, weights=fit.weights, free=fit.free, reweight=False, settled=settled)


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

    @property
    def sums(self) -> tuple[Array, Array, Array]:
        """What adds up over outputs."""
        return self.alone, self.evidence, self.beyond


@dataclass(frozen=True, eq=False)
class RowErrors:
    """The weighted prediction errors of one output, and what may still change them.

    The fit may stand on the positions of a stem already. What is expected of the plant makes errors besides: behind a
    wide band one beyond all bounds would be as likely to first order.
    """

    fit: RowFit

    @cached_property
    def pieces(self) -> list[tuple[Piece, Whitening]]:
        """Those that have prediction errors."""
        every = zip(self.fit.row.pieces, Whitening.of(self.fit), strict=True)
        return [(piece, whitening) for piece, whitening in every if whitening is not None]

    @cached_property
    def free(self) -> BoolArray:
        """(size + order,) which of theta and A(q) may change."""
        return np.concatenate([self.fit.free, np.ones(self.fit.ar.size, dtype=bool)])

    @cached_property
    def _linear(self) -> tuple[Array, Array]:
        fit, free = self.fit, self.free
        told = np.hstack([whitening.jacobian[free] for _, whitening in self.pieces])
        alone = np.zeros(free.size)
        alone[free] = np.einsum("kn,kn->k", told, told)
        distances, of_theta = expected(fit.row, fit.theta, alone[: fit.theta.size], fit.variance)
        slopes = np.hstack([of_theta, np.zeros((distances.size, fit.ar.size))])
        errors = np.concatenate([*(whitening.errors for _, whitening in self.pieces), distances])
        return errors, np.vstack([told.T, slopes[:, free]])

    @property
    def errors(self) -> Array:
        """(n,) of predictions and of what is expected."""
        return self._linear[0]

    @property
    def jacobian(self) -> Array:
        """(n, n_free) of them by what is free."""
        return self._linear[1]

    @cached_property
    def basis(self) -> Array:
        """(n, rank) of what that spans."""
        return orthonormal(self.jacobian)

    def element(self, column: int) -> int:
        """The place of the element that an input moves it through."""
        return next(m for m, spec in enumerate(self.fit.row.specs) if spec.column == column)

    def whitened(self, answers: Callable[[Piece], Array]) -> Array:
        """(n, k) of answers (k, n) in the pieces, as what changes the errors."""
        found = np.hstack([whitening(answers(piece)) for piece, whitening in self.pieces])
        return np.vstack([found.T, np.zeros((2 * self.fit.theta.size, len(found)))])

    def with_more(self, columns: Array) -> Array:
        """(n, rank) the basis, and behind it that of what `columns` (n, k) span besides."""
        rest = columns
        for _ in range(2):  # once more than exact numbers would need
            rest = rest - self.basis @ (self.basis.T @ rest)
        new = np.linalg.norm(rest, axis=0) > levels.LOST * np.linalg.norm(columns, axis=0)
        return np.hstack([self.basis, orthonormal(rest[:, new])])

    def fallen(self, m: int, valves: Sequence[Valve]) -> Array:
        """(n_valves, n) by how much they are smaller with the positions of each stem for the input of element m."""
        row, theta = self.fit.row, self.fit.theta
        fallen = [whitening(responses_behind(row, theta, m, piece, valves)) for piece, whitening in self.pieces]
        return np.hstack([*fallen, np.zeros((len(valves), 2 * theta.size))])

    def promised(self, column: int, valves: Sequence[Valve]) -> Array:
        """(n_valves,) by how much -2 log likelihood would fall to first order behind each of these in an input."""
        m = self.element(column)
        return promised(self.errors, self.basis, self.fit.left, lambda batch: self.fallen(m, batch), valves)


def promised(
    errors: Array, basis: Array, left: float, fallen: Callable[[Sequence[Valve]], Array], valves: Sequence[Valve]
) -> Array:
    """(n_valves,) by how much -2 log likelihood of errors (n,), as many as are `left` free of them, would fall.

    `basis` (n, rank) is that of what may change them, `fallen` by how much they are smaller behind valves.
    """
    before = float(what_is_left(errors[None], basis)[0])
    after = [what_is_left(errors - fallen(valves[k : k + BATCH]), basis) for k in range(0, len(valves), BATCH)]
    return np.asarray(left * np.log(before / np.concatenate(after)))


class ValveTest:
    """The prediction errors of one output, ready for what valves in one of its inputs would change."""

    def __init__(self, fit: RowFit, column: int) -> None:
        self._own = own = RowErrors(fit)
        self._m = own.element(column)
        rivals = own.whitened(lambda piece: _rivals(fit, self._m, piece))
        size = np.sqrt(np.einsum("nk,nk->k", own.jacobian, own.jacobian))
        size[size == 0] = 1.0
        self._basis = own.with_more(rivals)
        self._renewed = np.linalg.pinv(own.jacobian / size, rcond=levels.LOST) @ own.basis / size[:, None]
        self._before = before = self._left(own.errors[None])
        more = self._basis.shape[1] - own.basis.shape[1]
        self.gained = fit.left * float(np.log(before[0][0] / before[1][0]))
        """What all else that could explain the errors gains in -2 log likelihood, to first order."""
        # log odds that what else could explain the errors is needed, by the Bayesian criterion
        self._needed = needed = (self.gained - more * np.log(own.errors.size - 2 * fit.theta.size)) / 2
        self.open_to = float(np.logaddexp(0.0, needed))
        """log of the ratio of likelihoods, with all else as far as the record needs that against with nothing else."""

    def of(self, valves: Sequence[Valve]) -> Effects:
        own = self._own
        batches = [self._batch(valves[k : k + BATCH]) for k in range(0, len(valves), BATCH)]
        alone, beyond, moved = (np.concatenate(of_each) for of_each in zip(*batches, strict=True))
        shifts = np.zeros((len(valves), own.free.size))
        shifts[:, own.free] = moved
        evidence = np.logaddexp(alone / 2, self._needed + beyond / 2) - self.open_to
        return Effects(alone, evidence, beyond, shifts[:, : own.fit.theta.size])

    def _batch(self, valves: Sequence[Valve]) -> tuple[Array, Array, Array]:
        """(m,) what each valve gains alone, (m,) beside all else, and (m, n_free) by how much it moves what is free."""
        own = self._own
        after = self._left(own.errors - own.fallen(self._m, valves))
        alone, beyond = (own.fit.left * np.log(self._before[k] / after[k]) for k in range(2))
        return alone, beyond, (self._before[2] - after[2]) @ self._renewed.T

    def _left(self, errors: Array) -> tuple[Array, Array, Array]:
        """(m,) sums of squares that what may change errors (m, n) leaves of them, (m,) that all else leaves, and
        (m, rank) the errors in the basis of the former."""
        inside, rank = errors @ self._basis, self._own.basis.shape[1]
        squares = np.einsum("mn,mn->m", errors, errors)
        explained = inside[:, :rank] ** 2, inside**2
        own, every = (np.maximum(squares - of.sum(axis=1), 1e-300) for of in explained)
        return own, every, inside[:, :rank]


def bends(fit: RowFit, column: int) -> float:
    """By how much -2 log likelihood of a plant behind a stem that ends would fall, to first order, if OP acted beyond
    that end after all and the gain varied before it."""
    own = RowErrors(fit)
    m = own.element(column)

    def answers(piece: Piece) -> Array:
        stem = piece.inputs[column]
        moves = piece.recorded[column] - stem, (stem - stem.mean()) ** 2
        return np.array([_response(fit.row, fit.theta, m, piece, u) for u in moves])

    bases = own.basis, own.with_more(own.whitened(answers))
    before, after = (float(what_is_left(own.errors[None], basis)[0]) for basis in bases)
    return fit.left * float(np.log(before / after))


BENDS = ("beyond the end", "before it")
"""What `bends` asks for."""


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
    moved = stems(piece, column, valves)[0] - piece.inputs[column]
    return np.array([_response(row, theta, m, piece, u) for u in moved])


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
