"""Columns of a text file put together from its blocks: numbers become numbers at once, as text takes more memory."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import polars as pl

Lines = NDArray[np.int64] | range
"""Line in the file of each row."""


class Pieces:
    """Collects the blocks of a table; as text throughout if `as_text`."""

    def __init__(self, names: Sequence[str], as_text: bool) -> None:
        self.names, self.as_text, self.rows = tuple(names), as_text, 0
        self._columns: list[list[pl.Series]] = [[] for _ in names]
        self._dots = [False for _ in names]
        self._lines: list[Lines] = []

    def add(self, frame: pl.DataFrame, lines: Lines) -> None:
        """One block, all of it text."""
        import polars as pl

        self.rows += len(lines)
        self._lines.append(lines)
        for k, text in enumerate(frame.iter_columns()):
            numbers = text if self.as_text else text.cast(pl.Float64, strict=False)
            if not self.as_text and numbers.null_count() == text.null_count():
                self._dots[k] = self._dots[k] or bool(text.str.contains(".", literal=True).any())
                self._columns[k].append(numbers)
            else:
                self._columns[k].append(text)

    @property
    def columns(self) -> list[pl.Series]:
        """All pieces, text or numbers."""
        return [piece for pieces in self._columns for piece in pieces]

    @property
    def dots(self) -> bool:
        """Has a number that was recognised a decimal point?"""
        return any(self._dots)

    def misread(self, decimal: str) -> bool:
        """Would numbers with a point mean something else beside the words of their column?"""
        mixed = (len({piece.dtype for piece in pieces}) > 1 for pieces in self._columns)
        return decimal == "," and any(dots and both for dots, both in zip(self._dots, mixed, strict=True))

    def frame(self) -> pl.DataFrame:
        """All blocks in one; a column is numbers if all of it is. What was collected is given away."""
        import polars as pl

        whole = {}
        for name, pieces in zip(self.names, self._columns, strict=True):
            numbers = all(piece.dtype == pl.Float64 for piece in pieces)
            whole[name] = pl.concat([p if numbers else p.cast(pl.String) for p in pieces], rechunk=True)
            pieces.clear()
        return pl.DataFrame(whole)

    def lines(self) -> Lines:
        """Of all rows."""
        first, last = self._lines[0], self._lines[-1]
        if all(isinstance(lines, range) for lines in self._lines) and last[-1] - first[0] + 1 == self.rows:
            return range(int(first[0]), int(last[-1]) + 1)
        return np.concatenate([np.asarray(lines, dtype=np.int64) for lines in self._lines])
