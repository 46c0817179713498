"""What words about a result are made from."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

from trueplant.result.element import Element
from trueplant.result.reason import Reason


class Outcome(Protocol):
    """The parts of a `Result` that its words speak of."""

    @property
    def status(self) -> str: ...
    @property
    def reasons(self) -> tuple[Reason, ...]: ...
    @property
    def notes(self) -> tuple[Reason, ...]: ...
    @property
    def elements(self) -> tuple[Element, ...]: ...
    @property
    def provenance(self) -> Mapping[str, Any]: ...
    @property
    def methods(self) -> Mapping[str, Any]: ...
    @property
    def robustness(self) -> Mapping[str, Any]: ...
    @property
    def controllers(self) -> tuple[Mapping[str, Any], ...]: ...
