"""What other methods answer beside the fit, and what the data show without it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from trueplant.result.codec import ABSENT, SPREAD, key
from trueplant.result.element import Interval


@dataclass(frozen=True)
class MethodParameter:
    """One parameter as one method answers it; without an error where the method gives none."""

    name: str
    plant: float | None
    std_error: float | None
    ci: Interval | None
    differs: bool = field(default=False, metadata=ABSENT)
    """From the direct fit by more than both their uncertainties."""


@dataclass(frozen=True)
class MethodElement:
    """One element as one method answers it."""

    output: str
    input: str
    parameters: tuple[MethodParameter, ...]


@dataclass(frozen=True)
class LawRatio:
    """A gain or a time of the law that wrote OP over the declared one."""

    output: str
    name: str
    """"gain", "integral time" or "derivative time"; of a transfer function its integral and all else."""
    value: float
    std_error: float


@dataclass(frozen=True)
class ControllerCheck:
    """Does a declared controller reproduce OP?"""

    experiment: str
    input: str
    unit: str
    confirmed: bool | None
    """None where it cannot be checked."""
    rms: float | None
    """Of OP less what the law as declared makes of set-points and PVs within short windows, in its unit."""
    message: str
    relative: float | None = None
    """The same relative to OP's own movement."""
    since: float | None = field(default=None, metadata=key("from"))
    """From when on they differ; None if throughout, or not at all."""
    since_calendar: str | None = field(default=None, metadata=key("from_calendar") | ABSENT)
    """The time stamp of that, where the record has time stamps."""
    ratios: tuple[LawRatio, ...] = ()
    """For each output that the law acts on: its gain, integral time and derivative time."""
    by_hand: tuple[Interval, ...] = field(default=(), metadata=ABSENT)
    """From when to when OP looks to be in manual, though nobody said so: these samples were left out."""


@dataclass(frozen=True)
class CascadeCheck:
    """Does a slave loop do what its master asks, in the band in which the master works?"""

    experiment: str
    input: str
    message: str
    follows: bool | None = None
    """None where it cannot be told."""
    band: Interval | None = None
    """rad per time unit."""
    basis: str = ""
    """What the band rests on."""
    deviation: float | None = None
    """Largest |T - 1|."""
    at: float | None = None
    gain: float | None = None
    lag: float | None = None
    held_share: float | None = None
    stuck_share: float | None = None


@dataclass(frozen=True)
class BandTest:
    """Does an element of the plant lie in the band of the estimate that assumes no structure?"""

    output: str
    input: str
    p_value: float
    p_adjusted: float
    within: bool
    worst_frequency: float
    speaks: Interval | None
    by: str


@dataclass(frozen=True)
class PartialCoherence:
    """What one reference explains alone."""

    of: str
    values: tuple[float, ...]


@dataclass(frozen=True)
class SignalCoherence:
    """What the references explain of one signal."""

    signal: str
    multiple: tuple[float, ...]
    partial: tuple[PartialCoherence, ...]


@dataclass(frozen=True)
class CoherenceTable:
    """Share of each signal's power that the set-points (or OP) explain, over frequency."""

    references: str = field(metadata=key("with"))
    """"set-points" or "OP"."""
    windows: float
    """Averaged, counted as independent ones."""
    significance: float
    level: float
    partial_level: float
    frequencies: tuple[float, ...]
    signals: tuple[SignalCoherence, ...]


@dataclass(frozen=True)
class DetectedElement:
    """What a published detector says of one element."""

    output: str
    input: str
    statistic: float
    threshold: float
    flagged: bool
    kind: str


@dataclass(frozen=True)
class Detection:
    """One published detector."""

    name: str
    refused: str | None
    """Why it does not apply."""
    note: str
    elements: tuple[DetectedElement, ...] = ()


@dataclass(frozen=True)
class BlackBoxElement:
    """p-values that the element of each method's plant lies where the black box says."""

    output: str
    input: str
    p_values: Mapping[str, float]


@dataclass(frozen=True)
class BlackBox:
    """A model of the records that knows neither structure nor controller."""

    lags: int
    remembers: float
    """Time that its lags span."""
    states: int
    states_reason: str
    elements: tuple[BlackBoxElement, ...]


@dataclass(frozen=True)
class DeclaredDisturbance:
    """A part of an unmeasured disturbance as declared, and the size found."""

    kind: str
    std: float
    time_constant: float | None
    found_std: float


@dataclass(frozen=True)
class DisturbanceJump:
    """A step of a disturbance that was found in a record."""

    experiment: str
    time: float
    size: float


@dataclass(frozen=True)
class LostInformation:
    """Share of the information on one parameter that the declared disturbance takes away."""

    input: str
    name: str
    share: float


@dataclass(frozen=True)
class Background:
    """What acts on an output beside the declared disturbance."""

    white: float
    std: float
    time_constant: float


@dataclass(frozen=True)
class DisturbanceFit:
    """What was found of the declared unmeasured disturbance of one output."""

    output: str
    declared: tuple[DeclaredDisturbance, ...]
    jumps: tuple[DisturbanceJump, ...]
    lost: tuple[LostInformation, ...]
    background: Background
    whiteness_p: float


@dataclass(frozen=True)
class Methods:
    """The answers of each method that ran, by its name, and what they say of each other."""

    answers: Mapping[str, tuple[MethodElement, ...]] = field(default_factory=dict, metadata=SPREAD)
    agreement: tuple[str, ...] = ()
    """Sentences: who agrees with the fit, and who does not."""
    disagreements: tuple[str, ...] = field(default=(), metadata=ABSENT)
    """Those of `agreement` that say who does not."""
    not_applied: Mapping[str, str] = field(default_factory=dict, metadata=ABSENT)
    """By method: why it does not apply; empty where it has no business at all."""
    remarks: Mapping[str, tuple[str, ...]] = field(default_factory=dict, metadata=ABSENT)
    """By method: what to know of it."""
    black_box: BlackBox | None = field(default=None, metadata=ABSENT)
    assumed: str = field(default="", metadata=ABSENT)
    """What taking measured disturbances off the record rests on."""
    disturbance: tuple[DisturbanceFit, ...] = field(default=(), metadata=ABSENT)
    cascade: tuple[CascadeCheck, ...] = field(default=(), metadata=ABSENT)
    controller_consistency: tuple[ControllerCheck, ...] = field(default=(), metadata=ABSENT)
    band: tuple[BandTest, ...] = field(default=(), metadata=ABSENT)
    coherence: CoherenceTable | None = field(default=None, metadata=ABSENT)
    detectors: tuple[Detection, ...] = field(default=(), metadata=ABSENT)
