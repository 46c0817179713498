"""Sheets of Excel workbooks as tables."""

from __future__ import annotations

import io
import re
import zipfile
from typing import IO, TYPE_CHECKING

import numpy as np

from trueplant.errors import DataError
from trueplant.record import levels
from trueplant.record.cut import is_banner, looks_like_data
from trueplant.record.guard import foreign
from trueplant.record.header import decimal_note, header_of
from trueplant.record.numbers import decimal_mark
from trueplant.record.sheets import loaded, loaded_apart
from trueplant.record.source import Source
from trueplant.record.table import Table

if TYPE_CHECKING:
    import polars as pl


def read_workbook(source: Source) -> Table:
    """The sheet that was named, else the first. Raises DataError where there is none, or no rows of numbers in it."""
    with foreign(f"{source.name} is not a readable Excel workbook", "save it as XLSX again"):
        load = loaded if _measured(source) else loaded_apart
        frame, chosen, notes = load(source.data, source.name, source.sheet)
    numbered = _with_lines(frame)
    frame = numbered.drop("line")
    rows = [["" if c is None else c for c in row] for row in frame.head(100).rows()]
    first = next((k for k in range(len(rows)) if _is_data(rows[k:])), None)
    if first is None:
        raise DataError(f"{source.name}, sheet {chosen!r}: no rows of numbers; name the right sheet in `sheet`")
    lines = numbered["line"].to_numpy()[first:].astype(np.int64)
    header = header_of(rows[:first], frame[first:], source.name)
    columns = header.frame_of(frame[first:])
    decimal, guessed = decimal_mark(columns.iter_columns(), None)
    return Table(
        header.names,
        columns,
        source.name,
        source.sha256,
        lines=lines,
        decimal=decimal,
        units=header.units,
        notes=(*notes, *decimal_note(source.name, decimal, guessed)),
    )


def _is_data(rows: list[list[str]]) -> bool:
    """Does the first of these rows begin the data?"""
    row = rows[0]
    several = any(map(looks_like_data, row)) and sum(map(bool, row)) > 1
    return several and not is_banner(row, rows[1 : 1 + levels.BANNER_LINES])


def _with_lines(frame: pl.DataFrame) -> pl.DataFrame:
    """Without its empty rows, and with the line of each."""
    import polars as pl

    return frame.with_row_index("line", offset=1).filter(~pl.all_horizontal(pl.exclude("line").is_null()))


def _measured(source: Source) -> bool:
    """Whether it is an XLSX workbook of reasonable size. Raises DataError for one that would take all memory.

    The library lays out all cells up to the farthest.
    """
    if not source.data.startswith(b"PK"):
        return False
    with zipfile.ZipFile(io.BytesIO(source.data)) as book:
        unpacked = sum(part.file_size for part in book.infolist())
        if unpacked > levels.MOST_UNPACKED:
            raise DataError(
                f"{source.name} unpacks to {unpacked / 1e9:.3g} GB, and {levels.MOST_UNPACKED / 1e9:.3g} GB are "
                "the most that are read of a workbook: export it as CSV or Parquet"
            )
        for part in book.infolist():
            if part.filename.endswith(".xml"):  # a sheet may have any name
                with book.open(part) as sheet:
                    _check_sheet(source, part.filename, sheet)
        return "xl/workbook.xml" in book.namelist()


def _check_sheet(source: Source, name: str, sheet: IO[bytes]) -> None:
    """Raise DataError for cells too far away, ValueError for places that are none: the library trusts them all."""
    row, column, left = 0, 0, b""
    while piece := sheet.read(1 << 22):
        for place in set(_PLACE.findall(left + piece)):
            found = _REFERENCE.fullmatch(place)
            if found is None:
                raise ValueError(f"{place[:20].decode(errors='replace')!r} is no place of a cell")
            row = max(row, int(found["row"]))
            column = max(column, _column(found["column"] or b""))
        left = piece[-256:]
        if row * column > levels.MOST_SHEET_CELLS:
            raise DataError(
                f"{source.name} ({name}) has cells as far as row {row:,} and column {column:,}, and "
                f"{levels.MOST_SHEET_CELLS:,} cells are the most that are read of a sheet: delete stray cells far from "
                "the data, or export it as CSV or Parquet"
            )


_PLACE = re.compile(rb"""<(?:\w+:)?(?:c|row|dimension)\b[^<>]{0,200}?\s(?:r|ref)\s*=\s*["']([^"'<>]*)["']""")
_REFERENCE = re.compile(rb"(?:[A-Z]{1,3}\d{1,7}:)?(?P<column>[A-Z]{1,3})?(?P<row>\d{1,7})")


def _column(letters: bytes) -> int:
    """Number of the column A, B, ... XFD."""
    number = 0
    for letter in letters:
        number = 26 * number + letter - 64
    return number
