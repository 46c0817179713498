"""A valve that does not go where its controller sends it: backlash and stick-slip."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trueplant.arrays import Array
from trueplant.compiled import compiled
from trueplant.errors import LoopError


@dataclass(frozen=True)
class Valve:
    """A valve with backlash and stick-slip, both in units of OP; 0 is none."""

    backlash: float = 0.0
    """Width of the play: how far OP goes back before the stem follows it."""
    stick: float = 0.0
    """How far OP goes from the stem before the stem jumps to it: the model with one parameter of Stenman, Gustafsson
    and Forsman (2003), Int. J. Adapt. Control Signal Process. 17."""

    def __post_init__(self) -> None:
        if not (0 <= self.backlash < np.inf and 0 <= self.stick < np.inf):
            raise LoopError("backlash and stick of a valve must be finite and not below 0")

    def positions(self, op: Array, start: float | None = None) -> Array:
        """Stem positions (N,) for OP (N,); the stem starts at `start`, or where OP does."""
        (at,) = positions_of([self], op, op[0] if start is None else start)
        return np.asarray(at)


def positions_of(valves: Sequence[Valve], op: Array, start: float) -> Array:
    """Stem positions (n_valves, N) of several valves for the same OP (N,): sooner than one after the other."""
    backlash = np.array([valve.backlash for valve in valves], dtype=float)
    stick = np.array([valve.stick for valve in valves], dtype=float)
    return np.asarray(_positions(np.ascontiguousarray(op, dtype=float), backlash, stick, float(start)))


@compiled(forceinline=True)
def stem(op: float, before: float, backlash: float, stick: float) -> float:
    """The stem's next position from OP and its position before."""
    half = 0.5 * backlash
    wanted = min(max(before, op - half), op + half)
    return wanted if abs(wanted - before) > stick else before


@compiled
def _positions(op: Array, backlash: Array, stick: Array, start: float) -> Array:
    """(n_valves, N): what all the valves do in one sample is done at a time."""
    out, at = np.empty((backlash.size, op.size)), np.full(backlash.size, start)
    for k in range(op.size):
        for i in range(at.size):
            at[i] = stem(op[k], at[i], backlash[i], stick[i])
        for i in range(at.size):
            out[i, k] = at[i]
    return out
