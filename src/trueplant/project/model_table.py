"""The table of one element of the model."""

from __future__ import annotations

from typing import Literal

from pydantic import model_validator

from trueplant.project.fields import Formula, Name, StructureName, Table, problem


class ModelElement(Table):
    """One element of the available model."""

    output: Name
    input: Name
    tf: Formula | None = None
    estimate: bool = True
    structure: StructureName | Literal["auto"] | None = None

    @model_validator(mode="after")
    def _says_something(self) -> ModelElement:
        if self.tf is None and self.structure is None:
            raise problem('is needed: a formula, or structure = "auto" for an element that is to be found', "tf")
        if self.tf is None and not self.estimate:
            raise problem("keeps an element at its formula: give its tf", "estimate")
        return self
