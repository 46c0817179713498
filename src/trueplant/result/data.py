"""What was read, what of it is used, and what screening found."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from trueplant.calendar import Calendar
from trueplant.result.codec import ABSENT, key
from trueplant.result.element import Interval

Stamps = tuple[str, str]
"""Time stamps of both ends of a stretch, with their offset from UTC where the record's zone is known."""


@dataclass(frozen=True)
class Exclusion:
    """A stretch of one signal that is left out. Times in the record's own time."""

    start: float = field(metadata=key("from"))
    end: float = field(metadata=key("to"))
    signal: str
    reason: str
    """The kind of the finding."""
    calendar: Stamps | None = field(default=None, metadata=ABSENT)
    """As this stretch and others below: where the record has time stamps."""


@dataclass(frozen=True)
class DataFinding:
    """One thing that reading or screening noticed."""

    kind: str
    signal: str
    message: str
    samples: int
    excludes: bool
    """Were samples left out because of it?"""
    value: float | None
    """The measured size where there is one."""
    spans: tuple[Interval, ...]
    """The first of them."""
    calendar: tuple[Stamps, ...] = field(default=(), metadata=ABSENT)


@dataclass(frozen=True)
class SignalExcitation:
    """How one set-point (OP in open loop) moves."""

    signal: str
    changes: int
    std: float
    band: Interval | None
    """rad per time unit."""


@dataclass(frozen=True)
class Excitation:
    """How much the moves of a record tell."""

    of: str
    """"set-points" or "inputs"."""
    rank: int
    """Directions that move apart."""
    signals: tuple[SignalExcitation, ...]
    worst_condition: float | None
    sentences: tuple[str, ...]
    """What is not enough."""


@dataclass(frozen=True)
class SetpointMoves:
    """How one set-point moves over a whole record."""

    signal: str
    """Its output."""
    unit: str
    moves: int
    """Ramps in one direction count once."""
    smallest: float | None
    median: float | None
    largest: float | None
    """Sizes of the moves, without their sign."""
    interval: float | None
    """Median time from one move to the next, in time units."""
    noise: float
    """Standard deviation of what PV does from sample to sample by itself."""
    always: bool
    """Does it change most of the time, so that it has no levels?"""
    message: str


@dataclass(frozen=True)
class ExperimentData:
    """One experiment: what was read, what is used, what was found."""

    name: str
    loop: str
    """"closed" or "open"."""
    samples: int
    sample_time: float
    start: str | None
    """Time stamp of the record's time 0."""
    span: Interval
    used: tuple[Interval, ...]
    usable_share: Mapping[str, float]
    """Of PV, by output."""
    saturated_share: Mapping[str, float]
    """Of OP at a limit, by input."""
    excluded: tuple[Exclusion, ...]
    findings: tuple[DataFinding, ...]
    refused: str | None
    """Why nothing of it can be used."""
    time_zone: str | None = field(default=None, metadata=ABSENT)
    """In which its time stamps are shown: a name, or an offset from UTC."""
    span_calendar: Stamps | None = field(default=None, metadata=ABSENT)
    used_calendar: tuple[Stamps, ...] = field(default=(), metadata=ABSENT)
    excitation: Excitation | None = field(default=None, metadata=ABSENT)
    setpoints: tuple[SetpointMoves, ...] = field(default=(), metadata=ABSENT)
    """How each recorded set-point moves."""

    def calendar(self, unit: str) -> Calendar:
        """Its times in words; `unit` is that of the project."""
        return Calendar.of(unit, self.start, self.time_zone)
