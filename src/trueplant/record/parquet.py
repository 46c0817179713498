"""Parquet files as tables."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING

from trueplant.errors import DataError
from trueplant.record.guard import foreign
from trueplant.record.source import Source
from trueplant.record.table import Table, named

if TYPE_CHECKING:
    import polars as pl


def read_parquet(source: Source) -> Table:
    """All columns of a Parquet file, of any type. Raises DataError where it is damaged, too large or has no rows."""
    with foreign(f"{source.name} is not a readable Parquet file", "export it again"):
        frame = _read(source)
    if frame.height == 0:
        raise DataError(f"{source.name} has columns but no rows; export the data again")
    return Table(tuple(frame.columns), named(frame, frame.columns, source.name), source.name, source.sha256)


def _read(source: Source) -> pl.DataFrame:
    import polars as pl

    whole = pl.scan_parquet(io.BytesIO(source.data))
    rows = int(whole.select(pl.len()).collect().item())
    source.within_limit(rows, len(whole.collect_schema()))
    return pl.read_parquet(io.BytesIO(source.data))
