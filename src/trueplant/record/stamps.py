"""Numbers that are moments: calendar digits, serial days of a spreadsheet, seconds (or parts of them) since 1970.

A column of such numbers can be told from one that counts time units: its values lie in a narrow band that no count
reaches by chance, and where both readings make sense the project has to say which is meant.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime

import numpy as np

from trueplant.arrays import Array
from trueplant.errors import DataError
from trueplant.record import levels

_EPOCH, _DAY = 25569, 86400.0
"""1970-01-01 in days from the 30th of December 1899, as spreadsheets count them; seconds of a day."""
NUMBERS, CALENDAR, SPREADSHEET = "numbers", "calendar", "spreadsheet"
_LENGTHS = (8, 12, 14)
"""Digits of a date, of a minute and of a second of the calendar."""
UNIX = {"unix s": 1.0, "unix ms": 1e-3, "unix us": 1e-6, "unix ns": 1e-9}
"""Seconds of what is counted since 1970."""
FORMATS = (NUMBERS, CALENDAR, SPREADSHEET, *UNIX)


@dataclass(frozen=True, eq=False)
class Read:
    """A column of numbers read as moments."""

    seconds: Array
    """Since 1970."""
    name: str
    """One of FORMATS."""
    utc: bool
    """False: by the clock on the wall."""


def as_moments(values: Array, wanted: str | None, per_unit: float | None, where: str) -> Read | None:
    """The moments that a column of numbers (N,) stands for; None where it counts time units.

    `wanted` is the reading that the project names, `per_unit` the seconds of the unit that it declares, None where it
    declares none. Raises DataError where the numbers do not fit what is wanted, or could be either.
    """
    if wanted == NUMBERS:
        return None
    known = values[np.isfinite(values)]
    if wanted is not None and wanted in READINGS:
        if not _plausible(READINGS[wanted], known):
            raise DataError(f"{where}: {known[0]:.15g} is no time as {wanted!r} (data.time_format); correct that key")
        return Read(READINGS[wanted](values), wanted, wanted in UNIX)
    chosen = next((name for name, read in READINGS.items() if _plausible(read, known)), None)
    if chosen is None or (chosen == SPREADSHEET and np.median(np.diff(known)) > levels.SERIAL_STEP):
        return None
    sure = per_unit in (None, UNIX[chosen]) if chosen in UNIX else chosen == CALENDAR or _counts_no_units(known)
    if not sure:
        raise DataError(_either(where, known, chosen, per_unit))
    return Read(READINGS[chosen](values), chosen, chosen in UNIX)


def _counts_no_units(known: Array) -> bool:
    """Are the steps no round numbers, as those of a count are and those of serial days are not?"""
    millionths = np.unique(np.diff(known)) * 1e6
    return bool(np.any(np.abs(millionths - np.round(millionths)) > levels.ROUND_STEP))


def _either(where: str, known: Array, chosen: str, per_unit: float | None) -> str:
    low, high = float(known.min()), float(known.max())
    moments = [f"{datetime.fromtimestamp(s, UTC):%Y-%m-%d %H:%M:%S}" for s in READINGS[chosen](np.array([low, high]))]
    return (
        f"{where}: {low:.15g} to {high:.15g} can be {moments[0]} to {moments[1]} ({chosen}), or "
        f"{(high - low) * (per_unit or 1.0):.6g} s as a count of the time unit: set data.time_format to {chosen!r} or "
        f"{NUMBERS!r}"
    )


def _plausible(read: Callable[[Array], Array], known: Array) -> bool:
    """Do all numbers give moments of our time?"""
    first, last = (datetime(year, 1, 1, tzinfo=UTC).timestamp() for year in levels.YEARS)
    seconds = read(known)
    return bool(known.size > 1 and np.all((seconds >= first) & (seconds < last)))


def _calendar(values: Array) -> Array:
    """Seconds of numbers such as 20240301001500, 202403010015 and 20240301; NaN where the digits are no date."""
    known = np.isfinite(values)
    digits = np.floor(np.log10(np.where(known, np.maximum(np.abs(values), 1.0), 1.0))) + 1
    length = int(digits[known][0]) if known.any() else 0
    if length not in _LENGTHS or np.any(values[known] % 1 != 0):
        return np.full(values.shape, np.nan)
    known &= digits == length
    padded = np.where(known, values, 0.0).astype(np.int64) * 10 ** (14 - length)
    parts = [padded // 10**k % 100 for k in (0, 2, 4, 6, 8)]
    second, minute, hour, day, month = parts
    year = padded // 10**10
    good = (month >= 1) & (month <= 12) & (day >= 1) & (hour < 24) & (minute < 60) & (second < 60)
    good &= (year >= 1900) & (year < 2200) & known
    months = (12 * (np.where(good, year, 1970) - 1970) + np.where(good, month, 1) - 1).astype("datetime64[M]")
    days = months.astype("datetime64[D]") + (np.where(good, day, 1) - 1)
    good &= days.astype("datetime64[M]") == months
    seconds = days.astype("datetime64[s]").astype(float) + 3600 * hour + 60 * minute + second
    return np.where(good, seconds, np.nan)


def _spreadsheet(values: Array) -> Array:
    """Seconds of serial days, rounded to what so many digits hold."""
    return np.asarray(np.round((values - _EPOCH) * _DAY, 3))


def _since_1970(unit: float) -> Callable[[Array], Array]:
    return lambda values: values * unit


READINGS: Mapping[str, Callable[[Array], Array]] = {
    CALENDAR: _calendar,
    SPREADSHEET: _spreadsheet,
    **{name: _since_1970(unit) for name, unit in UNIX.items()},
}
