"""The table of one element of the model."""

from __future__ import annotations

from trueplant.project.fields import Formula, Name, StructureName, Table


class ModelElement(Table):
    """One element of the available model."""

    output: Name
    input: Name
    tf: Formula
    estimate: bool = True
    structure: StructureName | None = None
