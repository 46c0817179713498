"""How set-points move, in words."""

from __future__ import annotations

from trueplant.calendar import duration
from trueplant.result.data import SetpointMoves
from trueplant.result.numbers import counted


def moves_sentence(found: SetpointMoves, column: str, time_unit: str) -> str:
    """Such as: TIC101.SP moved 14 times, by 0.5 to 2 degC (median 1), every 35 min; PV noise is 0.1 degC."""
    noise = f"PV noise is {_with_unit(found.noise, found.unit)}."
    if found.smallest is None or found.largest is None or found.median is None:
        return f"{column} never moved; {noise}"
    smallest, largest = f"{found.smallest:.3g}", _with_unit(found.largest, found.unit)
    by = f"by {largest}"
    if smallest != f"{found.largest:.3g}":
        by = f"by {smallest} to {largest} (median {found.median:.3g})"
    if found.always:
        return f"{column} changes all the time, {by} in one direction; {noise}"
    times = "once" if found.moves == 1 else counted(found.moves, "time")
    every = "" if found.interval is None else f", every {duration(found.interval, time_unit)}"
    return f"{column} moved {times}, {by}{every}; {noise}"


def _with_unit(value: float, unit: str) -> str:
    return f"{value:.3g} {unit}".rstrip()
