"""A first look at a data file: what stands in it, as far as a first project file needs to know."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from trueplant.calendar import Calendar, unit_seconds
from trueplant.errors import DataError
from trueplant.project.guess import Seen, guess_counted_unit, guess_loops, guess_time
from trueplant.record.layout import Layout
from trueplant.record.long import LongParts, long_parts
from trueplant.record.modes import read_modes
from trueplant.record.table import Table
from trueplant.record.times import find_time, parse_times


def look(
    table: Table, time: str | None = None, said: Mapping[str, str | float] | None = None, long: bool | None = None
) -> Seen:
    """What a table shows; `time` names its time column, `said` are keys of [data] that it is read by.

    `long`: does it list tags below each other; None: to be found. Raises DataError for a column that is not there, and
    for a table that cannot be long.
    """
    said = dict(said or {})
    words = {key: value for key, value in said.items() if isinstance(value, str)}
    if time is not None:
        table.column(time, "time")
    parts = None if long is False else long_parts(table, words.get("tag", "tag"), words.get("value", "value"))
    if parts is None and long:
        raise DataError(
            f"{table.source} has no columns of tags and values as a long export has: name them as `tag` and `value`. "
            f"It has: {', '.join(table.names)}"
        )
    names = table.names if parts is None else parts.tags
    if time is None:
        time = _time(table, names if parts is None else (parts.tag, parts.value))
    clock = _clock(table, time, parts, words)
    modes = {}
    for loop in guess_loops(name for name in names if name != time):
        if loop.mode:
            rows = table if parts is None else of_tag(table, parts, loop.mode)
            modes[loop.mode] = read_modes(rows, np.arange(len(rows)), loop.mode, None).finding.message
    return Seen(
        tuple(names),
        time,
        clock.stamped,
        clock.interval,
        dict(table.units) if parts is None else dict(parts.units),
        modes,
        said,
        clock.doubt,
        clock.zone,
        clock.span,
        (*(note.message for note in table.notes), *clock.notes),
        parts is not None,
    )


@dataclass(frozen=True)
class _Clock:
    """What the column of the time says; the fields of `Seen`."""

    stamped: bool | None = None
    interval: float | None = None
    doubt: str = ""
    zone: str | None = None
    span: str = ""
    notes: tuple[str, ...] = ()


def _time(table: Table, others: tuple[str, ...]) -> str:
    """The column of the time: the reader's choice where it finds one among those that belong to no loop."""
    taken = {column for loop in guess_loops(others) for column in loop.columns}
    try:
        return find_time(table, frozenset(taken))
    except DataError:
        return guess_time(table.names)


def _clock(table: Table, time: str, parts: LongParts | None, said: Mapping[str, str]) -> _Clock:
    """What the time says. Of a long export the tag that is written most often counts: a set-point is written when it
    changes."""
    rows = table if parts is None else max((of_tag(table, parts, tag) for tag in parts.tags), key=len)
    unit = said.get("time_unit") or guess_counted_unit(time)
    layout = Layout(
        (),
        (),
        time_unit=unit or "s",
        time_unit_declared="time_unit" in said,
        time_format=said.get("time_format"),
        time_zone=said.get("time_zone"),
    )
    try:
        times = parse_times(rows, time, layout)
    except DataError as error:
        return _Clock(doubt=str(error))
    seconds = np.unique(times.seconds[np.isfinite(times.seconds)])
    stamped = times.start is not None
    known = (stamped or unit is not None) and seconds.size > 1
    calendar = Calendar("s" if stamped else unit or "", times.start, times.zone)
    ends = seconds[[0, -1]] / (1.0 if stamped else unit_seconds(unit or "s"))
    return _Clock(
        stamped,
        float(np.median(np.diff(seconds))) if known else None,
        zone=times.zone,
        span=calendar.span(*ends.tolist()),
        notes=tuple(note.message for note in times.notes),
    )


def of_tag(table: Table, parts: LongParts, tag: str) -> Table:
    """The rows of one tag of a long export, its values in a column of its name."""
    import polars as pl

    frame = table.frame.filter(table.frame[parts.tag].cast(pl.String).str.strip_chars() == tag)
    values = frame[parts.value].alias(tag)
    frame = pl.DataFrame([*(frame[name] for name in frame.columns if name != tag), values])
    return dataclasses.replace(table, names=tuple(frame.columns), frame=frame, lines=None)
