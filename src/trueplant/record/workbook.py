"""Sheets of Excel workbooks as tables."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from trueplant.errors import DataError
from trueplant.record.header import Cells, with_header
from trueplant.record.source import Source
from trueplant.record.table import Table
from trueplant.record.text import looks_like_data
from trueplant.record.types import Finding, Kind

if TYPE_CHECKING:
    import polars as pl


def read_workbook(source: Source) -> Table:
    """The sheet that was named, else the first. Raises DataError where there is none, or no rows of numbers in it."""
    import fastexcel
    import polars as pl

    try:
        book = fastexcel.read_excel(source.data)
    except Exception as error:
        reason = str(error).splitlines()[0]
        raise DataError(f"{source.name} is not a readable Excel workbook ({reason}); save it as XLSX again") from None
    names, sheet = list(book.sheet_names), source.sheet
    if sheet is not None and sheet not in names:
        raise DataError(f"{source.name} has no sheet {sheet!r}; it has: {', '.join(names)}")
    chosen = sheet if sheet is not None else names[0]
    notes: tuple[Finding, ...] = ()
    if sheet is None and len(names) > 1:
        message = f"{source.name}: sheet {chosen!r} was read, the first of {len(names)}; name another one in `sheet`."
        notes = (Finding(Kind.SHEET, source.name, message),)
    frame = book.load_sheet(chosen, header_row=None, skip_rows=0, dtypes="string").to_polars()
    # as text, numbers come rounded to nine decimals
    exact = book.load_sheet(chosen, header_row=None, skip_rows=0, dtypes="float").to_polars()
    frame = pl.DataFrame([_exact(frame[c], exact[c]) for c in frame.columns])
    numbered = frame.with_row_index("line", offset=1).filter(~pl.all_horizontal(pl.exclude("line").is_null()))
    frame = numbered.drop("line")
    rows = [["" if c is None else c for c in row] for row in frame.head(100).rows()]
    first = next(
        (k for k, row in enumerate(rows) if sum(map(looks_like_data, row)) >= 1 and sum(map(bool, row)) > 1), None
    )
    if first is None:
        raise DataError(f"{source.name}, sheet {chosen!r}: no rows of numbers; name the right sheet in `sheet`")
    lines = numbered["line"].to_numpy()[first:].astype(np.int64)
    return with_header(Cells(rows[:first], frame[first:], lines, notes=notes), source)


def _exact(text: pl.Series, value: pl.Series) -> pl.Series:
    """Cells as text, those that are numbers in full precision."""
    import polars as pl

    if value.dtype != pl.Float64:
        return text
    number = text.cast(pl.Float64, strict=False).is_not_null() & value.is_not_null()
    return value.cast(pl.String).zip_with(number, text).alias(text.name)
