"""What words about a result are made from."""

from __future__ import annotations

from typing import Protocol

from trueplant.result.controllers import LoopRetuning
from trueplant.result.element import Element
from trueplant.result.methods import Methods
from trueplant.result.provenance import Provenance
from trueplant.result.reason import Reason
from trueplant.result.robustness import LoopRobustness
from trueplant.result.status import Status


class Outcome(Protocol):
    """The parts of a `Result` that its words speak of."""

    @property
    def status(self) -> Status: ...
    @property
    def reasons(self) -> tuple[Reason, ...]: ...
    @property
    def notes(self) -> tuple[Reason, ...]: ...
    @property
    def elements(self) -> tuple[Element, ...]: ...
    @property
    def provenance(self) -> Provenance: ...
    @property
    def methods(self) -> Methods: ...
    @property
    def robustness(self) -> LoopRobustness | None: ...
    @property
    def controllers(self) -> tuple[LoopRetuning, ...]: ...
