"""What an analysis returns: frozen data and its JSON form."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from trueplant.result.curves import Curves
from trueplant.result.document import document
from trueplant.result.element import Element
from trueplant.result.headline import headline
from trueplant.result.plans import MoreData
from trueplant.result.reason import Reason
from trueplant.result.summary import html_summary, text_summary


@dataclass(frozen=True, eq=False)
class Result:
    """The outcome of an analysis. `to_dict` is result.json (schema 1)."""

    status: str
    reasons: tuple[Reason, ...]
    provenance: Mapping[str, Any]
    data: tuple[Mapping[str, Any], ...]
    elements: tuple[Element, ...]
    fit: tuple[Mapping[str, Any], ...] = ()
    methods: Mapping[str, Any] = field(default_factory=dict)
    robustness: Mapping[str, Any] = field(default_factory=dict)
    controllers: tuple[Mapping[str, Any], ...] = ()
    more_data: tuple[MoreData, ...] = ()
    """Moves that would settle what is open, the shortest first."""
    notes: tuple[Reason, ...] = ()
    """What the reader should know although it was not refused; also in result.json."""
    curves: Curves | None = None
    plant_toml: str = ""

    @property
    def mismatch(self) -> bool:
        return any(element.verdict == "changed" for element in self.elements)

    @property
    def headline(self) -> str:
        """The verdict in one sentence for the person at the panel."""
        return headline(self)

    def to_dict(self) -> dict[str, Any]:
        """result.json as plain Python; numbers that are not finite become None."""
        return document(self, left_out=("curves", "plant_toml"))

    def __repr__(self) -> str:
        return text_summary(self)

    def _repr_html_(self) -> str:
        return html_summary(self)
