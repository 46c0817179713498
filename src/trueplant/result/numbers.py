"""Numbers, names and sentences as a person reads them."""

from __future__ import annotations

import math


def spoken(name: str) -> str:
    return name.replace("_", " ")


def counted(n: int, word: str, plural: str = "s") -> str:
    return f"{n} {word}{plural if n != 1 else ''}"


def number(value: float | None, digits: int = 3) -> str:
    """Three significant digits, without an exponent where it can be helped."""
    if value is None or not math.isfinite(value):
        return "unknown"
    if value == 0:
        return "0"
    if not 1e-4 <= abs(value) < 1e6:
        return f"{value:.{digits - 1}e}"
    decimals = digits - 1 - math.floor(math.log10(abs(value)))
    return f"{value:.{max(decimals, 0)}f}"


def percentage(change: float, decimals: int = 1) -> str:
    """A change in percent with its sign; what rounds to nothing has none."""
    if not math.isfinite(change):
        return "unknown"
    if abs(change) >= 1e6:
        return f"{number(change, 1)} %"
    text = f"{change:+.{0 if abs(change) >= 100 else decimals}f}"
    return f"{text} %" if text.strip("+-0.") else f"{text[1:]} %"


def value_with_interval(value: float, ci: tuple[float, float]) -> str:
    """``0.917 ± 0.012`` with half of the interval, or ``0.917, 0.90 to 0.95`` where it is lopsided."""
    if not all(map(math.isfinite, ci)):
        if math.isfinite(ci[0]) or math.isfinite(ci[1]):
            known = f"at least {number(ci[0])}" if math.isfinite(ci[0]) else f"at most {number(ci[1])}"
        else:
            known = "no limit known"
        return f"{number(value)}, {known}"
    below, above = value - ci[0], ci[1] - value
    half = (below + above) / 2
    if not 0 < half < 1e6:
        return f"{number(value)}, {number(ci[0])} to {number(ci[1])}"
    decimals = min(max(1 - math.floor(math.log10(half)), 0), 12)
    # what rounds to -0 is 0
    middle, low, high = (f"{round(x, decimals) + 0.0:.{decimals}f}" for x in (value, *ci))
    if abs(above - below) > 0.4 * half:
        return f"{middle}, {low} to {high}"
    return f"{middle} ± {half:.{decimals}f}"


def sentence(text: str) -> str:
    text = text.strip()
    return text if text.endswith((".", "!", "?")) else f"{text}."
