"""What checking the data returns: frozen data and its JSON form, check.json (schema 1)."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from trueplant.result.codec import ABSENT, document
from trueplant.result.data import ExperimentData
from trueplant.result.numbers import counted
from trueplant.result.provenance import Provenance
from trueplant.result.reason import Reason
from trueplant.result.status import Status
from trueplant.result.usable import UsableStretch


@dataclass(frozen=True, eq=False)
class Check:
    """Which of the data can be used, and whether they can answer. `to_dict` is check.json (schema 1)."""

    status: Status
    """Refused where nothing can be answered from these data."""
    reasons: tuple[Reason, ...]
    """Why nothing, or not everything, can be answered."""
    notes: tuple[Reason, ...]
    provenance: Provenance
    data: tuple[ExperimentData, ...]
    usable: tuple[UsableStretch, ...] | None = field(default=None, metadata=ABSENT)
    """The stretches with usable moves, the most worth first; None where they were not looked for."""

    @property
    def headline(self) -> str:
        """Whether it is worth going on, in a sentence."""
        if self.usable:
            return f"{counted(len(self.usable), 'stretch', 'es')} with usable moves found."
        usable = [one for one in self.data if one.refused is None]
        if self.status == Status.REFUSED:
            why = self.reasons[0].message if self.reasons else "no usable data are left after screening"
            return f"These data cannot answer: {why}."
        whole = "" if len(usable) == len(self.data) else f" of {len(self.data)}"
        inside = "it" if len(usable) == 1 else "them"
        return f"{counted(len(usable), 'record')}{whole} can be used, and the moves in {inside} can be told from noise."

    def to_dict(self) -> dict[str, Any]:
        """check.json as plain Python; numbers that are not finite become None."""
        return document(self)

    def __repr__(self) -> str:
        return f"Check({self.status}: {self.headline})"
