"""The output of one row of the plant, simulated on recorded inputs, with its derivatives.

Signals enter as deviations from their first sample. What happened before the record is summed up by
nuisance terms that are linear: an offset for each segment and, unless the record starts at rest, the
free response of every lag.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from trueplant.lti.sampled import rows_response, sampled_response
from trueplant.lti.structure import Structure
from trueplant.lti.transfer import TransferFunction
from trueplant.record.types import Segment

Array = NDArray[np.float64]
BoolArray = NDArray[np.bool_]


FASTEST_LAG = 0.05
"""In samples."""
QUIET_SAMPLES = 20
"""A start is at rest only if the inputs stood still for this many samples."""


@dataclass(frozen=True)
class Spec:
    """One element of the row: which input drives it, and its structure or its fixed transfer function."""

    column: int
    """Index into the inputs followed by the measured disturbances."""
    structure: Structure
    start: tuple[float, ...] | None = None
    """Parameters to start from (the model's); None where the model has no such element."""


@dataclass(frozen=True)
class Held:
    """An element kept at its declared value."""

    column: int
    system: TransferFunction


@dataclass(frozen=True, eq=False)
class Piece:
    """One segment as one output sees it. Inputs are deviations from their first sample."""

    experiment: int
    h: float
    y: Array
    """(N,) minus the response of the held elements; 0 where not valid."""
    valid: BoolArray
    inputs: Array
    """(n_columns, N)."""
    hold: tuple[str, ...]

    @property
    def span(self) -> float:
        return self.h * (self.y.size - 1)

    def from_sample(self, first: int, end: int | None = None) -> Piece:
        """The piece from one sample on (to another)."""
        if first == 0 and end is None:
            return self
        part = slice(first, end)
        inputs = self.inputs[:, part]
        inputs = np.ascontiguousarray(inputs - inputs[:, :1])
        return replace(self, y=self.y[part], valid=self.valid[part], inputs=inputs)

    @cached_property
    def starts_at_rest(self) -> bool:
        """True if no input moves during the first samples and the output does not drift meanwhile."""
        moved = np.flatnonzero(np.any(self.inputs != 0, axis=0))
        lead = int(moved[0]) if moved.size else self.y.size
        y = self.y[:lead][self.valid[:lead]]
        if lead < QUIET_SAMPLES or y.size < QUIET_SAMPLES:
            return False
        early, late = np.array_split(y, 2)
        spread = np.median(np.abs(np.diff(y))) + np.std(late)
        return bool(abs(np.median(late) - np.median(early)) <= spread + 1e-9 * np.ptp(self.y))


def pieces_of(
    segments: Sequence[Segment], output: int, held: Sequence[Held] = (), update: int = 1
) -> tuple[Piece, ...]:
    """The segments in which this output was measured at all.

    `update` is the number of samples for which a historian or instrument holds each PV; pieces then begin with
    a fresh one, so that every `update`-th sample is fresh.
    """
    pieces = []
    for segment in segments:
        valid = np.isfinite(segment.y[:, output])
        if valid.sum() < 2:
            continue
        inputs = np.column_stack([segment.u, segment.d])
        inputs = np.ascontiguousarray((inputs - inputs[0]).T)
        hold = segment.hold + ("linear",) * segment.d.shape[1]
        y = np.where(valid, segment.y[:, output], 0.0)
        for element in held:
            y = y - sampled_response(element.system, inputs[element.column], segment.h, hold[element.column])
        whole = Piece(segment.experiment, segment.h, np.where(valid, y, 0.0), valid, inputs, hold)
        pieces.append(whole.from_sample(_first_update(segment.y[:, output], update)))
    return tuple(pieces)


def _first_update(y: Array, update: int) -> int:
    """The sample, below `update`, from which on every `update`-th one is fresh: where most changes fall."""
    if update <= 1:
        return 0
    changed = np.flatnonzero(np.abs(np.diff(y)) > 0) + 1
    return int(np.argmax(np.bincount(changed % update, minlength=update)))


@dataclass(frozen=True, eq=False)
class Row:
    """A row of elements over pieces of data, seen at every `stride`-th sample."""

    specs: tuple[Spec, ...]
    pieces: tuple[Piece, ...]
    stride: int = 1

    def rests(self, k: int) -> bool:
        """Does piece k start in steady state, so that it needs no free response?"""
        return self.pieces[k].starts_at_rest

    @property
    def slices(self) -> tuple[slice, ...]:
        ends = np.cumsum([len(s.structure.names) for s in self.specs])
        return tuple(slice(int(e) - len(s.structure.names), int(e)) for s, e in zip(self.specs, ends, strict=True))

    @property
    def size(self) -> int:
        return sum(len(s.structure.names) for s in self.specs)

    def bounds(self) -> tuple[Array, Array]:
        """Bounds of theta; lags far shorter than a sample cannot be told from none and end at a twentieth of one."""
        pairs = [s.structure.bounds() for s in self.specs]
        low, high = np.concatenate([low for low, _ in pairs]), np.concatenate([high for _, high in pairs])
        h = self.pieces[0].h
        names = [name for spec in self.specs for name in spec.structure.names]
        low[[name.startswith("tau") for name in names]] = FASTEST_LAG * h
        high[[name.startswith("omega0") for name in names]] = 1 / (FASTEST_LAG * h)
        return low, high

    def measured(self, k: int) -> tuple[Array, BoolArray]:
        piece = self.pieces[k]
        return piece.y[:: self.stride], piece.valid[:: self.stride]

    def without_unseen(self, theta: Array) -> Row:
        """The row without the outputs that still answer to inputs from before a record that starts in motion.

        What OP did in the last dead time before the record is not in it, and no free response makes up for it.
        """
        names = [name for spec in self.specs for name in spec.structure.names]
        dead = max((v for name, v in zip(names, theta, strict=True) if name.startswith("dead")), default=0.0)
        pieces = []
        for piece in self.pieces:
            unseen = 0 if piece.starts_at_rest else min(int(np.ceil(dead / piece.h)), piece.y.size // 5)
            valid = piece.valid.copy()
            valid[:unseen] = False
            pieces.append(replace(piece, valid=valid, y=np.where(valid, piece.y, 0.0)))
        return replace(self, pieces=tuple(pieces))

    def response(self, theta: Array, k: int) -> Array:
        """Simulated output of piece k at the strided samples, from rest."""
        piece = self.pieces[k]
        total = np.zeros(piece.y.size)
        for spec, part in zip(self.specs, self.slices, strict=True):
            total += spec.structure.response(theta[part], piece.inputs[spec.column], piece.h, piece.hold[spec.column])
        return total[:: self.stride]

    def response_and_gradient(self, theta: Array, k: int) -> tuple[Array, Array]:
        """Simulated output (n,) of piece k and its derivative by theta (n, size)."""
        piece = self.pieces[k]
        n = len(range(0, piece.y.size, self.stride))
        total, gradient = np.zeros(n), np.zeros((self.size, n))
        for spec, part in zip(self.specs, self.slices, strict=True):
            u, hold = piece.inputs[spec.column], piece.hold[spec.column]
            for block in spec.structure.gradient_blocks(theta[part]):
                rows = rows_response(block.num, block.den, block.dead_time, u, piece.h, hold)[:, :: self.stride]
                total += rows[0]
                for index, row in zip(block.index, rows[1:], strict=True):
                    gradient[part.start + index] += row
        return total, gradient.T

    def nuisance(self, theta: Array, k: int) -> Array:
        """Columns (n, n_z) of piece k: offset, then the free response of every mode unless at rest."""
        piece = self.pieces[k]
        t = piece.h * np.arange(0, piece.y.size, self.stride)
        columns: list[Array] = [np.ones(t.size)]
        if self.rests(k):
            return np.column_stack(columns)
        for spec, part in zip(self.specs, self.slices, strict=True):
            for name, value, following in zip(
                spec.structure.names, theta[part], np.append(theta[part][1:], 0.0), strict=True
            ):
                if name.startswith("tau"):
                    columns.append(np.exp(-t / value))
                elif name.startswith("omega0"):
                    damping = np.exp(-min(following, 1.0) * value * t)
                    frequency = value * np.sqrt(max(1 - following**2, 0.0))
                    columns += [damping * np.cos(frequency * t), damping * np.sin(frequency * t)]
            if spec.structure.integrators:
                columns.append(np.asarray(t / max(piece.span, piece.h)))
        return np.column_stack(columns)

    def nuisance_gradient(self, theta: Array, k: int, weights: Array) -> Array:
        """Derivative (n, size) of `nuisance @ weights` by theta: only lags and pairs move the columns."""
        piece = self.pieces[k]
        out = np.zeros((len(range(0, piece.y.size, self.stride)), self.size))
        if self.rests(k):
            return out
        t = piece.h * np.arange(0, piece.y.size, self.stride)
        column = 1  # after the offset
        for spec, part in zip(self.specs, self.slices, strict=True):
            names = spec.structure.names
            for m, name in enumerate(names):
                index = part.start + m
                if name.startswith("tau"):
                    tau = theta[index]
                    out[:, index] = weights[column] * t / tau**2 * np.exp(-t / tau)
                    column += 1
                elif name.startswith("omega0"):
                    out[:, index : index + 2] = self._pair_gradient(theta, k, weights, index)
                    column += 2
            column += bool(spec.structure.integrators)
        return out

    def _pair_gradient(self, theta: Array, k: int, weights: Array, index: int) -> Array:
        """Derivative (n, 2) by the frequency and the damping of one pair, by differences."""
        base = self.nuisance(theta, k) @ weights
        columns = []
        for moved in (index, index + 1):
            step = 1e-6 * abs(theta[moved])
            shifted = theta.copy()
            shifted[moved] += step
            columns.append((self.nuisance(shifted, k) @ weights - base) / step)
        return np.column_stack(columns)
