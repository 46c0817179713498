"""Parquet files as tables."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING

from trueplant.errors import DataError
from trueplant.record import levels
from trueplant.record.guard import foreign
from trueplant.record.source import Source
from trueplant.record.table import Table, check_names

if TYPE_CHECKING:
    import polars as pl


def read_parquet(source: Source) -> Table:
    """The columns of a Parquet file that are wanted, of any type.

    Raises DataError where it is damaged, too large or has no rows.
    """
    with foreign(f"{source.name} is not a readable Parquet file", "export it again"):
        names, frame = _read(source)
    if frame.height == 0:
        raise DataError(f"{source.name} has columns but no rows; export the data again")
    return Table(names, frame, source.name, source.sha256)


def _read(source: Source) -> tuple[tuple[str, ...], pl.DataFrame]:
    """The names of all columns, and those columns that are wanted."""
    import polars as pl

    whole = pl.scan_parquet(io.BytesIO(source.data))
    names = tuple(whole.collect_schema())
    check_names(names, source.name)
    rows = int(whole.select(pl.len()).collect().item())
    start = pl.read_parquet(io.BytesIO(source.data), n_rows=levels.START_ROWS)
    wanted = source.columns(Table(names, start, source.name))
    used = [name for name in names if wanted is None or name in wanted]
    source.within_limit(rows, len(used))
    columns = []
    for name in used:
        source.say(f"reading {name} of {source.name}")
        columns.append(pl.read_parquet(io.BytesIO(source.data), columns=[name]).to_series())
    return names, pl.DataFrame(columns)
