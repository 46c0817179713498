"""A record's columns as plain text under other names: numbers as they were read, words and time stamps neutral."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from trueplant.arrays import Array, BoolArray
from trueplant.record.layout import Channel, Layout
from trueplant.record.long import bad_quality
from trueplant.record.modes import read_modes
from trueplant.record.read import in_time, wanted_columns
from trueplant.record.readers import read_table
from trueplant.record.table import Table

if TYPE_CHECKING:
    import polars as pl

TIME = "time"
"""The column of the time in what is written."""
NOT_A_NUMBER = "Bad"
"""What stands where a word stood instead of a number."""


@dataclass(frozen=True, eq=False)
class PlainRecord:
    """The columns of a layout, in order of time."""

    t: Array
    """(N,) in the project's time unit, from `start` on where there are time stamps."""
    start: datetime | None
    """The moment of t = 0, in UTC where the zone is known; None for numeric time."""
    zone: str | None
    columns: Mapping[str, list[str]]
    """The cells of each column as text, by its new name."""

    def frame(self, first: list[str]) -> pl.DataFrame:
        """As a table of text, with these cells in the column of the time."""
        import polars as pl

        return pl.DataFrame({TIME: first, **self.columns}, schema_overrides=dict.fromkeys(self.columns, pl.String))


def plain_record(path: str | Path, layout: Layout, names: Mapping[str, str]) -> PlainRecord:
    """Read a record for a layout; `names` are the new ones of its columns of numbers, by the old ones.

    Modes and qualities get a column for each channel: ``MODE1``, ``STATUS_PV1``, ``STATUS_OP1``. Raises DataError.
    """
    said = {"separator": layout.separator, "encoding": layout.encoding, "sheet": layout.sheet, "most": layout.most}
    table = read_table(path, wanted=partial(wanted_columns, layout), **said)
    found, times = in_time(table, layout)
    table, rows = found.table, found.rows
    columns = {new: _numbers(table, old, rows) for old, new in names.items()}
    for name, channel in _channels(layout):
        if channel.status is not None:
            columns[f"STATUS_{name}"] = _words(~bad_quality(table, channel.status)[rows], "Good", "Bad")
    for j, channel in enumerate(layout.inputs, start=1):
        if channel.mode is not None:
            modes = read_modes(table, rows, channel.mode, channel.automatic_values)
            columns[f"MODE{j}"] = _words(modes.automatic, "AUTO", "MAN")
    return PlainRecord(found.t, times.start, times.zone, columns)


def _channels(layout: Layout) -> list[tuple[str, Channel]]:
    outputs = [(f"PV{i}", channel) for i, channel in enumerate(layout.outputs, start=1)]
    return outputs + [(f"OP{j}", channel) for j, channel in enumerate(layout.inputs, start=1)]


def _numbers(table: Table, column: str, rows: np.ndarray) -> list[str]:
    """The cells of a column, in as many digits as they need; empty where there is nothing."""
    values, words = table.numbers(column)
    cells = ["" if x != x else repr(x) for x in values[rows].tolist()]
    for k in np.flatnonzero(words[rows]):
        cells[k] = NOT_A_NUMBER
    return cells


def _words(told: BoolArray, yes: str, no: str) -> list[str]:
    return [yes if one else no for one in told.tolist()]
