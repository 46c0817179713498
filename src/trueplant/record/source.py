"""The bytes of a data file on their way to a table."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

from trueplant.errors import DataError
from trueplant.files import opened
from trueplant.record import levels

if TYPE_CHECKING:
    from trueplant.record.table import Table

Wanted = Callable[["Table"], Sequence[str] | None]
"""From the first rows of a table to the names of the columns that will be used; None for all of them, as they stand."""


@dataclass(eq=False)
class Source:
    """One open file, and what the user said about it."""

    name: str
    """Without its folder, for messages."""
    file: BinaryIO = field(repr=False)
    head: bytes = field(repr=False)
    """Its first bytes."""
    separator: str | None = None
    """Between the columns of a text file; None: to be found."""
    encoding: str | None = None
    """Of a text file; None: to be found."""
    sheet: str | None = None
    """Of a workbook; None: the first."""
    most: int = levels.MOST_CELLS
    """Cells that a table may have."""
    fewest: int = 2
    """Columns of a text file; with less it was cut at the wrong character."""
    wanted: Wanted | None = None
    """None: all columns."""
    say: Callable[[str], None] = field(default=lambda what: None, repr=False)
    """Told how far reading is."""
    _digest: Any = field(default_factory=hashlib.sha256, init=False, repr=False)

    @cached_property
    def data(self) -> bytes:
        """All of the file."""
        self.file.seek(0)
        content = self.file.read()
        self._digest = hashlib.sha256(content)
        return content

    @property
    def sha256(self) -> str:
        """Of all that was read, in hexadecimal digits."""
        return str(self._digest.hexdigest())

    @property
    def ending(self) -> str:
        """Such as ".csv", in lower case."""
        return Path(self.name).suffix.lower()

    def blocks(self) -> Iterator[bytes]:
        """The file in pieces of whole lines, with all lines of a quotation in one of them."""
        size = self.file.seek(0, 2)
        self.file.seek(0)
        self._digest = hashlib.sha256()
        kept: list[bytes] = []
        odd = False
        while piece := self.file.read(levels.BLOCK_BYTES):
            self._digest.update(piece)
            self.say(f"reading {self.name}, {100 * self.file.tell() / max(size, 1):.0f} %")
            odd ^= piece.count(b'"') % 2 == 1
            kept.append(piece)
            end = -1 if odd else piece.rfind(b"\n")
            if end >= 0 and piece.count(b'"', end) % 2 == 0:
                yield b"".join([*kept[:-1], piece[: end + 1]])
                kept = [piece[end + 1 :]]
        if rest := b"".join(kept):
            yield rest

    def within_limit(self, rows: int, columns: int) -> None:
        """Raise DataError for a table that would take all memory to read."""
        if rows * columns > self.most:
            raise DataError(
                f"{self.name} has {rows:,} rows of {columns:,} columns, and {self.most:,} cells are the most that are "
                "read: leave out columns that are not used or split it, or set data.max_samples if that is meant"
            )

    def columns(self, start: Table) -> Sequence[str] | None:
        """The names of the columns to read, given the first rows; None for all of them, as they stand."""
        return None if self.wanted is None else self.wanted(start)


@contextmanager
def source_of(path: str | Path, **said: Any) -> Iterator[Source]:
    """An open file; `said` are the fields of `Source` after `head`.

    Raises DataError (what to do) where it is missing, empty, no file or cannot be read.
    """
    with opened(Path(path), DataError) as file:
        head = file.read(levels.HEAD_BYTES)
        if not head.strip() and not file.read().strip():
            raise DataError(f"{Path(path).name} is empty; export the data again")
        yield Source(Path(path).name, file, head, **said)
