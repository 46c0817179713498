"""How model and plant simulate the records, and the tests on the prediction errors."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from trueplant.result.codec import ABSENT


@dataclass(frozen=True)
class ValidationFit:
    """The fit on data that an estimate has not seen."""

    kind: str
    fit_percent: float
    fit_percent_same_data: float
    """Of the final estimate."""


@dataclass(frozen=True)
class ResidualTest:
    """The prediction errors of one output, and what they still show."""

    whiteness_p: float
    input_p: Mapping[str, float]
    """By input: p-value that the errors do not follow it."""
    noise_model_order: int
    prediction_error: float
    """Standard deviation, in the output's unit."""
    samples_per_error: int
    further_p: Mapping[str, float] = field(default_factory=dict)
    """By name of the test: p-values of tests that no verdict rests on."""


@dataclass(frozen=True)
class FitRow:
    """One output in one experiment; 100 (1 - |y - yhat|/|y - mean y|)."""

    output: str
    experiment: str
    fit_percent_model: float
    """Not a number where nobody said anything of the output."""
    fit_percent_plant: float
    validation: ValidationFit | None = None
    residual_tests: ResidualTest | None = field(default=None, metadata=ABSENT)
    """None for an output that was not estimated."""
