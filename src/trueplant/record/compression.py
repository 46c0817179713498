"""The straight lines that a compressing historian drew between the samples it stored."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from trueplant.arrays import Array, BoolArray
from trueplant.record import levels
from trueplant.record.resolution import resolution
from trueplant.record.runs import spread, true_runs


def filled_in(t: Array, y: Array, step: float = 0.0, steered: BoolArray | None = None) -> float:
    """Share of the samples of y (N,) at t (N,), where it rises or falls, that lie on straight lines between corners.

    0 if chance may have done it. `step` is the quantisation of y. For the OP of a controller, `steered` (N - 1,) says
    from which sample to the next every PV moved: only there must the slope of OP change. While PV is held, an
    integrating controller draws straight lines itself, which do not count.
    """
    if y.size < levels.SLOPES:
        return 0.0
    rising, bent, corner, steepest = _shape(t, y, max(resolution(y), step))
    line = rising & ~bent
    begin, length = true_runs(line)
    ends = np.concatenate([[True], corner, [True]])
    sharp = ends[begin] & ends[begin + length + 1]
    begin, length = begin[sharp], length[sharp]
    slope = (y[begin + 1] - y[begin]) / (t[begin + 1] - t[begin])
    if begin.size == 0 or np.unique(np.round(slope / steepest, 4)).size < levels.SLOPES:
        return 0.0
    found, near = spread(begin, length, line.size), rising & bent & ~corner
    if steered is not None:
        near &= steered[1:] & steered[:-1]
        found, rising = found & _unexplained(line, steered), rising & (steered[1:] | steered[:-1])
    # so many bends would be below ON_LINE by chance if bends were spread evenly up to CORNER
    expected = np.sum(near) * levels.ON_LINE / (levels.CORNER - levels.ON_LINE)
    return float(np.sum(found) / np.sum(rising)) if np.sum(found) > levels.ABOVE_CHANCE * expected else 0.0


def drawn(t: Array, y: Array) -> BoolArray:
    """(N,) samples of y at t that rise or fall on a straight line between their neighbours; not where y is missing."""
    on_line = np.zeros(y.size, dtype=bool)
    known = y[np.isfinite(y)]
    if known.size >= levels.SLOPES:
        rising, bent, *_ = _shape(t, y, resolution(known))
        on_line[1:-1] = rising & ~bent
    return on_line


@np.errstate(over="ignore", invalid="ignore")  # stamps may be as near as numbers can be
def _shape(t: Array, y: Array, unit: float) -> tuple[BoolArray, BoolArray, BoolArray, float]:
    """At the inner samples (N - 2,) of y: does it rise or fall there, is it bent, and so much that it is a corner?

    And its steepest slope.
    """
    rising, bent, corner = np.empty((3, y.size - 2), dtype=bool)
    steepest = 0.0
    for first in range(0, y.size - 2, levels.BLOCK):
        own = slice(first, first + levels.BLOCK)
        seen = slice(first, first + levels.BLOCK + 2)
        steps, rises = np.diff(t[seen]), np.diff(y[seen])
        slope = rises / steps
        # on an even grid the second difference: twice the distance from the chord between the neighbours
        bend = np.abs(np.diff(slope)) * 2 * steps[1:] * steps[:-1] / (steps[1:] + steps[:-1])
        rising[own] = np.minimum(np.abs(rises[1:]), np.abs(rises[:-1])) > levels.FLAT * unit
        bent[own], corner[own] = bend > levels.ON_LINE * unit, bend > levels.CORNER * unit
        steepest = max(steepest, float(np.max(np.abs(slope))))
    return rising, bent, corner, steepest


def _unexplained(line: BoolArray, steered: BoolArray) -> BoolArray:
    """(N - 2,) inner samples at which the slope of OP should have changed.

    A move of PV changes the slope there or, where the controller answers one sample late, at the next. So a straight
    line is unexplained where PV moves at both steps, or where it moves between two samples that both lie on lines.
    """
    out = steered[1:] & steered[:-1]
    both = line[1:] & line[:-1] & steered[1:-1]
    out[1:] |= both
    out[:-1] |= both
    return out


def moves(outputs: Sequence[Array]) -> BoolArray:
    """(N - 1,) whether every PV (N,) moved from one sample to the next."""
    with np.errstate(invalid="ignore"):
        return np.asarray(np.logical_and.reduce([np.abs(np.diff(y)) > 0 for y in outputs]), dtype=bool)
