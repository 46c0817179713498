"""What to exclude so that only the usable stretches of the records are left."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime
from typing import Any

from trueplant.calendar import Calendar, unit_seconds
from trueplant.project import levels
from trueplant.project.project import Project
from trueplant.result import Check

Span = tuple[float, float]


def all_but_usable(project: Project, found: Check) -> list[dict[str, Any]]:
    """Entries for data.exclude: all of the records but `found.usable`, as far as it is not excluded already.

    In time stamps with their offset where the record has them, else in the time unit of the data.
    """
    entries = []
    for one in found.data:
        h = one.sample_time
        keep = [(s.start - h / 2, s.end + h / 2) for s in found.usable or () if s.experiment == one.name]
        gone = [(x.start - h, x.end + h) for x in one.excluded if x.reason == "excluded"]
        named = {"file": one.name} if len(found.data) > 1 else {}
        for start, end in _outside([*keep, *gone], one.span):
            beside = max((b - a for a, b in keep if a == end or b == start), default=0.0)
            if end - start > max(h, levels.NO_ENTRY * beside):
                calendar = one.calendar(project.time_unit)
                ends = (moment_of(project, calendar, moment) for moment in (start, end))
                entries.append(named | dict(zip(("from", "to"), ends, strict=True)))
    return entries


def _outside(spans: Sequence[Span], whole: Span) -> list[Span]:
    """What of a stretch lies in none of the spans."""
    found, at = [], whole[0]
    for start, end in sorted(spans):
        if start > at:
            found.append((at, min(start, whole[1])))
        at = max(at, end)
    if at < whole[1]:
        found.append((at, whole[1]))
    return found


def moment_of(project: Project, calendar: Calendar, time: float) -> datetime | float | int:
    """A time of a record as the project file names it: a time stamp where the record has them, else a number."""
    stamp = calendar.stamp(time)
    if stamp is not None:
        return datetime.fromisoformat(stamp)
    value = time * unit_seconds(project.time_unit) / unit_seconds(project.data.time_unit or project.time_unit)
    return int(value) if value == int(value) else float(f"{value:.12g}")


def time_of(project: Project, calendar: Calendar, moment: datetime | float, late: bool = False) -> float:
    """The time of a record that a project file names; `late` as in `Calendar.time`. Raises what that raises."""
    if isinstance(moment, datetime):
        return calendar.time(moment, late)
    return moment * unit_seconds(project.data.time_unit or project.time_unit) / unit_seconds(project.time_unit)
