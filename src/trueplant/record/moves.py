"""How set-points are moved: how often, how far, and against what noise of PV."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trueplant.arrays import Array, IntArray
from trueplant.record import levels
from trueplant.record.resolution import without_rounding
from trueplant.record.runs import true_runs
from trueplant.record.sensor import quantum, update_every
from trueplant.record.types import Record


@dataclass(frozen=True, eq=False)
class Moves:
    """What moves one signal from one level to another."""

    times: Array
    """(n,) of the first sample of each."""
    sizes: Array
    """(n,) from the level before to that after it."""
    share: float
    """Of the samples at which the signal changes."""

    @property
    def always(self) -> bool:
        """Does the signal change most of the time, so that there are no levels to move between?"""
        return self.share > levels.ALWAYS_MOVING


def moves_of(t: Array, x: Array) -> Moves:
    """The moves of a settled signal x (N,), NaN where it is not known; a ramp in one direction is one move."""
    known = np.flatnonzero(np.isfinite(x))
    if known.size < 2:
        return Moves(np.zeros(0), np.zeros(0), 0.0)
    change = np.diff(x[known])
    first, last = _one_way(np.sign(change))
    return Moves(t[known[first + 1]], x[known[last + 1]] - x[known[first]], float(np.mean(change != 0)))


def _one_way(direction: Array) -> tuple[IntArray, IntArray]:
    """First and last place of each run of changes in one direction."""
    ends = []
    for way in (1, -1):
        begin, length = true_runs(direction == way)
        ends.append(np.stack([begin, begin + length - 1]))
    first, last = np.hstack(ends)
    order = np.argsort(first)
    return first[order], last[order]


def setpoint_moves(record: Record) -> tuple[Moves | None, ...]:
    """Of each output; None where no set-point was recorded."""
    setpoints = without_rounding(record).setpoints
    return tuple(moves_of(record.t, x) if np.isfinite(x).any() else None for x in setpoints.T)


def pv_noise(y: Array) -> float:
    """Standard deviation of what PV y (N,) does from one sample to the next by itself, at least that of its rounding.

    From the median absolute second difference (that of white noise has 6 times its variance), between real updates.
    """
    v = y[np.isfinite(y)]
    d = np.abs(np.diff(v[:: max(1, round(update_every(v)))], 2))
    seen = levels.NORMAL_MAD * float(np.median(d)) / np.sqrt(6) if d.size else 0.0
    return float(max(seen, quantum(v) / np.sqrt(12)))
