"""What an element is known to as a whole, however well its parameters are told from each other."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Derived:
    """One quantity of an element that follows from its parameters together, with their whole covariance."""

    name: str
    """net_gain (net_slope of an integrating element), total_delay, magnitude or phase."""
    unit: str
    at: str
    """"rest"; "crossover", of the loop of its input; or "corner", 1/(lag + dead time), where there is none."""
    frequency: float
    """rad per time unit."""
    model: float | None
    plant: float | None
    std_error: float | None
    ci: tuple[float, float] | None
    reason: str = ""
    """Why it is not answered, when `plant` is None."""
