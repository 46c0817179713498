"""Numbers as text: as many digits as they deserve, plain ASCII so that they can be copied into a sheet."""

from __future__ import annotations

import math

from trueplant.result import numbers

MISSING = "–"


def finite(value: float | None) -> float | None:
    """`value`, or None where it is not finite, as result.json has it: there is then no number to show."""
    return value if value is not None and math.isfinite(value) else None


def _trimmed(text: str) -> str:
    text = text.rstrip("0").rstrip(".") if "." in text else text
    return "0" if text == "-0" else text


def number(value: float | None, digits: int = 4) -> str:
    """`value` with `digits` significant digits; an exponent only below 1e-4 and from 1e6 on; whole numbers in full."""
    if value is None or math.isnan(value):
        return MISSING
    if isinstance(value, int):
        return str(value)
    if math.isinf(value):
        return "∞" if value > 0 else "-∞"
    if value == 0:
        return "0"
    if 1e-4 <= abs(value) < 1e6:
        return _trimmed(f"{value:.{max(0, digits - 1 - math.floor(math.log10(abs(value))))}f}")
    mantissa, exponent = f"{value:.{digits - 1}e}".split("e")
    return f"{_trimmed(mantissa)}e{int(exponent)}"


def to_precision(value: float | None, resolution: float | None) -> str:
    """`value` with the decimals at which `resolution` (a standard error) has two significant digits."""
    if value is None or resolution is None or not (math.isfinite(value) and math.isfinite(resolution)):
        return number(value)
    if resolution <= 0 or max(abs(value), resolution) >= 1e6 or resolution < 1e-6:
        return number(value)
    decimals = 1 - math.floor(math.log10(resolution))
    text = f"{round(value, decimals):.{max(0, decimals)}f}"
    return text if float(text) else text.lstrip("-")


def interval(low: float | None, high: float | None, resolution: float | None = None) -> str:
    """``low to high``."""
    return f"{to_precision(low, resolution)} to {to_precision(high, resolution)}"


def probability(p: float | None, relation: bool = False) -> str:
    """A p-value, with ``=`` in front if `relation`; below one in a thousand it is only said to be so."""
    if p is None or math.isnan(p):
        return MISSING
    return "< 0.001" if p < 1e-3 else f"{'= ' if relation else ''}{p:.3f}"


def percentage(change: float | None) -> str:
    """A change in percent with its sign."""
    return MISSING if change is None or not math.isfinite(change) else numbers.percentage(change)
