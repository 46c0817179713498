"""What an analysis returns: frozen data and its JSON form."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from trueplant.lti import UncertainPlant
from trueplant.result.codec import document
from trueplant.result.controllers import LoopRetuning
from trueplant.result.curves import Curves
from trueplant.result.data import ExperimentData
from trueplant.result.element import Element
from trueplant.result.fit import FitRow
from trueplant.result.headline import headline
from trueplant.result.methods import Methods
from trueplant.result.plans import MoreData
from trueplant.result.provenance import Provenance
from trueplant.result.reason import Reason
from trueplant.result.robustness import LoopRobustness
from trueplant.result.shift_words import Action, action, shift
from trueplant.result.status import ElementVerdict, Status
from trueplant.result.summary import html_summary, text_summary
from trueplant.result.uncertainty import Uncertainty


@dataclass(frozen=True, eq=False)
class Result:
    """The outcome of an analysis. `to_dict` is result.json (schema 1)."""

    status: Status
    reasons: tuple[Reason, ...]
    provenance: Provenance
    data: tuple[ExperimentData, ...]
    elements: tuple[Element, ...]
    fit: tuple[FitRow, ...] = ()
    methods: Methods = field(default_factory=Methods)
    robustness: LoopRobustness | None = field(default=None, metadata={"none_as": {}})
    """None where no controller is declared, or nothing is answered."""
    controllers: tuple[LoopRetuning, ...] = ()
    more_data: tuple[MoreData, ...] = ()
    """Moves that would settle what is open, the shortest first."""
    notes: tuple[Reason, ...] = ()
    """What the reader should know although it was not refused; also in result.json."""
    curves: Curves | None = None
    uncertainty: Uncertainty | None = None
    """What is known of the plant's parameters together; None where nothing is answered."""
    plant: UncertainPlant | None = None
    """The plant (n_y, n_u + n_d) as estimated, with what is uncertain about it, to calculate with."""

    @property
    def mismatch(self) -> bool:
        return any(element.verdict == ElementVerdict.CHANGED for element in self.elements)

    @property
    def headline(self) -> str:
        """The verdict in one sentence for the person at the panel."""
        return headline(self)

    @property
    def shift(self) -> str:
        """The same for the shift: what the loop does now, whether its tuning is safe, and what to do."""
        return shift(self)

    @property
    def action(self) -> Action:
        """What is to be done first."""
        return action(self)

    def to_dict(self) -> dict[str, Any]:
        """result.json as plain Python; numbers that are not finite become None."""
        return document(self, left_out=("curves", "plant"))

    def __repr__(self) -> str:
        return text_summary(self)

    def _repr_html_(self) -> str:
        return html_summary(self)
