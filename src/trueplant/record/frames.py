"""Frames and arrays in memory as tables."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from trueplant.errors import DataError
from trueplant.record.table import Table, check_names

if TYPE_CHECKING:
    import polars as pl


def as_table(data: Any, name: str) -> Table:
    """A polars or pandas frame, or a mapping of names to arrays, as a Table."""
    import polars as pl

    try:
        if isinstance(data, pl.LazyFrame):
            data = data.collect()
        if isinstance(data, pl.DataFrame):
            frame = data
        elif isinstance(data, Mapping):
            frame = pl.DataFrame([_series(str(k), v) for k, v in data.items()])
        elif hasattr(data, "columns") and hasattr(data, "index"):
            frame = _from_pandas(data, name)
        else:
            raise DataError(f"{name}: a {type(data).__name__} is not a table; give a path, a frame or a dict of arrays")
    except pl.exceptions.PolarsError as error:
        raise DataError(f"{name}: the columns do not form a table ({str(error).splitlines()[0]})") from None
    if frame.height == 0:
        raise DataError(f"{name} has no rows; give a frame with data")
    digest = hashlib.sha256()
    for series in frame.iter_columns():
        digest.update(series.name.encode())
        digest.update(
            np.ascontiguousarray(series.to_numpy()).tobytes()
            if series.dtype.is_numeric()
            else "\n".join(map(str, series.to_list())).encode()
        )
    check_names(frame.columns, name)
    return Table(tuple(frame.columns), frame, name, digest.hexdigest())


def _series(name: str, values: Any) -> pl.Series:
    import polars as pl

    array = np.asarray(values)
    if array.ndim != 1:
        raise DataError(f"column {name!r} has shape {array.shape}; give one value for each sample")
    return pl.Series(name, values if array.dtype.kind == "O" else array, strict=False)


def _from_pandas(data: Any, name: str) -> pl.DataFrame:
    import polars as pl

    labels = [str(c) for c in data.columns]
    repeated = [n for n, k in Counter(labels).items() if k > 1]
    if repeated:
        raise DataError(f"{name} has the column {repeated[0]!r} more than once; rename one of them")
    columns = [_pandas_series(label, data[c]) for label, c in zip(labels, data.columns, strict=True)]
    index = data.index
    # a plain row number says nothing; any other index is most likely the time
    if type(index).__name__ != "RangeIndex":
        label = str(index.name) if index.name is not None else "time"
        if label not in labels:
            columns.insert(0, _pandas_series(label, index.to_series()))
    return pl.DataFrame(columns)


def _pandas_series(name: str, series: Any) -> pl.Series:
    import polars as pl

    if getattr(series.dtype, "tz", None) is not None:
        naive = series.dt.tz_convert("UTC").dt.tz_localize(None).to_numpy()
        return pl.Series(name, naive).cast(pl.Datetime("us")).dt.replace_time_zone("UTC")
    values = series.to_numpy()
    if values.dtype.kind in "OTUS":
        return pl.Series(name, [None if v is None or v != v else v for v in values.tolist()], strict=False)
    return pl.Series(name, values)
