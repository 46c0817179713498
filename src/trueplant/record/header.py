"""The header of a table of text: names and units among the lines above the data."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from trueplant.errors import DataError
from trueplant.record.table import check_names
from trueplant.record.types import Finding, Kind

if TYPE_CHECKING:
    import polars as pl


@dataclass(frozen=True, eq=False)
class Header:
    """What the lines above the data say of its columns."""

    names: tuple[str, ...]
    places: tuple[int, ...]
    """Place of each in the rows: columns without name and content are no columns."""
    units: dict[str, str]

    def frame_of(self, frame: pl.DataFrame) -> pl.DataFrame:
        """All fields of the rows, as the columns that have names."""
        kept = frame.select([frame.columns[k] for k in self.places])
        return kept.rename(dict(zip(kept.columns, self.names, strict=True)))


def header_of(head: Sequence[Sequence[str]], frame: pl.DataFrame, source: str) -> Header:
    """The header of rows of text cells, given the lines above them. Raises DataError where no names fit."""
    names, units = _names_and_units(head, frame, source)
    empty = [k for k, n in enumerate(names) if not n and frame.to_series(k).null_count() == frame.height]
    places = tuple(k for k in range(frame.width) if k not in empty)
    shown = tuple(names[k] or f"column {k + 1}" for k in places)
    check_names(shown, source)
    return Header(shown, places, units)


def decimal_note(source: str, decimal: str, guessed: bool) -> tuple[Finding, ...]:
    """What there is to say of a decimal mark that was guessed."""
    if not guessed:
        return ()
    message = (
        f"{source}: numbers such as 1,234 can be read in two ways; "
        f"the comma was taken as {'the decimal mark' if decimal == ',' else 'a thousands separator'}."
    )
    return (Finding(Kind.DECIMAL, source, message),)


def _names_and_units(
    head: Sequence[Sequence[str]], frame: pl.DataFrame, source: str
) -> tuple[list[str], dict[str, str]]:
    """A name for each column, empty where there is none, and the units of the rows below the names."""
    width = frame.width
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
