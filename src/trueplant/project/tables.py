"""The tables of a project file, one model each. What concerns several tables is checked in `Project`."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, model_validator

from trueplant.project.fields import Finite, Formula, Limits, Name, NotNegative, Positive, Table, TimeUnit, problem
from trueplant.project.law_table import VendorName
from trueplant.project.source_table import Historian
from trueplant.tune import ALL_METHODS

TimeFormat = Literal[
    "dmy", "mdy", "ymd", "numbers", "calendar", "spreadsheet", "unix s", "unix ms", "unix us", "unix ns"
]
"""Those of `record.times.FORMATS`."""


def _no_text(given: Any) -> Any:
    if isinstance(given, str):
        raise problem(f'must be a number, or a timestamp without quotes such as 2024-03-05T04:00:00, not "{given}"')
    return given


Moment = Annotated[Finite | datetime, BeforeValidator(_no_text)]
"""A point of a record's time axis: a number in data.time_unit, or a timestamp."""


def _check_forwards(start: Moment, end: Moment) -> None:
    """Both are of one kind, and in order."""
    if isinstance(start, datetime) != isinstance(end, datetime):
        raise problem("from and to must both be numbers or both be timestamps")
    if isinstance(start, datetime) and isinstance(end, datetime) and (start.tzinfo is None) != (end.tzinfo is None):
        raise problem("from and to must both bear a time zone, or neither")
    if end <= start:  # type: ignore[operator]
        raise problem(f"to ({end}) must come after from ({start})")


class Exclude(Table):
    """A stretch of a record that is left out; without `file` of every record."""

    start: Moment = Field(alias="from")
    end: Moment = Field(alias="to")
    file: str | None = None

    @model_validator(mode="after")
    def _forwards(self) -> Exclude:
        _check_forwards(self.start, self.end)
        return self


class Data(Table):
    """The files and how to read them; tag, value and quality name the columns of long exports.

    Instead of files a historian, and which stretch of time of it.
    """

    files: list[Name] = Field(default_factory=list)
    source: Historian | None = None
    start: datetime | None = Field(default=None, alias="from")
    end: datetime | None = Field(default=None, alias="to")
    sample_time: Positive | None = None
    max_gap: Positive | None = None
    time: Name | None = None
    time_unit: TimeUnit | None = None
    time_format: TimeFormat | None = None
    time_zone: Name | None = None
    separator: Name | None = None
    encoding: Name | None = None
    sheet: Name | None = None
    tag: Name = "tag"
    value: Name = "value"
    quality: Name = "quality"
    max_samples: int | None = Field(default=None, gt=0)
    exclude: list[Exclude] = Field(default_factory=list)

    @model_validator(mode="after")
    def _source_is_whole(self) -> Data:
        if (self.sample_time is None) != (self.max_gap is None):
            missing = "max_gap" if self.max_gap is None else "sample_time"
            raise problem("sample_time and max_gap go together: set both or none", missing)
        if self.sample_time is not None and self.max_gap is not None and self.max_gap < self.sample_time:
            raise problem(f"must be at least sample_time ({self.sample_time:g})", "max_gap")
        if self.source is None:
            for key, said in (("from", self.start), ("to", self.end)):
                if said is not None:
                    raise problem(
                        "goes with [data.source]; a part of a file is an [[experiment]] with from and to", key
                    )
            return self
        for key in ("files", "time", "time_format", "separator", "encoding", "sheet", "tag", "value", "quality"):
            if key in self.model_fields_set:
                raise problem("says how files are read: leave it out with [data.source]", key)
        for key, said in (("from", self.start), ("to", self.end)):
            if said is None:
                raise problem("is needed with [data.source], as in from = 2026-10-01T00:00:00+02:00", key)
        assert self.start is not None
        assert self.end is not None
        _check_forwards(self.start, self.end)
        return self


class Experiment(Table):
    """One record where experiments differ: its file, or a part of it, and what differs from the rest of the project."""

    file: Name
    start: Moment | None = Field(default=None, alias="from")
    end: Moment | None = Field(default=None, alias="to")
    loop: Literal["closed", "open"] = "closed"
    controllers: list[dict[str, Any]] = Field(default_factory=list)
    limits: dict[str, Limits] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _forwards(self) -> Experiment:
        if self.start is not None and self.end is not None:
            _check_forwards(self.start, self.end)
        return self


class Output(Table):
    """A controlled variable."""

    name: Name
    pv: Name
    sp: Name | None = None
    unit: str = ""
    kind: Literal["flow", "pressure", "level", "temperature", "other"] | None = None
    limits: Limits | None = None
    span: Limits | None = None
    status: Name | None = None
    keep: list[Literal["frozen", "spike"]] = Field(default_factory=list)


class Input(Table):
    """A manipulated variable."""

    name: Name
    op: Name
    unit: str = ""
    limits: Limits | None = None
    span: Limits | None = None
    status: Name | None = None
    mode: Name | None = None
    automatic_values: list[int | float | str] = Field(default_factory=list)
    hold: Literal["zoh", "linear"] = "zoh"
    actuator: Literal["valve", "other"] = "valve"
    slave_sp: Name | None = None
    slave_pv: Name | None = None

    @model_validator(mode="after")
    def _slave_is_whole(self) -> Input:
        if (self.slave_sp is None) != (self.slave_pv is None):
            raise problem("slave_sp and slave_pv go together: name both columns or none")
        if self.automatic_values and self.mode is None:
            raise problem("needs the column of the mode: add mode = ...", "automatic_values")
        return self


class Disturbance(Table):
    """A measured disturbance. `hold` says how it runs between its samples; None: found by what fits."""

    name: Name
    column: Name
    unit: str = ""
    hold: Literal["zoh", "linear"] | None = None


class Unmeasured(Table):
    """The disturbance model of one output, for the Kalman estimate."""

    output: Name
    kind: Literal["step", "drift", "ar1"]
    std: Positive
    time_constant: Positive | None = None

    @model_validator(mode="after")
    def _time_constant_belongs_to_ar1(self) -> Unmeasured:
        if self.kind == "ar1" and self.time_constant is None:
            raise problem('is needed with kind = "ar1"', "time_constant")
        if self.kind != "ar1" and self.time_constant is not None:
            raise problem(f'has no meaning with kind = "{self.kind}": leave it out', "time_constant")
        return self


Detector = Literal[
    "partial-correlation", "cross-correlation", "stepwise", "plant-model-ratio", "nominal-sensitivity", "one-class"
]
"""A published detector (`trueplant.detect.DETECTORS`)."""


Method = Literal[
    "auto",
    "all",
    "direct",
    "closed-form",
    "joint",
    "periodic",
    "equation-error",
    "srivc",
    "rivc",
    "clsrivc",
    "two-stage",
    "black-box",
]
"""What is compared with the direct fit, on which the verdicts rest whichever is asked for."""


class Analysis(Table):
    """Which methods, and how strictly."""

    method: Method = "auto"
    confidence: Annotated[float, Field(gt=0.5, lt=1)] = 0.95
    tolerance_percent: NotNegative = 0.0
    worth_knowing_percent: Positive = 30.0
    longest_test: Positive | None = None
    seed: Annotated[int, Field(ge=0)] = 0
    detectors: list[Detector] = Field(default_factory=list)


class UncertaintyNumbers(Table):
    """Size of the model's error: of the gain in percent, and of the dead time."""

    gain_percent: NotNegative = 0.0
    dead_time: NotNegative = 0.0


class PerformanceNumbers(Table):
    """What the loop must do: bandwidth in rad per time unit, peak M and steady error A of the sensitivity."""

    bandwidth: Positive
    M: Annotated[float, Field(gt=1, allow_inf_nan=False)] = 2.0
    A: NotNegative = 0.0


class ElementNumbers(UncertaintyNumbers):
    """The same of one element."""

    output: Name
    input: Name


class Robustness(Table):
    """Weights of uncertainty (wI) and performance (wP): one for all channels, or one a channel.

    `elements`: real errors of the gain and the dead time of all elements, or of those that are named.
    """

    elements: UncertaintyNumbers | list[ElementNumbers] | None = None
    wI: Formula | UncertaintyNumbers | list[Formula | UncertaintyNumbers] | None = None
    wP: Formula | PerformanceNumbers | list[Formula | PerformanceNumbers] | None = None


class TuningLimits(Table):
    """What a retuned loop must keep: sensitivity peak, mu of robust performance, share of likely plants, speed.

    `speed`: how many times today's crossover at most.
    """

    Ms: Annotated[float, Field(gt=1, allow_inf_nan=False)] | None = None
    mu: Positive | None = None
    share: Annotated[float, Field(gt=0, lt=1)] | None = None
    speed: Annotated[float, Field(ge=1, allow_inf_nan=False)] | None = None


class Tuning(Table):
    """Retuning: the methods, the limits, and the form of the answer, in the project's keys and as vendors show it."""

    methods: list[Name] = Field(default_factory=list)
    limits: TuningLimits = TuningLimits()
    kind: Literal["PI", "PID"] | None = None
    vendor: VendorName | None = None
    form: Literal["ideal", "series", "parallel"] | None = None
    gain_unit: Literal["engineering", "percent of span"] | None = None
    gain: Literal["gain", "proportional band"] | None = None
    integral: Literal["time", "repeats"] | None = None
    derivative_filter: Literal["ratio", "divisor", "time"] | None = None
    time_unit: TimeUnit | None = None

    @model_validator(mode="after")
    def _methods_exist(self) -> Tuning:
        if self.methods:
            for k, name in enumerate(self.methods):
                if name not in ALL_METHODS:
                    raise problem(f"{name!r} is no tuning method: use {', '.join(ALL_METHODS)}", "methods", k)
        return self
