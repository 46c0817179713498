"""Parquet files as tables."""

from __future__ import annotations

import io

from trueplant.errors import DataError
from trueplant.record.source import Source
from trueplant.record.table import Table, named


def read_parquet(source: Source) -> Table:
    """All columns of a Parquet file, of any type. Raises DataError where it is damaged or has no rows."""
    import polars as pl

    try:
        frame = pl.read_parquet(io.BytesIO(source.data))
    except Exception as error:  # polars reports damaged files by several classes, panics among them
        raise DataError(
            f"{source.name} is not a readable Parquet file ({str(error).splitlines()[0]}); export it again"
        ) from None
    if frame.height == 0:
        raise DataError(f"{source.name} has columns but no rows; export the data again")
    return Table(tuple(frame.columns), named(frame, frame.columns, source.name), source.name, source.sha256)
