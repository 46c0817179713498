"""The parts of what tracking returns."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum

from trueplant.result.codec import ABSENT
from trueplant.result.data import Stamps
from trueplant.result.element import Interval, Parameter
from trueplant.result.status import ElementVerdict, Status


class ChangeKind(StrEnum):
    """How an element changed."""

    STEP = "step"
    """From one sample to the next."""
    DRIFT = "drift"
    """Little by little."""
    UNDECIDED = "undecided"
    """In one of the two ways: the windows do not tell them apart."""


class ElementHistory(StrEnum):
    """What is known of an element over the whole record."""

    CONSTANT = "constant"
    """It was tested, and no change was found."""
    STEP = "step"
    """It changed in a step at least once."""
    DRIFT = "drift"
    """It drifted, and there is no step."""
    UNDECIDED = "undecided"
    """It changed, in a step or little by little."""
    NOT_IDENTIFIABLE = "not identifiable"
    """Too few windows answer for it."""


@dataclass(frozen=True)
class WindowElement:
    """One element in one window, judged against the declared model."""

    input: str
    verdict: ElementVerdict
    """Familywise over the elements of this output in this window."""
    p_adjusted: float | None
    parameters: tuple[Parameter, ...]


@dataclass(frozen=True)
class Window:
    """A stretch of the record of one output: fitted, or refused with the reason. Times on the common axis."""

    output: str
    experiment: str
    start: float
    end: float
    status: Status
    reason: str = ""
    elements: tuple[WindowElement, ...] = ()
    calendar: Stamps | None = field(default=None, metadata=ABSENT)
    """As below: where the records have time stamps."""


@dataclass(frozen=True)
class Moved:
    """A parameter before and after a change (at the two ends of a drift)."""

    name: str
    unit: str
    before: float
    after: float
    std_error: float
    """Of after - before."""
    ci: Interval
    """Of after - before."""
    change_percent: float | None
    """Of the value before."""
    p_adjusted: float
    changed: bool


@dataclass(frozen=True)
class Change:
    """One element that changed, and since when."""

    output: str
    input: str
    kind: ChangeKind
    time: float | None
    """Of a step: when PV began to follow the new parameters."""
    interval: Interval
    """In which a step lies at the confidence asked for; of a drift the whole stretch."""
    p_adjusted: float
    parameters: tuple[Moved, ...]
    time_calendar: str | None = field(default=None, metadata=ABSENT)
    interval_calendar: Stamps | None = field(default=None, metadata=ABSENT)


@dataclass(frozen=True)
class TrackedElement:
    """The history of one element in a word."""

    output: str
    input: str
    history: ElementHistory
    p_adjusted: float | None
    windows: int
    """Windows that its history rests on."""
    scatter: float
    """Factor on the standard errors that the scatter of the windows asked for; 1 if none."""
    reason: str = ""
    standing: WindowElement | None = None
    """Against the model, from one estimate of the whole record, or of its longest stretch without a step of this
    output; None where an element of this output drifted or changed at a time that is not known."""


@dataclass(frozen=True)
class TrackedExperiment:
    """Where a record lies on the common time axis."""

    name: str
    offset: float
    """Added to the record's own time."""
    start: str | None
    """Time stamp of the record's time 0."""
    span: Interval
    span_calendar: Stamps | None = field(default=None, metadata=ABSENT)
