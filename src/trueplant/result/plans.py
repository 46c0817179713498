"""How much more data: moves that would settle what an analysis had to leave open."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class PlannedMove:
    """A set-point (OP in open loop) that goes so far to each side of where it is, every so long."""

    signal: str
    """"set-point" or "OP"."""
    name: str
    size: float
    unit: str
    every: float
    """Time from one move to the next."""


@dataclass(frozen=True)
class Settled:
    """A parameter that is open now: half-widths of its interval."""

    output: str
    input: str
    parameter: str
    unit: str
    now: float | None
    """None where hardly anything is known."""
    wanted: float
    then: float
    """After the moves."""


@dataclass(frozen=True)
class MoreData:
    """One plan. Without moves none could be made, and the sentence says why."""

    sentence: str
    moves: tuple[PlannedMove, ...] = ()
    length: float | None = None
    suffices: bool | None = None
    """Would all that is open be known well enough?"""
    limited_by: str = ""
    """The limit that keeps the moves small; empty where none does."""
    settles: tuple[Settled, ...] = ()
