"""The table of a controller, in the keys of its law or as its faceplate shows it."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import AfterValidator, Field, model_validator

from trueplant.errors import LoopError
from trueplant.project.fields import Finite, Formula, Name, NotNegative, Positive, PvFormula, Table, problem
from trueplant.tune.vendors import Vendor, vendor_of

_FORM_KEYS = {
    "ideal": {"Kc", "Ti", "Td", "alpha"},
    "series": {"Kc", "Ti", "Td", "alpha"},
    "parallel": {"Kp", "Ki", "Kd", "Tf"},
    "tf": {"tf"},
}
_OF_ONE_KIND = (
    ("Kc", "gain", "PB"),
    ("Ti", "repeats_per_minute", "reset_minutes", "reset_seconds"),
    ("Td", "rate_minutes", "rate_seconds"),
)
"""Keys of which each law has one at most: the first in the project's units, the others as faceplates show them."""
FACEPLATE = tuple(key for keys in _OF_ONE_KIND for key in keys[1:])


def _known_vendor(name: str) -> str:
    try:
        return vendor_of(name).name
    except LoopError as error:
        raise problem(str(error)) from error


VendorName = Annotated[Name, AfterValidator(_known_vendor)]


class Feedforward(Table):
    """What a controller adds to OP for a measured disturbance."""

    column: Name
    tf: Formula


class Controller(Table):
    """One controller: a PID in one of three forms, or any transfer function."""

    input: Name
    output: Name
    form: Literal["ideal", "series", "parallel"] | None = None
    vendor: VendorName | None = None
    Kc: Finite | None = None
    Ti: Positive | None = None
    Td: NotNegative | None = None
    alpha: NotNegative | None = None
    gain: Finite | None = None
    PB: Positive | None = None
    repeats_per_minute: Positive | None = None
    reset_minutes: Positive | None = None
    reset_seconds: Positive | None = None
    rate_minutes: NotNegative | None = None
    rate_seconds: NotNegative | None = None
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
    pv_filter: Formula | None = None
    recorded: Literal["before", "after"] = "before"
    feedforward: list[Feedforward] = Field(default_factory=list)
    gap: Positive | None = None
    error_squared: bool = False
    rate_limit: Positive | None = None

    @property
    def beyond(self) -> dict[str, str]:
        """By key, in words: what the law has beyond a PID of set-point and recorded PV, which nothing here replays.

        A filter before the recorded PV belongs to the plant as it was recorded.
        """
        filtered = self.pv_filter is not None and self.recorded == "before"
        has = {
            "pv_filter": "a PV filter" if filtered else "",
            "feedforward": " and ".join(f"feedforward from {one.column}" for one in self.feedforward),
            "gap": "a gap" if self.gap else "",
            "error_squared": "an error-squared gain" if self.error_squared else "",
            "rate_limit": "a rate limit" if self.rate_limit else "",
        }
        return {key: words for key, words in has.items() if words}

    @property
    def shown_by(self) -> Vendor | None:
        """The system whose numbers these are, where it is named."""
        return None if self.vendor is None else vendor_of(self.vendor)

    @property
    def kind(self) -> str:
        """The form that the keys are those of: ideal, series, parallel or tf."""
        own = None if self.shown_by is None else self.shown_by.form
        return "tf" if self.tf is not None else own or self.form or "ideal"

    @property
    def in_percent(self) -> bool:
        """Are gains in per cent of span, as declared, or as a proportional band and the known systems have them?"""
        return self.gain_unit == "percent of span" or self.PB is not None or self.vendor is not None

    @model_validator(mode="after")
    def _keys_fit_the_form(self) -> Controller:
        if self.tf is not None and self.form is not None:
            raise problem("says the whole law: leave form out", "tf")
        self._check_faceplate()
        allowed = _FORM_KEYS[self.kind]
        for key in ("Kc", "Ti", "Td", "alpha", "Kp", "Ki", "Kd", "Tf"):
            if getattr(self, key) is not None and key not in allowed:
                owner = "a controller given by tf" if self.kind == "tf" else f'form = "{self.kind}"'
                hint = ' (or write form = "parallel")' if key in _FORM_KEYS["parallel"] and self.form is None else ""
                raise problem(f"is no key of {owner}, which has {', '.join(sorted(allowed))}{hint}", key)
        if self.kind in ("ideal", "series") and not (self.Kc or self.gain or self.PB):
            raise problem("is needed and must not be 0 (or give gain or PB, as the faceplate shows it)", "Kc")
        if self.kind == "parallel" and not (self.Kp or self.Ki or self.Kd):
            raise problem("needs at least one of Kp, Ki, Kd that is not 0", "Kp")
        self._check_filter()
        if "recorded" in self.model_fields_set and self.pv_filter is None:
            raise problem("says on which side of the PV filter PV was recorded: add pv_filter = ...", "recorded")
        for key in ("setpoint_weight", "setpoint_filter", "derivative_on", "pv_transform", "anti_windup"):
            if self.kind == "tf" and key in self.model_fields_set:
                raise problem("belongs to a PID: a controller given by tf acts on set-point minus PV", key)
        return self

    def _check_faceplate(self) -> None:
        """Each setting is said once, in keys that the form and the system have."""
        for keys in _OF_ONE_KIND:
            given = [key for key in keys if getattr(self, key) is not None]
            if len(given) > 1:
                raise problem(f"says what {given[0]} says: keep one of them", given[1])
        shown = [key for key in FACEPLATE if getattr(self, key) is not None]
        owners = {"tf": "a controller given by tf", "parallel": "an independent (parallel) form: give Kp, Ki, Kd"}
        if shown and self.kind in owners:
            raise problem(f"is no key of {owners[self.kind]}", shown[0])
        if self.PB is not None and "gain_unit" in self.model_fields_set and self.gain_unit == "engineering":
            raise problem("a proportional band is in per cent of span: leave gain_unit out", "gain_unit")
        if self.shown_by is not None:
            self._check_vendor(self.shown_by)

    def _check_vendor(self, system: Vendor) -> None:
        """Only what that system shows, in its words."""
        if self.form is not None and self.form != system.form:
            raise problem(f'{system.name} shows the form "{system.form}": leave form out', "form")
        if self.tf is not None:
            raise problem("names a PID: leave it out of a controller given by tf", "vendor")
        shows, other = ("PB", "gain") if system.gain == "proportional band" else ("gain", "PB")
        if getattr(self, other) is not None:
            raise problem(f"is not what {system.name} shows: give {shows} (gain = 100 / PB)", other)
        unit = "seconds" if system.time_unit == "s" else "minutes"
        for key, instead in (("Kc", shows), ("Ti", f"reset_{unit}"), ("Td", f"rate_{unit}")):
            if getattr(self, key) is not None:
                raise problem(f"is in the project's units: give {instead}, as {system.name} shows it", key)

    def _check_filter(self) -> None:
        derivative = self.Td or self.rate_minutes or self.rate_seconds
        if ((self.Kd and not self.Tf) or (derivative and self.alpha == 0)) and self.sample_time is None:
            key = "Tf" if self.kind == "parallel" else "alpha"
            raise problem("must be above 0 where the derivative acts, unless sample_time says the scan", key)
