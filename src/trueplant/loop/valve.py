"""A valve that does not go where its controller sends it: backlash, stick-slip, and ends that OP goes beyond."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trueplant.arrays import Array
from trueplant.compiled import compiled
from trueplant.errors import LoopError


@dataclass(frozen=True)
class Valve:
    """A valve with backlash, stick-slip and ends, all in units of OP; backlash and stick of 0 are none."""

    backlash: float = 0.0
    """Width of the play: how far OP goes back before the stem follows it."""
    stick: float = 0.0
    """How far OP goes from the stem before the stem jumps to it: the model with one parameter of Stenman, Gustafsson
    and Forsman (2003), Int. J. Adapt. Control Signal Process. 17."""
    low: float = -np.inf
    """Where the stem ends, however low OP goes."""
    high: float = np.inf
    """However high it goes."""

    def __post_init__(self) -> None:
        if not (0 <= self.backlash < np.inf and 0 <= self.stick < np.inf):
            raise LoopError("backlash and stick of a valve must be finite and not below 0")
        if not self.low < self.high:
            raise LoopError("the lower end of a valve must lie below its upper one")

    def positions(self, op: Array, start: float | None = None) -> Array:
        """Stem positions (N,) for OP (N,); the stem starts at `start`, or where OP does, as far as its ends."""
        (at,) = positions_of([self], op, op[0] if start is None else start)
        return np.asarray(at)


def positions_of(valves: Sequence[Valve], op: Array, start: float, origin: float = 0.0) -> Array:
    """Stem positions (n_valves, N) of several valves for the same OP (N,): sooner than one after the other.

    OP, `start` and positions are deviations from `origin`, the ends of the valves are not.
    """
    parameters = parameters_of(valves) - np.array([0.0, 0.0, origin, origin])
    return np.asarray(_positions(np.ascontiguousarray(op, dtype=float), parameters, float(start)))


def parameters_of(valves: Sequence[Valve]) -> Array:
    """(n_valves, 4) backlash, stick, lower and upper end of each."""
    return np.array([(v.backlash, v.stick, v.low, v.high) for v in valves], dtype=float).reshape(len(valves), 4)


@compiled(forceinline=True)
def stem(op: float, before: float, backlash: float, stick: float, low: float, high: float) -> float:
    """The stem's next position from OP and its position before."""
    half = 0.5 * backlash
    wanted = min(max(min(max(before, op - half), op + half), low), high)
    return wanted if abs(wanted - before) > stick else before


@compiled
def _positions(op: Array, valves: Array, start: float) -> Array:
    """(n_valves, N): what all the valves do in one sample is done at a time."""
    backlash, stick, low, high = valves.T.copy()
    at = np.minimum(np.maximum(start, low), high)
    out = np.empty((at.size, op.size))
    for k in range(op.size):
        for i in range(at.size):
            at[i] = stem(op[k], at[i], backlash[i], stick[i], low[i], high[i])
        for i in range(at.size):
            out[i, k] = at[i]
    return out
