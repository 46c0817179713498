"""How much more data: moves that would settle what an analysis had to leave open."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class NotWorth(StrEnum):
    """Why a test would not be worth it."""

    TOO_LONG = "too-long"
    """It would take longer than a test may."""
    LIMITS_TOO_NEAR = "limits-too-near"
    """The limits leave no room for moves that show above the noise."""
    NO_LIMITS = "no-limits"
    """An OP that never moved would have to, and nothing says how far it may."""
    MATTERS_LITTLE = "matters-little"
    """What is open matters little to the loops."""


@dataclass(frozen=True)
class PlannedMove:
    """A set-point (OP in open loop) that goes so far to each side of where it is, every so long, and back."""

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
    matters: bool = True
    """To the loops: what does not is not waited for."""
    as_modelled: bool = False
    """Is it counted with times as the model has them, where the record does not tell those of the output's elements?
    Then `now` is not the half-width of the parameter's own interval, which rests on the times as estimated."""


@dataclass(frozen=True)
class MoreData:
    """One plan. Without moves none could be made, and the sentence says why."""

    sentence: str
    moves: tuple[PlannedMove, ...] = ()
    length: float | None = None
    suffices: bool | None = None
    """Would all that is open and matters be known well enough?"""
    limited_by: str = ""
    """The limit that keeps the moves small; empty where none does."""
    settles: tuple[Settled, ...] = ()
    first_of_two: bool = False
    """Is it a small test that makes the one possible which settles everything?"""
    assumed_limits: tuple[str, ...] = ()
    """PVs and OPs without declared limits: they are kept near what the record has shown."""
    not_worth: NotWorth | None = None
    """Why no test is worth it."""
    needs: float | None = None
    """How long a test would take that is too long; None where no length would do."""
    longest: float | None = None
    """How long a test may take."""
