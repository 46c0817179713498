"""The table of a controller."""

from __future__ import annotations

from typing import Literal

from pydantic import model_validator

from trueplant.project.fields import Finite, Formula, Name, NotNegative, Positive, PvFormula, Table, problem

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
