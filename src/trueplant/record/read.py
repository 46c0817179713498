"""Read one experiment: a file or frame, and the layout that says what its columns are."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trueplant.arrays import Array, BoolArray
from trueplant.calendar import unit_seconds
from trueplant.errors import DataError
from trueplant.record import levels
from trueplant.record.frames import as_table
from trueplant.record.layout import Channel, Layout
from trueplant.record.long import bad_quality, is_long, nothing_good, to_wide
from trueplant.record.modes import read_modes
from trueplant.record.numbers import counted, no_measurements
from trueplant.record.order import put_in_order
from trueplant.record.readers import read_table
from trueplant.record.runs import spans_of
from trueplant.record.table import Table
from trueplant.record.times import Times, find_time, parse_times, partners
from trueplant.record.types import Finding, Kind, Record

Rows = NDArray[np.int64]


def read_record(
    path_or_frame: Any,
    layout: Layout,
    *,
    name: str | None = None,
    closed: bool = True,
    say: Callable[[str], None] = lambda what: None,
) -> Record:
    """Read a file of any of the `readers.FORMATS`, a polars or pandas frame, or a dict of arrays, as one experiment.

    Nothing is filled in or altered: cells without a number become NaN and are noted. `say` is told how far it is.
    Raises DataError with file, line, column and remedy for everything that cannot be used as it is.
    """
    is_file = isinstance(path_or_frame, (str, Path))
    if is_file:
        said = {"separator": layout.separator, "encoding": layout.encoding, "sheet": layout.sheet, "most": layout.most}
        table = read_table(path_or_frame, wanted=partial(wanted_columns, layout), say=say, **said)
    else:
        table = as_table(path_or_frame, name or "frame")
    if not layout.outputs or not layout.inputs:
        raise DataError(f"{table.source}: declare at least one output and one input")
    name = name or (Path(path_or_frame).stem if is_file else "frame")
    columns, times = in_time(table, layout)
    record = _record(columns, layout, name)
    source = str(path_or_frame) if is_file else ""
    return replace(
        record,
        closed=closed,
        start=times.start,
        zone=times.zone,
        source=source,
        sha256=table.sha256,
        notes=tuple(columns.notes),
    )


def wanted_columns(layout: Layout, start: Table) -> list[str] | None:
    """The columns of a table that are used, given its first rows; None where that does not show in its header."""
    used = {column for _, column in _roles(layout)} & set(start.names)
    if not used:
        return None
    try:
        time = layout.time or find_time(start, frozenset([*layout.continuous, *layout.held]))
    except DataError:
        return None
    return [*used, time, *partners(start, time)]


def in_time(table: Table, layout: Layout) -> tuple[_Columns, Times]:
    """The columns of a table, long or wide, on its rows in order of time, and what its column of time says."""
    per_unit = unit_seconds(layout.project_time_unit)
    if is_long(table, layout):
        table, times = to_wide(table, layout)
        rows, t = np.arange(len(table)), table.numbers("time")[0]
        notes = list(table.notes)
    else:
        for role, column in _roles(layout):
            table.column(column, role)
        if layout.sample_time is not None:
            raise DataError(
                f"{table.source} has a column for each signal, on a grid of its own: leave out data.sample_time and "
                "data.max_gap, which are for long exports (tag, time, value)"
            )
        used = frozenset([*layout.continuous, *layout.held])
        time = layout.time if layout.time is not None else find_time(table, used)
        if time in used:
            raise DataError(f"{table.source}: column {time!r} is named as time and as a signal; correct one of them")
        times = parse_times(table, time, layout)
        rows, ordered = put_in_order(table, times)
        t = times.seconds if _is_all(rows, len(table)) else times.seconds[rows]
        notes = [*table.notes, *times.notes, *ordered]
    _enough(table, rows)
    return _Columns(table, rows, t if per_unit == 1 else t / per_unit, notes), times


def _record(columns: _Columns, layout: Layout, name: str) -> Record:
    """The signals of the layout. Raises DataError where too few rows hold OP and a PV."""
    y = columns.numbers("pv", layout.outputs, [c.column for c in layout.outputs])
    u = columns.numbers("op", layout.inputs, [c.column for c in layout.inputs])
    y, u = columns.trusted(y, layout.outputs), columns.trusted(u, layout.inputs)
    r = columns.numbers("sp", layout.outputs, [c.sp for c in layout.outputs])
    d = columns.numbers("column", layout.disturbances, [c.column for c in layout.disturbances])
    slaves = [c for c in layout.inputs if c.slave_sp or c.slave_pv]
    automatic = np.ones(u.shape, dtype=bool)
    for j, channel in enumerate(layout.inputs):
        if channel.mode is not None:
            automatic[:, j] = columns.automatic(channel)
    usable = int(np.sum(np.isfinite(u).all(axis=1) & np.isfinite(y).any(axis=1)))
    if usable < levels.FEWEST_ROWS:
        raise DataError(
            f"{columns.table.source}: only {usable} rows hold OP and a PV at the same time; at least "
            f"{levels.FEWEST_ROWS} are needed: export a longer record"
        )
    return Record(
        name=name,
        t=columns.t,
        r=r,
        u=u,
        y=y,
        d=d,
        automatic=automatic,
        outputs=tuple(c.name for c in layout.outputs),
        inputs=tuple(c.name for c in layout.inputs),
        disturbances=tuple(c.name for c in layout.disturbances),
        time_unit=layout.project_time_unit,
        hold=tuple(c.hold or "zoh" for c in layout.inputs),
        d_hold=tuple(c.hold for c in layout.disturbances),
        slave_sp=columns.numbers("slave_sp", layout.inputs, [c.slave_sp for c in layout.inputs]) if slaves else None,
        slave_pv=columns.numbers("slave_pv", layout.inputs, [c.slave_pv for c in layout.inputs]) if slaves else None,
    )


def _roles(layout: Layout) -> list[tuple[str, str]]:
    """Every declared column with the words for what it should be."""
    named = [(f"the PV of {c.name}", c.column) for c in layout.outputs]
    named += [(f"the set-point of {c.name}", c.sp) for c in layout.outputs if c.sp]
    named += [(f"the OP of {c.name}", c.column) for c in layout.inputs]
    named += [(f"the mode of {c.name}", c.mode) for c in layout.inputs if c.mode]
    named += [(f"the status of {c.name}", c.status) for c in (*layout.outputs, *layout.inputs) if c.status]
    named += [(f"the slave's set-point of {c.name}", c.slave_sp) for c in layout.inputs if c.slave_sp]
    named += [(f"the slave's PV of {c.name}", c.slave_pv) for c in layout.inputs if c.slave_pv]
    named += [(f"disturbance {c.name}", c.column) for c in layout.disturbances]
    return named


def _enough(table: Table, rows: Rows) -> None:
    if rows.size < levels.FEWEST_ROWS:
        count = {0: "no rows", 1: "one row", 2: "two rows", 3: "three rows"}.get(rows.size, f"{rows.size} rows")
        raise DataError(
            f"{table.source} has only {count}; at least {levels.FEWEST_ROWS} are needed: export a longer record"
        )


class _Columns:
    """Columns of one table on its ordered rows; collects what there is to say about them."""

    def __init__(self, table: Table, rows: Rows, t: Array, notes: list[Finding]) -> None:
        self.table, self.rows, self.t, self.notes = table, rows, t, notes

    def numbers(self, key: str, channels: Sequence[Channel], columns: Sequence[str | None]) -> Array:
        """(N, n) values, all NaN where no column is declared."""
        out = np.full((self.rows.size, len(channels)), np.nan)
        for k, column in enumerate(columns):
            if column is not None:
                out[:, k] = self._one(column, f"{key} of {channels[k].name}" if key != "column" else channels[k].name)
        return out

    def _one(self, column: str, role: str) -> Array:
        table, rows = self.table, self.rows
        values, words = table.numbers(column)
        if not _is_all(rows, values.size):
            values, words = values[rows], words[rows]
        codes = no_measurements(values)
        what = f"{table.source}: column {column!r} ({role})"
        if words.mean() + codes.mean() > levels.MOSTLY:
            count = counted(int(words.sum() + codes.sum()), "row")
            raise DataError(
                f"{what} holds {self._seen(column, words | codes)} in {count} of {values.size} instead of a "
                "measurement; name another column, or export it again"
            )
        values[codes] = np.nan
        samples = int(np.sum(np.isfinite(values)))
        if samples == 0:
            raise DataError(f"{what} is empty; name another column or leave it out")
        for mask, kind in ((words, Kind.TEXT), (codes, Kind.CODE)):
            if mask.any():
                first = table.where(int(rows[np.argmax(mask)]))
                found = "text instead of a number" if kind == Kind.TEXT else "a number that is no measurement"
                shown = f"{self._seen(column, mask)} (first: {first})"
                message = f"{column}: {found} in {counted(int(mask.sum()), 'row')}, {shown}; counted as missing."
                spans = spans_of(self.t, mask)
                self.notes.append(Finding(kind, column, message, spans, int(mask.sum()), excludes=True))
        level = float(np.nanmin(values))
        if samples > 1 and level == np.nanmax(values):
            message = f"{column} ({role}) is constant at {level:g} throughout the record."
            self.notes.append(Finding(Kind.CONSTANT, column, message, samples=samples, value=level))
        return values

    def _seen(self, column: str, mask: BoolArray) -> str:
        """The first few different cells among the rows marked."""
        series = self.table.frame[column]
        cells = (_as_text(series[int(row)]) for row in self.rows[mask][: levels.SNIFFED_LINES])
        return ", ".join(map(repr, list(dict.fromkeys(cells))[: levels.SHOWN_WORDS]))

    def automatic(self, channel: Channel) -> BoolArray:
        """(N,) True where the mode column says automatic; a missing mode keeps the last one."""
        assert channel.mode is not None
        modes = read_modes(self.table, self.rows, channel.mode, channel.automatic_values)
        self.notes.append(modes.finding)
        return modes.automatic

    def trusted(self, values: Array, channels: Sequence[Channel]) -> Array:
        """The values (N, n), NaN where the status of their channel is not good."""
        for k, channel in enumerate(channels):
            if channel.status is not None:
                values[:, k] = np.where(self._bad(channel), np.nan, values[:, k])
        return values

    def _bad(self, channel: Channel) -> BoolArray:
        assert channel.status is not None
        bad = bad_quality(self.table, channel.status)[self.rows]
        count = int(bad.sum())
        if count == bad.size:
            raise nothing_good(self.table, channel.status, channel.column, np.ones(len(self.table), dtype=bool))
        if count:
            what = f"{channel.column}: {counted(count, 'value')} with a bad status ({self._seen(channel.status, bad)})"
            spans = spans_of(self.t, bad)
            self.notes.append(Finding(Kind.BAD_QUALITY, channel.column, f"{what} left out.", spans, count, True))
        return bad


def _is_all(rows: Rows, size: int) -> bool:
    """Are these all rows as they stand?"""
    return rows.size == size and bool(np.all(rows[1:] > rows[:-1]))


def _as_text(cell: object) -> str:
    """A cell as it may have been written."""
    return f"{cell:.15g}".replace("e+", "e") if isinstance(cell, float) else str(cell).strip()[:40]
