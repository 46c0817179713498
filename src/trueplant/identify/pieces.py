"""Segments as one output sees them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trueplant.arrays import Array, BoolArray
from trueplant.identify import levels
from trueplant.lti.sampled import sampled_response
from trueplant.lti.transfer import TransferFunction
from trueplant.record.types import Load, Segment


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
    """Steps that nobody recorded, of its whole experiment."""
    sent: Array | None = None
    """(n_columns, N) the inputs as they were sent, where `inputs` is where valves went that did not follow them; as
    deviations from the first of `inputs`."""
    spikes: Array | None = None
    """(N,) what was taken off y where PV left its course for a moment, 0 at all other samples."""
    origin: Array | None = None
    """(n_columns,) what the inputs are deviations from; None is 0."""

    @property
    def stepping(self) -> tuple[Load, ...]:
        """The loads that step within it: what others do is in its operating point and initial state."""
        last = self.start + self.span
        return tuple(load for load in self.loads if self.start + self.h / 2 < load.time < last + self.h / 2)

    @property
    def recorded(self) -> Array:
        """(n_columns, N) the inputs as they were sent."""
        return self.inputs if self.sent is None else self.sent

    @property
    def about(self) -> Array:
        """(n_columns,) what the inputs are deviations from."""
        return np.zeros(len(self.inputs)) if self.origin is None else self.origin

    @property
    def span(self) -> float:
        return self.h * (self.y.size - 1)

    @property
    def times(self) -> Array:
        """(N,) of its samples."""
        return np.asarray(self.start + self.h * np.arange(self.y.size))

    @cached_property
    def about_its_mean(self) -> Array:
        """(N,) y without its mean, 0 where it was not measured.

        A noise model near a walk cancels levels, and a level that no longer shows in the prediction errors is not
        estimated: PV at 50 would then hold the noise model there.
        """
        return np.where(self.valid, self.y - self.y[self.valid].mean(), 0.0) if self.valid.any() else self.y

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
        at = self.inputs[:, first : first + 1]
        inputs = np.ascontiguousarray(self.inputs[:, part] - at)
        sent = None if self.sent is None else np.ascontiguousarray(self.sent[:, part] - at)
        spikes = None if self.spikes is None else self.spikes[part]
        last = self.y.size if end is None else end
        y, valid, start = self.y[part], self.valid[part], self.start + first * self.h
        restarts, jumps = (tuple(k - first for k in of if first < k < last) for of in (self.restarts, self.jumps))
        origin = self.about + at[:, 0]
        cut = replace(self, y=y, valid=valid, inputs=inputs, sent=sent, start=start, spikes=spikes, origin=origin)
        return replace(cut, restarts=restarts, jumps=jumps)

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
        sent = None if whole.sent is None else np.column_stack([whole.sent, whole.d]) - inputs[0]
        origin, inputs = inputs[0], np.ascontiguousarray((inputs - inputs[0]).T)
        hold = whole.holds
        y = np.where(valid, whole.y[:, output], 0.0)
        for element in held:
            y = y - sampled_response(element.system, inputs[element.column], whole.h, hold[element.column])
        jumps = whole.jumps[output] if whole.jumps else ()
        y = np.where(valid, y, 0.0)
        piece = Piece(whole.experiment, whole.h, y, valid, inputs, hold, restarts, whole.t[0], jumps, whole.loads)
        piece = replace(piece, origin=origin)
        piece = piece if sent is None else replace(piece, sent=np.ascontiguousarray(sent.T))
        piece = piece if whole.spikes is None else replace(piece, spikes=whole.spikes[:, output])
        pieces.append(piece.from_sample(_first_update(whole.y[:, output], update)))
    return tuple(pieces)


def _groups(segments: Sequence[Segment]) -> list[list[Segment]]:
    """Segments that can be joined: same experiment, gaps of whole samples and no longer than what they separate."""
    groups: list[list[Segment]] = []
    for segment in segments:
        before = groups[-1][-1] if groups else None
        if before is not None and before.experiment == segment.experiment and len(groups[-1]) < levels.MOST_JOINED:
            missing = (segment.t[0] - before.t[-1]) / before.h
            if 0.5 < missing < max(len(segment), len(before)) and abs(missing - round(missing)) < levels.OFF_GRID:
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

    def laid(name: str, missing: float | None = None) -> NDArray[Any]:
        values = np.concatenate([getattr(segment, name) for segment in group])[last]
        return values if missing is None else np.where(there[:, None], values, missing)

    whole = replace(
        first,
        t=first.t[0] + first.h * np.arange(size),
        r=laid("r"),
        settled=None,
        u=laid("u"),
        y=laid("y", np.nan),
        d=laid("d"),
        free=laid("free"),
        sent=None if first.sent is None else laid("sent"),
        spikes=None if all(segment.spikes is None for segment in group) else laid("taken_off", 0.0),
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
