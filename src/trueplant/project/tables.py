"""The tables of a project file, one model each. What concerns several tables is checked in `Project`."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, model_validator
from pydantic_core import PydanticCustomError

from trueplant.errors import FormulaError
from trueplant.lti import TransferFunction, parse_pv, require_proper, tf
from trueplant.lti.structure import Structure
from trueplant.project import levels
from trueplant.tune import ALL_METHODS

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
Name = Annotated[str, Field(min_length=1)]
TimeUnit = Literal["ms", "s", "min", "h", "d"]
TimeFormat = Literal[
    "dmy", "mdy", "ymd", "numbers", "calendar", "spreadsheet", "unix s", "unix ms", "unix us", "unix ns"
]
"""Those of `record.times.FORMATS`."""
Moment = Finite | datetime
"""A point of a record's time axis: a number in data.time_unit, or a timestamp."""


def problem(message: str, *where: str | int) -> PydanticCustomError:
    """An error found by a validator; ``where`` is the path of keys below the object validated."""
    safe = message.replace("{", "(").replace("}", ")")
    return PydanticCustomError("project", safe, {"where": tuple(where)})


def _ordered(pair: tuple[float, float]) -> tuple[float, float]:
    if not pair[0] < pair[1]:
        raise problem(f"must be [low, high] with low below high, not [{pair[0]:g}, {pair[1]:g}]")
    return pair


def _as_tuple(value: Any) -> Any:
    return tuple(value) if isinstance(value, list) else value


Limits = Annotated[tuple[Finite, Finite], BeforeValidator(_as_tuple), AfterValidator(_ordered)]


def _transfer_function(text: str | float) -> str | float:
    try:
        system = tf(text)
        require_proper(system, "the transfer function")
        _require_reason(system)
    except FormulaError as error:
        raise problem(str(error)) from error
    return text


def _require_reason(system: TransferFunction) -> None:
    """Raise FormulaError for numbers that no plant has, and that arithmetic does not survive."""
    times = [1 / abs(pole) for pole in system.poles if pole != 0] + [t.dead_time for t in system.terms if t.dead_time]
    gains = [max(map(abs, term.num)) / max(map(abs, term.den)) for term in system.terms]
    for name, values, (least, most) in (
        ("time constant or dead time", times, levels.TIMES),
        ("gain", gains, levels.GAINS),
    ):
        for value in values:
            if not least <= value <= most:
                raise FormulaError(
                    f"a {name} of about {value:.3g} is beyond {least:g} to {most:g}: correct it, or choose other units"
                )


def _pv_formula(text: str) -> str:
    try:
        parse_pv(text)
    except FormulaError as error:
        raise problem(str(error)) from error
    return text


def _structure(text: str) -> str:
    try:
        Structure.parse(text)
    except FormulaError as error:
        raise problem(str(error)) from error
    return text


Formula = Annotated[str | float, AfterValidator(_transfer_function)]
PvFormula = Annotated[str, AfterValidator(_pv_formula)]
StructureName = Annotated[str, AfterValidator(_structure)]


class Table(BaseModel):
    """A table of the project file: unknown keys and text for numbers are mistakes."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, populate_by_name=True)


class Exclude(Table):
    """A stretch of a record that is left out; without `file` of every record."""

    start: Moment = Field(alias="from")
    end: Moment = Field(alias="to")
    file: str | None = None

    @model_validator(mode="after")
    def _forwards(self) -> Exclude:
        if isinstance(self.start, datetime) != isinstance(self.end, datetime):
            raise problem("from and to must both be numbers or both be timestamps")
        if isinstance(self.start, datetime) and isinstance(self.end, datetime):
            if (self.start.tzinfo is None) != (self.end.tzinfo is None):
                raise problem("from and to must both bear a time zone, or neither")
            backwards = self.end <= self.start
        else:
            backwards = self.end <= self.start  # type: ignore[operator]
        if backwards:
            raise problem(f"to ({self.end}) must come after from ({self.start})")
        return self


class Data(Table):
    """The files and how to read them; tag, value and quality name the columns of long exports."""

    files: list[Name] = Field(default_factory=list)
    time: Name | None = None
    time_unit: TimeUnit | None = None
    time_format: TimeFormat | None = None
    time_zone: Name | None = None
    separator: Name | None = None
    sheet: Name | None = None
    tag: Name = "tag"
    value: Name = "value"
    quality: Name = "quality"
    max_samples: int | None = Field(default=None, gt=0)
    exclude: list[Exclude] = Field(default_factory=list)


class Experiment(Table):
    """One record where experiments differ: its file, and what differs from the rest of the project."""

    file: Name
    loop: Literal["closed", "open"] = "closed"
    controllers: list[dict[str, Any]] = Field(default_factory=list)
    limits: dict[str, Limits] = Field(default_factory=dict)


class Output(Table):
    """A controlled variable."""

    name: Name
    pv: Name
    sp: Name | None = None
    unit: str = ""
    limits: Limits | None = None


class Input(Table):
    """A manipulated variable."""

    name: Name
    op: Name
    unit: str = ""
    limits: Limits | None = None
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


class ModelElement(Table):
    """One element of the available model."""

    output: Name
    input: Name
    tf: Formula
    estimate: bool = True
    structure: StructureName | None = None


_FORM_KEYS = {
    "ideal": {"Kc", "Ti", "Td", "alpha"},
    "series": {"Kc", "Ti", "Td", "alpha"},
    "parallel": {"Kp", "Ki", "Kd", "Tf"},
    "tf": {"tf"},
}
_FORM_GAIN = {"ideal": "Kc", "series": "Kc", "parallel": "Kp"}


class Controller(Table):
    """One controller: a PID in one of three forms, or any transfer function."""

    input: Name
    output: Name
    form: Literal["ideal", "series", "parallel"] | None = None
    Kc: Finite | None = None
    Ti: Positive | None = None
    Td: NotNegative | None = None
    alpha: NotNegative | None = None
    Kp: Finite | None = None
    Ki: Finite | None = None
    Kd: Finite | None = None
    Tf: NotNegative | None = None
    tf: Formula | None = None
    gain_unit: Literal["engineering", "percent of span"] = "engineering"
    action: Literal["reverse", "direct"] | None = None
    setpoint_weight: NotNegative = 1.0
    setpoint_filter: Formula | None = None
    derivative_on: Literal["error", "pv"] = "error"
    sample_time: Positive | None = None
    anti_windup: Literal["none", "clamp", "back-calculation"] = "clamp"
    pv_transform: PvFormula | None = None

    @property
    def kind(self) -> str:
        """The form that the keys are those of: ideal, series, parallel or tf."""
        return "tf" if self.tf is not None else self.form or "ideal"

    @model_validator(mode="after")
    def _keys_fit_the_form(self) -> Controller:
        if self.tf is not None and self.form is not None:
            raise problem("says the whole law: leave form out", "tf")
        allowed = _FORM_KEYS[self.kind]
        for key in ("Kc", "Ti", "Td", "alpha", "Kp", "Ki", "Kd", "Tf"):
            if getattr(self, key) is not None and key not in allowed:
                owner = "a controller given by tf" if self.kind == "tf" else f'form = "{self.kind}"'
                hint = ' (or write form = "parallel")' if key in _FORM_KEYS["parallel"] and self.form is None else ""
                raise problem(f"is no key of {owner}, which has {', '.join(sorted(allowed))}{hint}", key)
        if self.kind in ("ideal", "series") and not self.Kc:
            raise problem("is needed and must not be 0", "Kc")
        if self.kind == "parallel" and not (self.Kp or self.Ki or self.Kd):
            raise problem("needs at least one of Kp, Ki, Kd that is not 0", "Kp")
        unfiltered = (self.Kd and not self.Tf) or (self.Td and self.alpha == 0)
        if unfiltered and self.sample_time is None:
            key = "Tf" if self.kind == "parallel" else "alpha"
            raise problem("must be above 0 where the derivative acts, unless sample_time says the scan", key)
        for key in ("setpoint_weight", "setpoint_filter", "derivative_on", "pv_transform", "anti_windup"):
            if self.kind == "tf" and key in self.model_fields_set:
                raise problem("belongs to a PID: a controller given by tf acts on set-point minus PV", key)
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


class Robustness(Table):
    """Weights of uncertainty (wI) and performance (wP): one for all channels, or one a channel."""

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
