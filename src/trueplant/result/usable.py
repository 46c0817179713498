"""Stretches of a long history that are worth an analysis."""

from __future__ import annotations

from dataclasses import dataclass, field

from trueplant.result.codec import ABSENT
from trueplant.result.data import Stamps


@dataclass(frozen=True)
class ExpectedGain:
    """How well one stretch alone would tell the gain (or slope) of an element."""

    output: str
    input: str
    parameter: str
    unit: str
    value: float
    """In the first estimate, on which this rests."""
    std_error: float | None
    """None where the stretch tells next to nothing of it."""


@dataclass(frozen=True)
class UsableStretch:
    """A stretch in which something moves from outside while the loops are in automatic. Times as in its record."""

    experiment: str
    start: float
    end: float
    """Of its last sample."""
    moved: tuple[str, ...]
    """Outputs whose set-points move (inputs in open loop)."""
    moves: int
    expected: tuple[ExpectedGain, ...]
    calendar: Stamps | None = field(default=None, metadata=ABSENT)
    """Both ends as time stamps, where the record has them."""
