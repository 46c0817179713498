"""Damped least squares with bounds (Levenberg 1944, Marquardt 1963): the one descent that all fits make.

How far the damping falls after a step depends on how well the step was foretold (Nielsen 1999): along a curved valley
it stays where steps succeed.

A problem says what a step leads to; the descent chooses the steps. Costs may be any sum of squares or -2 log
likelihood: `unit` tells how large a change of the cost is worth one of -2 log likelihood.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

import numpy as np

from trueplant.arrays import Array, BoolArray
from trueplant.identify import levels


class Point(Protocol):
    """Where a descent stands. Derivatives may be worked out when they are asked for: trial points need none."""

    @property
    def cost(self) -> float: ...

    @property
    def information(self) -> Array:
        """(n, n) half of the second derivative of the cost, by Gauss and Newton."""
        ...

    @property
    def slope(self) -> Array:
        """(n,) half of the gradient of the cost."""
        ...

    @property
    def unit(self) -> float:
        """The change of the cost that is worth one of -2 log likelihood."""
        ...


P = TypeVar("P", bound=Point)


@dataclass(frozen=True, eq=False)
class Problem(Generic[P]):
    """What is minimised over x (n,), and within which limits."""

    at: Callable[[Array, P], P]
    """The point at x, reached from another one, whose weights it takes."""
    low: Array
    high: Array
    """(n,) bounds. Parameters with a positive lower bound grow or shrink by no more than LARGEST_RATIO in a step."""
    free: BoolArray
    """(n,) parameters that may move."""
    kinked: BoolArray
    """(n,) parameters by which the cost can have a kink, downhill on neither side: then all others move on."""
    least: float = -np.inf
    """A cost that is nothing but rounding: there the descent ends."""
    settled: float = levels.SETTLED
    """Gain in -2 log likelihood, done and expected, at which the descent ends."""
    reweighted: Callable[[Array, P, int], P | None] = lambda _x, _point, _step: None
    """After each step, counted from 0: the point under new weights, or None where they stay."""


@dataclass(frozen=True, eq=False)
class Descent(Generic[P]):
    """Where a descent ended."""

    x: Array
    point: P
    converged: bool


@dataclass(frozen=True, eq=False)
class _Step(Generic[P]):
    x: Array
    point: P
    expected: float
    """By how much the cost would fall without damping, were it quadratic."""
    damping: float
    """Of the next step."""


def descend(problem: Problem[P], x: Array, point: P, iterations: int) -> Descent[P]:
    """From x, where the cost is that of `point`, downhill until no step gains what would matter."""
    damping = levels.FIRST_DAMPING
    for done in range(iterations):
        pinned = ((x <= problem.low) & (point.slope > 0)) | ((x >= problem.high) & (point.slope < 0))
        active = problem.free & ~pinned & (np.diag(point.information) > 0)
        step = _downhill(problem, x, point, active, damping)
        if step is None and np.any(active & problem.kinked):
            step = _downhill(problem, x, point, active & ~problem.kinked, damping)
        if step is None:
            return Descent(x, point, True)
        gain = point.cost - step.point.cost
        settled = max(gain, step.expected) <= problem.settled * point.unit
        x, point, damping = step.x, step.point, step.damping
        again = problem.reweighted(x, point, done)
        if again is not None:
            point, settled = again, False
        if settled or point.cost <= problem.least:
            return Descent(x, point, True)
    return Descent(x, point, False)


@np.errstate(over="ignore", invalid="ignore")  # of a start far off nothing may be finite: then no step is found
def _downhill(problem: Problem[P], x: Array, point: P, active: BoolArray, damping: float) -> _Step[P] | None:
    """A damped Gauss-Newton step of the active parameters that does not raise the cost; None if there is none."""
    if not active.any():
        return None
    scale = np.sqrt(np.maximum(np.diag(point.information)[active], 1e-300))
    normal = point.information[np.ix_(active, active)] / np.outer(scale, scale)
    growth = 8.0
    for _ in range(levels.MOST_DAMPINGS):
        step = np.zeros(active.size)
        step[active] = -np.linalg.solve(normal + damping * np.eye(scale.size), point.slope[active] / scale) / scale
        expected = float(-step @ point.slope)
        if expected <= levels.NEGLIGIBLE * point.unit:
            return None
        trial = np.clip(_limited(x, step, problem.low), problem.low, problem.high)
        candidate = problem.at(trial, point)
        if np.isfinite(candidate.cost) and candidate.cost < point.cost + levels.ROUNDING * abs(point.cost):
            moved, gain = trial - x, point.cost - candidate.cost
            foretold = float(-(2 * point.slope + point.information @ moved) @ moved)
            return _Step(trial, candidate, expected, _next_damping(damping, gain / foretold if foretold > 0 else 0.0))
        damping, growth = min(damping * growth, levels.LARGEST_DAMPING), growth * 4
    return None


def _next_damping(damping: float, share: float) -> float:
    """The damping after a step that gained this share of what was foretold: a third of it, up to twice as much."""
    return max(damping * max(1 / 3, 1 - (2 * share - 1) ** 3), levels.LEAST_DAMPING)


def _limited(x: Array, step: Array, low: Array) -> Array:
    """A step that takes positive parameters at most to a third or to three times their value."""
    positive = np.isfinite(low) & (low > 0)
    trial = x + step
    trial[positive] = np.clip(trial[positive], x[positive] / levels.LARGEST_RATIO, x[positive] * levels.LARGEST_RATIO)
    return trial
