"""The output of one row of the plant, simulated on recorded inputs, with its derivatives.

Signals enter as deviations from their first sample. What happened before the record is summed up by
nuisance terms that are linear: an offset for each segment and, unless the record starts at rest, the
free response of every lag.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trueplant.arrays import Array, BoolArray
from trueplant.identify import levels
from trueplant.identify.initial_state import Load, Modes, Past, Unknown, unknown_of
from trueplant.identify.prior import Prior
from trueplant.lti.sampled import sampled_response
from trueplant.lti.structure import Structure
from trueplant.lti.transfer import TransferFunction
from trueplant.record.types import Segment


@dataclass(frozen=True)
class Spec:
    """One element of the row: which input drives it, and its structure or its fixed transfer function."""

    column: int
    """Index into the inputs followed by the measured disturbances."""
    structure: Structure
    initial: tuple[float, ...] | None = None
    """The model's parameters, near which the plant is taken to be (`prior`) and with which the estimate is compared;
    None where the model has no such element."""
    undeclared: tuple[int, ...] = ()
    """Places of parameters in `initial` which the model does not have: the search starts there, and no more."""
    guess: tuple[float, ...] | None = None
    """Initial guess of the parameters; None for the model's."""


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
    """(N,) minus the response of the fixed elements; 0 where not valid."""
    valid: BoolArray
    inputs: Array
    """(n_columns, N)."""
    hold: tuple[str, ...]
    restarts: tuple[int, ...] = ()
    """Samples at which a gap in the inputs ends: what they did in it, and so the state, is not known."""
    start: float = 0.0
    """Time of the first sample."""
    jumps: tuple[int, ...] = ()
    """Samples from which on a disturbance holds the output at another level."""
    loads: tuple[Load, ...] = ()
    """Loads that were found (`loads`)."""

    @property
    def span(self) -> float:
        return self.h * (self.y.size - 1)

    @cached_property
    def spread(self) -> float:
        """Standard deviation of y where it was measured."""
        return float(np.std(self.y[self.valid])) if self.valid.any() else 0.0

    @cached_property
    def input_spread(self) -> Array:
        """(n_columns,) standard deviation of each input."""
        return np.asarray(np.std(self.inputs, axis=1))

    def from_sample(self, first: int, end: int | None = None) -> Piece:
        """The piece from one sample on (to another)."""
        if first == 0 and end is None:
            return self
        part = slice(first, end)
        inputs = self.inputs[:, part]
        inputs = np.ascontiguousarray(inputs - inputs[:, :1])
        last = self.y.size if end is None else end
        y, valid, start = self.y[part], self.valid[part], self.start + first * self.h
        restarts, jumps = (tuple(k - first for k in of if first < k < last) for of in (self.restarts, self.jumps))
        loads = tuple(load for own in self.loads if (load := own.within(first, last)) is not None)
        return replace(
            self, y=y, valid=valid, inputs=inputs, restarts=restarts, start=start, jumps=jumps, loads=loads
        )

    @cached_property
    def starts_at_rest(self) -> bool:
        """True if no input moves during the first samples and the output does not drift meanwhile."""
        moved = np.flatnonzero(np.any(self.inputs != 0, axis=0))
        lead = int(moved[0]) if moved.size else self.y.size
        y = self.y[:lead][self.valid[:lead]]
        if lead < levels.QUIET_SAMPLES or y.size < levels.QUIET_SAMPLES:
            return False
        early, late = np.array_split(y, 2)
        spread = np.median(np.abs(np.diff(y))) + np.std(late)
        return bool(abs(np.median(late) - np.median(early)) <= spread + 1e-9 * np.ptp(self.y))


def pieces_of(
    segments: Sequence[Segment], output: int, held: Sequence[Held] = (), update: int = 1
) -> tuple[Piece, ...]:
    """The segments in which this output was measured at all.

    Segments of one experiment on one grid become one piece, so that they share an operating point. `update` is the
    number of samples for which a historian or instrument holds each PV; pieces then begin with a fresh one, so that
    every `update`-th sample is fresh.
    """
    measured = [segment for segment in segments if np.isfinite(segment.y[:, output]).sum() >= 2]
    pieces = []
    for group in _groups(measured):
        whole, restarts = _joined(group)
        valid = np.isfinite(whole.y[:, output])
        inputs = np.column_stack([whole.u, whole.d])
        inputs = np.ascontiguousarray((inputs - inputs[0]).T)
        hold = whole.holds
        y = np.where(valid, whole.y[:, output], 0.0)
        for element in held:
            y = y - sampled_response(element.system, inputs[element.column], whole.h, hold[element.column])
        jumps = whole.jumps[output] if whole.jumps else ()
        y = np.where(valid, y, 0.0)
        piece = Piece(whole.experiment, whole.h, y, valid, inputs, hold, restarts, whole.t[0], jumps)
        pieces.append(piece.from_sample(_first_update(whole.y[:, output], update)))
    return tuple(pieces)


def _groups(segments: Sequence[Segment]) -> list[list[Segment]]:
    """Segments that can be joined: same experiment, gaps of whole samples and no longer than what they separate."""
    groups: list[list[Segment]] = []
    for segment in segments:
        before = groups[-1][-1] if groups else None
        if before is not None and before.experiment == segment.experiment and len(groups[-1]) < levels.MOST_JOINED:
            missing = (segment.t[0] - before.t[-1]) / before.h
            if 0.5 < missing < max(len(segment), len(before)) and abs(missing - round(missing)) < 0.05:
                groups[-1].append(segment)
                continue
        groups.append([segment])
    return groups


def _joined(group: Sequence[Segment]) -> tuple[Segment, tuple[int, ...]]:
    """One segment, inputs held and outputs missing in its gaps, and the samples at which the gaps end."""
    first = group[0]
    if len(group) == 1:
        return first, ()
    starts = [round((segment.t[0] - first.t[0]) / first.h) for segment in group]
    size = starts[-1] + len(group[-1])
    index = np.full(size, -1)
    for k, (start, segment) in enumerate(zip(starts, group, strict=True)):
        index[start : start + len(segment)] = np.arange(len(segment)) + sum(len(s) for s in group[:k])
    last = np.maximum.accumulate(index)
    there = index >= 0

    def laid(name: str, missing: bool = False) -> NDArray[Any]:
        values = np.concatenate([getattr(segment, name) for segment in group])[last]
        return np.where(there[:, None], values, np.nan) if missing else values

    whole = replace(
        first,
        t=first.t[0] + first.h * np.arange(size),
        r=laid("r"),
        u=laid("u"),
        y=laid("y", missing=True),
        d=laid("d"),
        free=laid("free"),
        jumps=tuple(
            tuple(
                k + start
                for start, segment in zip(starts, group, strict=True)
                if segment.jumps
                for k in segment.jumps[i]
            )
            for i in range(first.y.shape[1])
        ),
    )
    return whole, tuple(starts[1:])


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

    @cached_property
    def slices(self) -> tuple[slice, ...]:
        ends = np.cumsum([len(s.structure.names) for s in self.specs])
        return tuple(slice(int(e) - len(s.structure.names), int(e)) for s, e in zip(self.specs, ends, strict=True))

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Of all parameters, in the order of theta."""
        return tuple(name for spec in self.specs for name in spec.structure.names)

    @property
    def size(self) -> int:
        return len(self.names)

    @cached_property
    def is_gain(self) -> BoolArray:
        """(size,) masks over theta: gains and slopes."""
        return self._joined(spec.structure.is_gain for spec in self.specs)

    @cached_property
    def is_lag(self) -> BoolArray:
        """(size,) time constants of real poles."""
        return self._joined(spec.structure.is_lag for spec in self.specs)

    @cached_property
    def is_frequency(self) -> BoolArray:
        """(size,) natural frequencies of complex pairs."""
        return self._joined(spec.structure.is_frequency for spec in self.specs)

    @cached_property
    def is_lead(self) -> BoolArray:
        """(size,) time constants of zeros."""
        return self._joined(spec.structure.is_lead for spec in self.specs)

    @cached_property
    def is_dead_time(self) -> BoolArray:
        """(size,)"""
        return self._joined(spec.structure.is_dead_time for spec in self.specs)

    @staticmethod
    def _joined(masks: Iterable[BoolArray]) -> BoolArray:
        joined = np.concatenate([np.zeros(0, dtype=bool), *masks])
        joined.flags.writeable = False
        return joined

    def lag_of_dead_times(self, theta: Array) -> Array:
        """(size,) for each dead time the lag of its element, against which an error in it shows; 0 for the rest."""
        lags = np.zeros(self.size)
        for spec, part in zip(self.specs, self.slices, strict=True):
            lags[part] = np.where(spec.structure.is_dead_time, spec.structure.lag(theta[part]), 0.0)
        return lags

    def bounds(self) -> tuple[Array, Array]:
        """Bounds of theta; lags far shorter than a sample are not identifiable and end at a twentieth of one."""
        pairs = [(np.zeros(0), np.zeros(0)), *(s.structure.bounds() for s in self.specs)]
        low, high = np.concatenate([low for low, _ in pairs]), np.concatenate([high for _, high in pairs])
        h = self.pieces[0].h
        low[self.is_lag] = levels.FASTEST_LAG * h
        high[self.is_frequency] = 1 / (levels.FASTEST_LAG * h)
        return low, high

    @cached_property
    def prior(self) -> Prior:
        """Of theta, about the model."""
        initial = (None if s.initial is None else np.array(s.initial, dtype=float) for s in self.specs)
        return Prior.joined(
            [Prior.about(s.structure, model, s.undeclared) for s, model in zip(self.specs, initial, strict=True)]
        )

    def measured(self, k: int) -> tuple[Array, BoolArray]:
        piece = self.pieces[k]
        return piece.y[:: self.stride], piece.valid[:: self.stride]

    def without_unseen(self, theta: Array) -> Row:
        """The row without the outputs that still answer to inputs from before a record that starts in motion.

        What OP did in the last dead time before the record is not in it, and no free response makes up for it.
        """
        dead = float(np.max(theta[self.is_dead_time], initial=0.0))
        pieces = []
        for piece in self.pieces:
            unseen = int(np.ceil(dead / piece.h)) + 1  # the dead time may turn out a little longer
            valid = piece.valid.copy()
            if not piece.starts_at_rest:
                valid[: min(unseen, piece.y.size // 5)] = False
            for start in piece.restarts:
                valid[start : start + min(unseen, piece.y.size // 5)] = False
            pieces.append(replace(piece, valid=valid, y=np.where(valid, piece.y, 0.0)))
        return replace(self, pieces=tuple(pieces))

    def response(self, theta: Array, k: int) -> Array:
        """Simulated output of piece k at the strided samples, from rest."""
        piece = self.pieces[k]
        total = np.zeros(-(-piece.y.size // self.stride))
        for spec, part in zip(self.specs, self.slices, strict=True):
            u, hold = piece.inputs[spec.column], piece.hold[spec.column]
            total += spec.structure.response(theta[part], u, piece.h, hold, self.stride)
        return total

    def response_and_gradient(self, theta: Array, k: int) -> tuple[Array, Array]:
        """Simulated output (n,) of piece k and its derivative by theta (n, size)."""
        piece = self.pieces[k]
        n = len(range(0, piece.y.size, self.stride))
        total, gradient = np.zeros(n), np.zeros((self.size, n))
        for spec, part in zip(self.specs, self.slices, strict=True):
            u, hold = piece.inputs[spec.column], piece.hold[spec.column]
            rows = spec.structure.response_and_gradient(theta[part], u, piece.h, hold, self.stride)
            total += rows[0]
            gradient[part] = rows[1:]
        return total, gradient.T

    def unknown(self, theta: Array, k: int) -> Unknown:
        """What is linear and not known of piece k: offset, free responses of all modes of an unknown past, jumps, loads."""
        piece, found = self.pieces[k], unknown_of(theta, self._modes, self._pasts[k])
        for load in piece.loads:
            spec, part = next((s, p) for s, p in zip(self.specs, self.slices, strict=True) if s.column == load.column)
            course, hold = load.course(piece.y.size), piece.hold[load.column]
            rows = spec.structure.response_and_gradient(theta[part], course, piece.h, hold, self.stride)
            largest = levels.LARGEST_FREE_RESPONSE * float(piece.input_spread[load.column])
            found = found.including(rows[0], rows[1:], np.arange(part.start, part.stop), largest)
        return found

    def nuisance(self, theta: Array, k: int) -> Array:
        """Columns (n, n_z) of `unknown`."""
        return self.unknown(theta, k).columns

    @cached_property
    def nuisance_count(self) -> int:
        """Offsets, free responses, jumps and loads over all pieces, which are estimated along."""
        loads = sum(len(piece.loads) for piece in self.pieces)
        return loads + sum(1 + past.starts.size * self._modes.free_responses + past.jumps.size for past in self._pasts)

    @cached_property
    def _modes(self) -> Modes:
        structures = [spec.structure for spec in self.specs]
        return Modes(
            np.flatnonzero(self.is_lag),
            np.flatnonzero(self.is_frequency),
            np.flatnonzero(self.is_gain),
            np.repeat(np.arange(len(structures)), np.array([len(s.names) for s in structures], dtype=int)),
            np.flatnonzero([s.integrators > 0 for s in structures]),
        )

    @cached_property
    def _pasts(self) -> tuple[Past, ...]:
        """Of each piece."""
        columns = [spec.column for spec in self.specs]
        return tuple(
            Past(
                np.array([*([] if self.rests(k) else [0]), *piece.restarts], dtype=np.int64),
                np.array(piece.jumps, dtype=np.int64),
                piece.y.size,
                self.stride,
                piece.h,
                piece.spread,
                piece.input_spread[columns],
            )
            for k, piece in enumerate(self.pieces)
        )


def differenced(row: Row, over: int = 1) -> Row:
    """The row with what outputs and inputs change by over so many of its samples.

    The same elements lead from one to the other; a level, and noise that is integrated, is gone.
    """
    return replace(row, pieces=tuple(_differenced(piece, over * row.stride) for piece in row.pieces))


def _differenced(piece: Piece, span: int) -> Piece:
    valid = np.zeros(piece.valid.size, dtype=bool)
    valid[span:] = piece.valid[span:] & piece.valid[:-span]
    y, inputs = np.zeros_like(piece.y), np.zeros_like(piece.inputs)
    y[span:] = np.where(valid[span:], piece.y[span:] - piece.y[:-span], 0.0)
    inputs[:, span:] = piece.inputs[:, span:] - piece.inputs[:, :-span]
    loads = tuple(load._replace(end=load.sample + span) for load in piece.loads)
    return replace(piece, y=y, valid=valid, inputs=inputs, loads=loads)


def placed(values: Array, of: Row, row: Row) -> Array:
    """(m, row.size) values (m, of.size) of the parameters of one row in another; 0 for what only that one has."""
    known = {(spec.column, name): k for k, (spec, name) in enumerate(_named(of))}
    places = [known.get((spec.column, name)) for spec, name in _named(row)]
    return np.column_stack([np.zeros(len(values)) if k is None else values[:, k] for k in places])


def _named(row: Row) -> list[tuple[Spec, str]]:
    return [(spec, name) for spec in row.specs for name in spec.structure.names]
