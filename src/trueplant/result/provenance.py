"""Where a result comes from, enough to make it again."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from trueplant.result.codec import ABSENT
from trueplant.result.element import Interval


@dataclass(frozen=True)
class Settings:
    """What was asked of the analysis."""

    method: str
    confidence: float
    tolerance_percent: float
    precision_percent: float | None = field(default=None, metadata=ABSENT)
    """Of tracking: the relative standard error that windows are made long enough for."""


@dataclass(frozen=True)
class Provenance:
    """Where a result comes from, enough to make it again."""

    version: str
    """Of trueplant."""
    project: str
    """The file, or "project" where it was built in code."""
    project_sha256: str
    data_sha256: Mapping[str, str]
    """By experiment."""
    time_spans: Mapping[str, Interval]
    """By experiment, in the project's time unit."""
    time_unit: str
    seed: int
    settings: Settings
    model_sha256: Mapping[str, str] = field(default_factory=dict)
    """By file, of those that elements of the model are in."""
