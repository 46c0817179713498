"""The header of a table of text: names and units among the lines above the data, and the decimal mark."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from trueplant.errors import DataError
from trueplant.record.numbers import decimal_mark
from trueplant.record.source import Source
from trueplant.record.table import Table, named
from trueplant.record.types import Finding, Kind

if TYPE_CHECKING:
    import polars as pl


@dataclass(frozen=True, eq=False)
class Cells:
    """A file cut into cells of text."""

    head: Sequence[Sequence[str]]
    """The lines above the data."""
    frame: pl.DataFrame
    """All rows of data as text."""
    lines: NDArray[np.int64]
    """Line in the file of each row of `frame`."""
    separator: str | None = None
    encoding: str | None = None
    notes: tuple[Finding, ...] = ()


def with_header(cells: Cells, source: Source) -> Table:
    """The table of a file of text cells. Raises DataError where no names fit its columns."""
    frame, width, notes = cells.frame, cells.frame.width, cells.notes
    names, units = _names_and_units(cells, source.name)
    empty = [k for k, n in enumerate(names) if not n and frame.to_series(k).null_count() == frame.height]
    kept = [k for k in range(width) if k not in empty]
    frame = frame.select([frame.columns[k] for k in kept])
    names = [names[k] or f"column {k + 1}" for k in kept]
    decimal, guessed = decimal_mark(frame, cells.separator)
    if guessed:
        message = (
            f"{source.name}: numbers such as 1,234 can be read in two ways; "
            f"the comma was taken as {'the decimal mark' if decimal == ',' else 'a thousands separator'}."
        )
        notes = (*notes, Finding(Kind.DECIMAL, source.name, message))
    return Table(
        tuple(names),
        named(frame, names, source.name),
        source.name,
        source.sha256,
        lines=cells.lines,
        decimal=decimal,
        separator=cells.separator,
        encoding=cells.encoding,
        units=units,
        notes=notes,
    )


def _names_and_units(cells: Cells, source: str) -> tuple[list[str], dict[str, str]]:
    """A name for each column, empty where there is none, and the units of the rows below the names."""
    head, frame, width = cells.head, cells.frame, cells.frame.width
    filled = max((k + 1 for k, c in enumerate(frame.iter_columns()) if c.null_count() < frame.height), default=width)
    rows = [row for row in head if filled <= len(row) <= width]
    plain = [r for r in rows if not r[0].lstrip().startswith(("#", "//", "% "))]
    if not plain and rows:
        plain = [[rows[-1][0].lstrip("#/% "), *rows[-1][1:]]]
    if not plain:
        first = ", ".join(str(c) for c in frame.row(0))[:60]
        if head and len(head[-1]) > 1:
            hint = "; if these are decimal commas, export with ; between the columns" if width > len(head[-1]) else ""
            raise DataError(
                f"{source}: {len(head[-1])} names in the header, but {width} fields in each row ({first}); give each "
                f"column one name{hint}"
            )
        raise DataError(
            f"{source} has no header: its first row is already data ({first}); put a line with the column names on top"
        )
    most = max(sum(bool(c.strip()) for c in row) for row in plain)
    at = next(k for k, row in enumerate(plain) if sum(bool(c.strip()) for c in row) >= most)
    names = [c.strip() for c in plain[at]] + [""] * (width - len(plain[at]))
    units: dict[str, str] = {}
    for row in plain[at + 1 :]:
        units |= {n: c.strip() for n, c in zip(names, row, strict=False) if n and c.strip()}
    return names, units
