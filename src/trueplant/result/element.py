"""One element of the plant: its parameters beside the model's, its verdict, what its change does."""

from __future__ import annotations

from dataclasses import dataclass

from trueplant.result.budget import ParameterBudget
from trueplant.result.derived import Derived
from trueplant.result.status import ElementVerdict

Interval = tuple[float, float]


@dataclass(frozen=True)
class Parameter:
    """One parameter of one element: the model's value, the plant's, and how sure that is."""

    name: str
    unit: str
    model: float | None
    plant: float | None
    std_error: float | None
    ci: Interval | None
    change_percent: float | None
    """Of the model's value."""
    p_value: float | None
    p_adjusted: float | None
    changed: bool | None
    """None where there is no model to have changed from."""
    reason: str = ""
    """Why it is not answered, when `plant` is None."""


@dataclass(frozen=True)
class Importance:
    """What the change does: peak of sigma_max of Delta_ij in Q Shat ("loop"), or relative change ("open loop")."""

    value: float | None
    basis: str


@dataclass(frozen=True)
class DeclaredStep:
    """The model's element where it was given as coefficients of a step or impulse response."""

    source: str
    """File and column."""
    error: float
    """Largest difference of the step response of `tf_model`, as a share of the gain."""
    error_at: float
    """When that is."""
    outside: tuple[Interval, ...] | None
    """From when to when the coefficients lie outside of the band of the plant's step response; None without a band."""


@dataclass(frozen=True)
class Element:
    output: str
    input: str
    structure: str
    tf_model: str | None
    """None where nobody said what it is."""
    tf_plant: str | None
    tf_mismatch: str | None
    parameters: tuple[Parameter, ...]
    verdict: ElementVerdict
    reason: str
    p_adjusted: float | None
    importance: Importance
    grade: str
    """A..D, defined in docs/verdicts.md."""
    detectable_change: float | None = None
    """The change that would just have been found, as a share of net gain, lag, or dead time plus lag: the largest of
    the three. None where nothing was tested or nothing is known."""
    detectable_of: str = ""
    """Which of them that is: "gain", "lag" or "dead time"; empty where it is not known."""
    rejected_structure: str | None = None
    """The declared structure, where the record rejects it in favour of `structure`."""
    derived: tuple[Derived, ...] = ()
    """What is known of it as a whole."""
    budget: tuple[ParameterBudget, ...] = ()
    """What the standard error of each answered parameter is made of."""
    declared_step: DeclaredStep | None = None
    """Where the model was given as coefficients."""
