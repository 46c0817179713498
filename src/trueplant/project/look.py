"""A first look at a data file: what stands in it, as far as a first project file needs to know."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import numpy as np

from trueplant.calendar import unit_seconds
from trueplant.errors import DataError
from trueplant.project.guess import Seen, guess_counted_unit, guess_loops, guess_time
from trueplant.record.layout import Layout
from trueplant.record.long import LongParts, long_parts
from trueplant.record.modes import read_modes
from trueplant.record.table import Table
from trueplant.record.times import find_time, parse_times


def look(table: Table, time: str | None = None, said: Mapping[str, str] | None = None) -> Seen:
    """What a table shows; `time` names its time column, `said` are keys of [data] that it was read by.

    Raises DataError for a time column that is not there.
    """
    if time is not None:
        table.column(time, "time")
    parts = long_parts(table)
    names = table.names if parts is None else parts.tags
    if time is None:
        time = _time(table, names if parts is None else (parts.tag, parts.value))
    stamped, interval, doubt = _clock(table, time, parts)
    modes = {}
    for loop in guess_loops(name for name in names if name != time):
        if loop.mode:
            rows = table if parts is None else _of_tag(table, parts, loop.mode)
            modes[loop.mode] = read_modes(rows, np.arange(len(rows)), loop.mode, None).finding.message
    return Seen(
        tuple(names),
        time,
        stamped,
        interval,
        dict(table.units) if parts is None else dict(parts.units),
        modes,
        dict(said or {}),
        doubt,
    )


def _time(table: Table, others: tuple[str, ...]) -> str:
    """The column of the time: the reader's choice where it finds one among those that belong to no loop."""
    taken = {column for loop in guess_loops(others) for column in loop.columns}
    try:
        return find_time(table, frozenset(taken))
    except DataError:
        return guess_time(table.names)


def _clock(table: Table, time: str, parts: LongParts | None) -> tuple[bool | None, float | None, str]:
    """Does the time bear moments, how many seconds lie between its samples, and what of it is not understood.

    Of a long export the tag that is written most often counts: a set-point is written when it changes.
    """
    rows = table if parts is None else max((_of_tag(table, parts, tag) for tag in parts.tags), key=len)
    try:
        times = parse_times(rows, time, Layout((), ()))
    except DataError as error:
        return None, None, str(error)
    steps = np.diff(np.unique(times.seconds[np.isfinite(times.seconds)]))
    stamped = times.start is not None
    unit = "s" if stamped else guess_counted_unit(time)
    if unit is None or not steps.size:
        return stamped, None, ""
    return stamped, float(np.median(steps)) * unit_seconds(unit), ""


def _of_tag(table: Table, parts: LongParts, tag: str) -> Table:
    """The rows of one tag of a long export, its values in a column of its name."""
    import polars as pl

    frame = table.frame.filter(table.frame[parts.tag].cast(pl.String).str.strip_chars() == tag)
    values = frame[parts.value].alias(tag)
    frame = pl.DataFrame([*(frame[name] for name in frame.columns if name != tag), values])
    return dataclasses.replace(table, names=tuple(frame.columns), frame=frame, lines=None)
