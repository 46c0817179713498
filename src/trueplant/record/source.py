"""The bytes of a data file on their way to a table."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

from trueplant.errors import DataError
from trueplant.files import contents
from trueplant.record import levels


@dataclass(frozen=True, eq=False)
class Source:
    """One file as it lies on disk, and what the user said about it."""

    name: str
    """Without its folder, for messages."""
    data: bytes = field(repr=False)
    separator: str | None = None
    """Between the columns of a text file; None: to be found."""
    sheet: str | None = None
    """Of a workbook; None: the first."""
    most: int = levels.MOST_CELLS
    """Cells that a table may have."""

    @cached_property
    def sha256(self) -> str:
        """Of the bytes, in hexadecimal digits."""
        return hashlib.sha256(self.data).hexdigest()

    @property
    def ending(self) -> str:
        """Such as ".csv", in lower case."""
        return Path(self.name).suffix.lower()

    def within_limit(self, rows: int, columns: int) -> None:
        """Raise DataError for a table that would take all memory to read."""
        if rows * columns > self.most:
            raise DataError(
                f"{self.name} has {rows:,} rows of {columns:,} columns, and {self.most:,} cells are the most that are "
                "read: leave out columns that are not used or split it, or set data.max_samples if that is meant"
            )


def source_of(
    path: str | Path, separator: str | None = None, sheet: str | None = None, most: int = levels.MOST_CELLS
) -> Source:
    """The bytes of a file. Raises DataError (what to do) where it is missing, empty, no file or cannot be read."""
    file = Path(path)
    data = contents(file, DataError)
    if not data.strip():
        raise DataError(f"{file.name} is empty; export the data again")
    return Source(file.name, data, separator, sheet, most)
