"""Peaks over frequency of functions that are bounded from both sides."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from trueplant.arrays import Array, ComplexArray
from trueplant.loop import Controller
from trueplant.lti import TransferMatrix
from trueplant.robust import levels
from trueplant.robust.grid import Rates, follow, on_axis

Bounds = Callable[[ComplexArray], tuple[Array, Array]]


@dataclass(frozen=True)
class Peak:
    """The largest value over frequency, bounded from both sides."""

    lower: float
    upper: float
    frequency: float
    """rad per time unit; 0 for the limit omega -> 0, nan where the loop is unstable."""

    def __repr__(self) -> str:
        return f"{self.upper:.4g} at {self.frequency:.4g} (at least {self.lower:.4g})"


def loop_grid(plant: TransferMatrix, controller: Controller, rates: Rates) -> Array:
    """Frequencies that follow det(I + G Q): where it turns, so do the closed-loop functions."""

    def determinant(w: Array) -> ComplexArray:
        s = on_axis(w, plant)
        return np.asarray(np.linalg.det(np.eye(plant.shape[0]) + plant(s) @ controller(s)) - 1, dtype=np.complex128)

    return follow(
        determinant, rates.grid(levels.MU_PER_DECADE), rates.dead_time, levels.MU_TURN, levels.MU_FLOOR, levels.MU_MOST
    )[0]


def sharpened(
    bounds: Bounds,
    system: Callable[[Array], ComplexArray],
    w: Array,
    lower: Array,
    upper: Array,
    rivals: int = levels.MU_RIVALS,
) -> Peak:
    """The peak of the upper bound between the points of the grid."""
    top = int(np.argmax(upper))
    # a curve that is flat down to frequency 0 peaks there, whichever of its points the last digit prefers
    alike = (upper >= upper[top] * (1 - levels.PEAK_VALUE)) & (lower >= lower[top] * (1 - levels.PEAK_VALUE))
    k = int(np.argmax(alike)) if alike[: top + 1].all() else top
    best = Peak(float(lower[k]), float(upper[top]), float(w[k]) if k else 0.0)
    inner = np.flatnonzero((upper[1:-1] >= upper[:-2]) & (upper[1:-1] >= upper[2:])) + 1
    tops = inner[np.argsort(upper[inner])[::-1][:rivals]]
    # a peak that is low on the grid may still be the highest between its points, one that is far below is not
    tops = tops[upper[tops] > levels.RIVAL_SHARE * best.upper]
    low, high = w[tops - 1], w[tops + 1]
    spread = 1.0
    while tops.size and spread > levels.PEAK_VALUE and np.max(high / low) > 1 + 1e-9:
        points = low[:, None] * (high / low)[:, None] ** np.linspace(0, 1, 9)
        below, above = (b.reshape(points.shape) for b in bounds(system(points.ravel())))
        at = np.clip(np.argmax(above, axis=1), 1, 7)
        rows = np.arange(len(tops))
        highest = np.unravel_index(np.argmax(above), above.shape)
        if above[highest] > best.upper * (1 + (1e-9 if best.frequency else levels.PEAK_VALUE)):
            best = Peak(float(below[highest]), float(above[highest]), float(points[highest]))
        low, high = points[rows, at - 1], points[rows, at + 1]
        ends = np.minimum(above[rows, at - 1], above[rows, at + 1])
        spread = float(np.max(1 - ends / above[rows, at]))
    return best
