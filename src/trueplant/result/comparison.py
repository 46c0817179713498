"""Two results beside each other: frozen data and its JSON form, compare.json (schema 1)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from trueplant.result.codec import document
from trueplant.result.element import Interval
from trueplant.result.numbers import counted, spoken
from trueplant.result.provenance import Provenance
from trueplant.result.reason import Code, Reason
from trueplant.result.status import ElementVerdict, Status


@dataclass(frozen=True)
class ComparedParameter:
    """One parameter in both results, in the unit of the first."""

    name: str
    unit: str
    first: float | None
    first_ci: Interval | None
    second: float | None
    second_ci: Interval | None
    difference: float | None
    """Second minus first."""
    std_error: float | None
    """Of the difference, as of independent records: each part from the side of its interval that faces the other value,
    where that is wider than its standard error. None where they are not independent."""
    p_value: float | None
    p_adjusted: float | None
    """Familywise over all parameters compared."""
    differs: bool | None
    """Beyond chance; None where that cannot be said."""
    reason: str = ""
    """Why it is not compared."""


@dataclass(frozen=True)
class ComparedElement:
    """One element in both results; the pairs are of the first and the second."""

    output: str
    input: str
    verdicts: tuple[ElementVerdict, ElementVerdict]
    structures: tuple[str, str]
    """Where they are not the same, what both have is compared: the net gain and the total delay."""
    models: tuple[str | None, str | None]
    plants: tuple[str | None, str | None]
    parameters: tuple[ComparedParameter, ...]


@dataclass(frozen=True)
class ComparedFit:
    """One output in both results: fit of plant and record, in percent, where it is worst."""

    output: str
    fit_percent: tuple[float | None, float | None]


@dataclass(frozen=True)
class ComparedLoop:
    """The settings of one loop in both results; empty where none are recommended."""

    input: str
    output: str
    methods: tuple[str | None, str | None]
    first: Mapping[str, float | str | None]
    second: Mapping[str, float | str | None]


@dataclass(frozen=True)
class Comparison:
    """Two results beside each other. `to_dict` is compare.json (schema 1)."""

    status: Status
    """Refused where no parameter can be compared."""
    reasons: tuple[Reason, ...]
    notes: tuple[Reason, ...]
    provenance: tuple[Provenance, Provenance]
    confidence: float
    independent: bool
    """False where both rest on the same data, or on other data of the same hours: chance is then not judged."""
    elements: tuple[ComparedElement, ...]
    fit: tuple[ComparedFit, ...]
    controllers: tuple[ComparedLoop, ...]

    @property
    def headline(self) -> str:
        """What differs, in a sentence."""
        if self.status == Status.REFUSED:
            return "Nothing can be compared."
        compared = [p for e in self.elements for p in e.parameters if p.difference is not None]
        if any(note.code == Code.SAME_DATA for note in self.notes):
            return "Both results rest on the same data: their differences come from what was asked, not from the plant."
        if not self.independent:
            return "Two different files of the same hours: whether the plant differs beyond chance cannot be said."
        found = [(e, [p for p in e.parameters if p.differs]) for e in self.elements]
        found = [(e, parameters) for e, parameters in found if parameters]
        if not found:
            return f"No difference beyond chance in {counted(len(compared), 'parameter')}."
        told = [
            f"{spoken(e.input)} -> {spoken(e.output)} ({', '.join(_told(p) for p in parameters)})"
            for e, parameters in found
        ]
        return f"The plant differs between the two beyond chance: {'; '.join(told)}."

    def to_dict(self) -> dict[str, Any]:
        """compare.json as plain Python; numbers that are not finite become None."""
        return document(self)

    def __repr__(self) -> str:
        return f"Comparison({self.status}: {self.headline})"


def _told(parameter: ComparedParameter) -> str:
    share = f" {100 * (parameter.difference or 0.0) / abs(parameter.first):+.0f} %" if parameter.first else ""
    return f"{spoken(parameter.name)}{share}"
