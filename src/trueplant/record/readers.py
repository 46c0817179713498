"""Every file format that is read, in one table: a reader of another one is a file of its own and a line here.

A reader takes a `Source` and gives a `Table`: names, and a polars frame whose text columns are taken for numbers later.
It raises DataError with file, place and remedy for what it cannot read.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from trueplant.errors import DataError
from trueplant.record.parquet import read_parquet
from trueplant.record.source import Source, source_of
from trueplant.record.table import Table
from trueplant.record.text import read_text
from trueplant.record.workbook import read_workbook

COMPRESSED = (b"\x1f\x8b", b"BZh", b"\xfd7zXZ", b"7z\xbc\xaf")
"""First bytes of gzip, bzip2, xz and 7z."""


@dataclass(frozen=True)
class Format:
    """How a file format is recognised, and who reads it."""

    endings: tuple[str, ...]
    """Of file names, in lower case, with the dot."""
    read: Callable[[Source], Table]
    begins: tuple[bytes, ...] = ()
    """What its files begin with, one of these. They are then recognised whatever they are called, and a file that only
    is called so is refused. Empty: the ending decides."""


FORMATS: dict[str, Format] = {
    "Parquet": Format((".parquet", ".pq"), read_parquet, (b"PAR1",)),
    "Excel": Format((".xlsx", ".xlsm", ".xls"), read_workbook, (b"PK\x03\x04", b"\xd0\xcf\x11\xe0")),
}
"""By name. What is none of these is read as text (CSV, TXT)."""


def read_table(path: str | Path, **said: Any) -> Table:
    """Read a file of any of the `FORMATS`, or text, as raw columns.

    `said` are fields of `Source`: the separator or sheet, the most cells, the columns that are wanted. Of a text file
    separator, decimal mark, encoding and header are found. Raises DataError (file, line, what to do) when the file is
    missing, empty, not a table, or ragged.
    """
    with source_of(path, **said) as source:
        for known in FORMATS.values():
            if source.head.startswith(known.begins) if known.begins else source.ending in known.endings:
                return known.read(source)
        if source.head.startswith(COMPRESSED):
            raise DataError(f"{source.name} is compressed; unpack it first")
        if any(source.ending in known.endings for known in FORMATS.values()):
            ending = Path(source.name).suffix
            raise DataError(f"{source.name} is not the {ending} file that its name says; export it again")
        return read_text(source)
