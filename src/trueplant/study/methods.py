"""The other ways to the same answer, and whether they agree with the fit."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from trueplant.identify import OutputEstimate

if TYPE_CHECKING:
    from trueplant.study.pipeline import Study


def compare_methods(study: Study, estimates: dict[int, OutputEstimate]) -> dict[str, Any]:
    """Elements by each further method that applies."""
    return {}
