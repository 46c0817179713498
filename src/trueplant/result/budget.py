"""Where the uncertainty of a parameter comes from."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum


class Source(Enum):
    """What leaves a parameter uncertain, in words; what each of them means stands in docs/result.md."""

    NOISE = "noise"
    SLOW_NOISE = "slow noise"
    START = "unknown start"
    COLOUR = "noise of changing size or colour"
    EXPERIMENTS = "between experiments"
    NOISE_MODEL = "noise model"
    LEFT_OUT = "dead time too short to see"
    NOT_SHOWN = "elements that do not show"
    STRUCTURE = "structure that does not suffice"
    ROUNDING = "timing and rounding"
    MINIMA = "other plants that fit as well"
    PROFILE = "uneven interval"
    SHARED_DISTURBANCE = "disturbance of several outputs"
    DISTURBANCE = "declared disturbance"
    HOLD = "disturbance between samples"
    HISTORIAN = "PV between stored samples"
    VALVE = "valve"


@dataclass(frozen=True)
class VariancePart:
    """What one source adds to the variance of a parameter, all those before it being there already."""

    source: Source
    share: float
    """Of the variance; those of one parameter sum to 1."""


@dataclass(frozen=True)
class ParameterBudget:
    """The parts of the variance of one parameter, the square of its standard error, in the order of inclusion."""

    parameter: str
    parts: tuple[VariancePart, ...]
