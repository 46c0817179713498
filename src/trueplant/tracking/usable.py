"""Where in a record something moves from outside: moves while the loops are in automatic, and stretches around them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from trueplant.arrays import Array, BoolArray, IntArray
from trueplant.record import Segment
from trueplant.study.study import Study
from trueplant.tracking import levels


@dataclass(frozen=True, eq=False)
class OutsideMoves:
    """What moves an experiment from outside, in order of time."""

    times: Array
    """(n,) samples at which something moves."""
    channel: IntArray
    """(n,) which output's set-point (which input's OP in open loop)."""
    begins: BoolArray
    """(n,) is it the first sample of a move? The others go on with a ramp."""
    lost: int
    """Moves that do not count: in manual or at a limit."""

    def within(self, start: float, end: float) -> tuple[tuple[int, ...], int]:
        """The channels that move from start to end, and how many moves they make."""
        inside = (self.times >= start) & (self.times <= end)
        return tuple(np.unique(self.channel[inside]).tolist()), int(np.sum(self.begins[inside]))


def outside_moves(study: Study, k: int, settle: float) -> OutsideMoves:
    """The moves of experiment k after which OP is free for most of a settling time.

    Set-points that are computed from PV do not move from outside.
    """
    alone = dict(zip(map(id, study.segments), study.computed_alone, strict=True))
    found = [np.zeros((0, 3))]
    lost = 0
    for segment in study.screened[k].segments:
        source, free = segment.u, np.ones((len(segment), segment.u.shape[1]), dtype=bool)
        if segment.closed:
            computed = study.computed | alone[id(segment)]
            source = np.where(computed, 0.0, segment.setpoints)
            free = _free(study, k, segment)
        kept = _followed(free, max(1, round(settle / segment.h)))
        for channel, x in enumerate(source.T):
            change = np.nan_to_num(np.sign(np.diff(x)))  # what it did while it was missing is no move
            at = np.flatnonzero(change) + 1
            begins = np.diff(change, prepend=0.0)[at - 1] != 0
            good = kept[at, channel]
            lost += int(np.sum(begins & ~good))
            found.append(np.column_stack([segment.t[at], np.full(at.size, channel), begins])[good])
    rows = np.concatenate(found)
    rows = rows[np.argsort(rows[:, 0], kind="stable")]
    return OutsideMoves(rows[:, 0], rows[:, 1].astype(int), rows[:, 2] > 0, lost)


def _free(study: Study, k: int, segment: Segment) -> BoolArray:
    """(N, n_y) is the OP free with which the loop of each output follows its set-point?

    That of its declared controllers; else the one beside it where there are as many; else all of them.
    """
    n_y, n_u = segment.y.shape[1], segment.u.shape[1]
    law = study.records.declared[k]
    columns = []
    for i in range(n_y):
        own = [] if law is None else [j for j, output in law.entries if output == i]
        columns.append(segment.free[:, own or ([i] if n_y == n_u else range(n_u))].all(axis=1))
    return np.column_stack(columns)


def _followed(free: BoolArray, samples: int) -> BoolArray:
    """(N, m) is it True for most of so many samples from each one on?"""
    total = np.vstack([np.zeros((1, free.shape[1]), dtype=int), np.cumsum(free, axis=0)])
    first = np.arange(len(free))
    end = np.minimum(first + samples, len(free))
    return np.asarray(total[end] - total[first] >= levels.AUTOMATIC * (end - first)[:, None])


def stretches(segments: Sequence[Segment], times: Array, settle: float) -> list[tuple[float, float]]:
    """From a settling time before to one after moves that follow each other; long ones divided into equal parts."""
    if not times.size:
        return []
    first, last = float(segments[0].t[0]), float(segments[-1].t[-1])
    ends = np.flatnonzero(np.diff(times) > levels.JOINED * settle)
    begin, end = times[np.r_[0, ends + 1]], times[np.r_[ends, times.size - 1]]
    found: list[tuple[float, float]] = []
    for a, b in zip(np.maximum(begin - settle, first), np.minimum(end + settle, last), strict=True):
        parts = int(np.ceil((b - a) / (levels.LONGEST_FOUND * settle)))
        edges = np.linspace(a, b, max(parts, 1) + 1)
        found += list(zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True))
    return found


def moves_by_experiment(study: Study, settle: float) -> Mapping[int, OutsideMoves]:
    """Of the experiments that can be used."""
    usable = [k for k, s in enumerate(study.screened) if s.refusal is None and s.segments]
    return {k: outside_moves(study, k, settle) for k in usable}
