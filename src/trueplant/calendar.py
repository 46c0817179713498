"""The times of a record in words: calendar time where it has time stamps, in its zone, else numbers with their unit."""

from __future__ import annotations

import difflib
import zoneinfo
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta, timezone, tzinfo
from typing import TypeAlias

import numpy as np

from trueplant.arrays import Array
from trueplant.errors import DataError

SECONDS = {"ms": 1e-3, "s": 1.0, "sec": 1.0, "min": 60.0, "h": 3600.0, "hr": 3600.0, "d": 86400.0}
"""Length of each time unit."""
Axis: TypeAlias = Sequence[float | None] | Array | list[str | None]
"""Values of a figure's axis of time; None or NaN is a break."""
_NEAR_ZONE = 0.5
"""Similarity (difflib) from which a zone is offered as "did you mean": lower than the library's default, as the names
share a continent."""
_QUARTER = 900
"""Seconds: offsets from UTC change at whole quarters of an hour only."""


def unit_seconds(unit: str) -> float:
    """Seconds in a time unit. Raises DataError for an unknown one."""
    if unit not in SECONDS:
        raise DataError(f"unknown time unit {unit!r}; use one of: ms, s, min, h, d")
    return SECONDS[unit]


def zone_of(name: str) -> tzinfo:
    """The zone of a name such as Europe/Oslo, or of an offset from UTC such as +01:00. Raises DataError."""
    try:
        return datetime.strptime(name, "%z").tzinfo or UTC if name[:1] in ("+", "-") else zoneinfo.ZoneInfo(name)
    except (zoneinfo.ZoneInfoNotFoundError, ValueError, OSError):
        near = difflib.get_close_matches(name, zoneinfo.available_timezones(), n=3, cutoff=_NEAR_ZONE)
        hint = f"did you mean {' or '.join(near)}?" if near else "use a name such as Europe/Berlin or UTC"
        raise DataError(f"unknown time zone {name!r}; {hint}") from None


def moment_in(at: datetime, zone: str | None) -> datetime:
    """A moment in UTC; one without an offset is by the clock of the zone.

    Raises DataError without a zone, for one that is unknown, and for a moment that its clock skips.
    """
    if at.tzinfo is None:
        if zone is None:
            raise DataError(f"{at} bears no offset from UTC: add one, as in {at.isoformat()}+00:00, or set time_zone")
        at = at.replace(tzinfo=zone_of(zone))
        if at.astimezone(UTC).astimezone(at.tzinfo).replace(tzinfo=None) != at.replace(tzinfo=None):
            clock = at.replace(tzinfo=None)
            raise DataError(f"{clock} does not exist in {zone} (the clock skips that hour): give it an offset from UTC")
    return at.astimezone(UTC)


@dataclass(frozen=True)
class Calendar:
    """How the times of a record are spoken of."""

    unit: str
    """Of its numbers."""
    start: datetime | None = None
    """The moment at time 0: in UTC, or without a zone as the clock showed it; None for numeric time."""
    zone: str | None = None
    """In which moments are shown: a name, or an offset from UTC; None: as they stand."""

    @classmethod
    def of(cls, unit: str, start: str | None, zone: str | None = None) -> Calendar:
        """From the time stamp that a result holds."""
        return cls(unit, datetime.fromisoformat(start) if start else None, zone)

    def moment(self, time: float) -> datetime | None:
        """The moment of a time, to the millisecond, in the zone; None for numeric time or one that is not finite."""
        if self.start is None or not np.isfinite(time):
            return None
        # added in UTC, where every hour is there once; the zone comes last
        at = self.start + timedelta(milliseconds=round(time * unit_seconds(self.unit) * 1e3))
        return at if self.zone is None else at.astimezone(zone_of(self.zone))

    def time(self, moment: datetime, late: bool = False) -> float:
        """The time of a moment. One without an offset is by the clock of the record; in the hour that comes twice in
        autumn it is the first one, or the second (`late`).

        Raises DataError for numeric time, for an offset where the record's own is not known, and for a moment that has
        no UTC in the years 1 to 9999.
        """
        if self.start is None:
            raise DataError(f"{moment.isoformat(' ')} is a time stamp, but the record has numbers for its time")
        if moment.tzinfo is None and self.start.tzinfo is not None:
            moment = moment.replace(tzinfo=zone_of(self.zone or "UTC"), fold=int(late))
        if moment.tzinfo is not None and self.start.tzinfo is None:
            raise DataError(
                f"{moment.isoformat(' ')} bears an offset from UTC, but the stamps of the record bear none: leave it "
                "out, or set data.time_zone"
            )
        if moment.tzinfo is not None:
            try:
                moment = moment.astimezone(UTC)
            except OverflowError:
                raise DataError(f"{moment.isoformat(' ')} is at the end of the calendar; correct it") from None
        return (moment - self.start).total_seconds() / unit_seconds(self.unit)

    def stamp(self, time: float | None) -> str | None:
        """A time stamp with its offset from UTC, such as 2024-03-31T03:15:00+02:00; None for numeric time."""
        at = None if time is None else self.moment(time)
        return None if at is None else at.isoformat(timespec="milliseconds" if at.microsecond else "seconds")

    def stamps(self, span: tuple[float, float]) -> tuple[str, str] | None:
        """Those of both ends of a stretch."""
        first, last = map(self.stamp, span)
        return None if first is None or last is None else (first, last)

    def text(self, time: float | None) -> str:
        """A time for a sentence: "2024-03-31 03:15:00 CEST", or "412.5 min"."""
        at = None if time is None else self.moment(time)
        if at is not None:
            return f"{self._clock(at)} {at.tzname() or ''}".rstrip()
        return "unknown" if time is None else f"{number(time)} {self.unit}".rstrip()

    def span(self, start: float, end: float) -> str:
        """A stretch for a sentence: what both ends share is said once."""
        if start == end:
            return self.text(start)
        first, last = self.moment(start), self.moment(end)
        if first is None or last is None:
            return f"{number(start)} to {number(end)} {self.unit}".rstrip()
        if first.tzname() != last.tzname():
            return f"{self.text(start)} to {self.text(end)}"
        until = self.text(end)
        return f"{self._clock(first)} to {until[11:] if first.date() == last.date() else until}"

    def _clock(self, at: datetime) -> str:
        """Milliseconds only where the unit of time is that short."""
        if unit_seconds(self.unit) > 1:
            at += timedelta(microseconds=500_000)
        text = at.isoformat(" ", "seconds")[:19]
        return f"{text}.{at.microsecond // 1000:03d}" if unit_seconds(self.unit) <= 1 and at.microsecond else text

    def axis(self, times: Sequence[float | None] | Array) -> Axis:
        """Times as the axis of a figure has them: what a clock on the wall showed, or the numbers themselves."""
        if self.start is None:
            return times
        t = np.array([np.nan if x is None else x for x in times], dtype=float)
        known = np.isfinite(t)
        utc = self.start.replace(tzinfo=self.start.tzinfo or UTC).timestamp()
        seconds = np.round(utc + np.where(known, t, 0.0) * unit_seconds(self.unit), 3)
        if self.zone is not None:
            zone = zone_of(self.zone)
            quarters, at = np.unique(np.floor(seconds / _QUARTER), return_inverse=True)
            offsets = [datetime.fromtimestamp(q * _QUARTER, zone).utcoffset() or timedelta() for q in quarters]
            seconds = seconds + np.array([offset.total_seconds() for offset in offsets])[at]
        whole = bool(np.all(seconds % 1 == 0))
        milli = np.round(seconds * 1e3).astype("int64").astype("datetime64[ms]")
        text = np.datetime_as_string(milli, unit="s" if whole else "ms")
        return [one.replace("T", " ") if good else None for one, good in zip(text.tolist(), known, strict=True)]

    @property
    def label(self) -> str:
        """What stands beside "Time" at an axis: the unit, or the zone."""
        return self.unit if self.start is None else self.zone or ""


def number(time: float) -> str:
    """A time with six significant digits, whole numbers in full."""
    return f"{time:.0f}" if abs(time) >= 1e5 else f"{time:.6g}"


def duration(length: float, unit: str) -> str:
    """A length of time as a person says it: in its unit, in a longer one from two of these on, or in a shorter one."""
    own = unit_seconds(unit)
    names = {86400.0: "days", 3600.0: "h", 60.0: "min", 1.0: "s", own: unit}
    fitting = (size for size in sorted(names, reverse=True) if length * own >= size * (2 if size > own else 1))
    size = next(fitting, min(names))
    return f"{float(f'{length * own / size:.3g}'):g} {names[size]}"


def offset_name(seconds: int) -> str:
    """An offset from UTC as a zone: UTC, or +01:00."""
    return "UTC" if seconds == 0 else timezone(timedelta(seconds=seconds)).tzname(None)[3:]
