"""The table of one element of the model: a formula, a measured step response or an element of a state space."""

from __future__ import annotations

from typing import Literal

from pydantic import model_validator

from trueplant.project.fields import Finite, Formula, Name, Positive, StructureName, Table, problem

FORMS = ("tf", "step", "state_space")
"""Keys of which each element has one."""
OF_STEP = ("column", "time", "sample_time", "kind", "ramp")
"""Keys that belong to `step`."""


class ModelElement(Table):
    """One element of the available model."""

    output: Name
    input: Name
    tf: Formula | None = None
    step: Name | list[Finite] | None = None
    column: Name | None = None
    time: Name | None = None
    sample_time: Positive | None = None
    kind: Literal["step", "fir"] = "step"
    ramp: bool = False
    state_space: Name | None = None
    gain_unit: Literal["engineering", "percent of span"] = "engineering"
    estimate: bool = True
    structure: StructureName | Literal["auto"] | None = None

    @property
    def wanted(self) -> bool:
        """Is it to be looked for, as nothing is said of it but perhaps its structure?"""
        return all(getattr(self, key) is None for key in FORMS)

    @property
    def file(self) -> str | None:
        """In the project's folder, if it comes from one."""
        return self.step if isinstance(self.step, str) else self.state_space

    @model_validator(mode="after")
    def _is_said_once(self) -> ModelElement:
        given = [key for key in FORMS if getattr(self, key) is not None]
        if not given and self.structure is None:
            raise problem(
                "is missing: add a formula, or instead of it step = ... or state_space = ... with a file, or "
                'structure = "auto" for an element that is to be found',
                "tf",
            )
        if not given and not self.estimate:
            raise problem("keeps an element at what is declared: give its tf", "estimate")
        if len(given) > 1:
            raise problem(f"says what {given[0]} says: keep one of them", given[1])
        for key in OF_STEP if self.step is None else ():
            if key in self.model_fields_set:
                raise problem("belongs to step = ...: leave it out", key)
        if self.step is not None and (self.sample_time is None) == (self.time is None):
            said = "the same in two ways" if self.time else "the times of the coefficients are missing"
            raise problem(f"{said}: give one of sample_time = ... and time = ... (a column)", "step")
        for key in ("column", "time") if isinstance(self.step, list) else ():
            if getattr(self, key) is not None:
                raise problem("belongs to a file of coefficients: leave it out", key)
        return self
