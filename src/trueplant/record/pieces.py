"""Columns of a text file put together from its blocks.

Numbers, and stamps that can be read in one way only, become that at once: as text they take several times the memory.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import polars as pl

Lines = NDArray[np.int64] | range
"""Line in the file of each row."""


_ISO = {f"%Y-%m-%d{t}%H:%M:%S%.f": rf"\d{{4}}-\d\d-\d\d{t}\d\d:\d\d:\d\d(\.\d+)?" for t in " T"}
"""Notations of a moment, and what they look like."""


class Pieces:
    """Collects the blocks of a table; as text throughout if `as_text`."""

    def __init__(self, names: Sequence[str], as_text: bool) -> None:
        self.names, self.as_text, self.rows = tuple(names), as_text, 0
        self._columns: list[list[pl.Series]] = [[] for _ in names]
        self._dots = [False for _ in names]
        self._lines: list[Lines] = []

    def add(self, frame: pl.DataFrame, lines: Lines) -> None:
        """One block, all of it text."""
        self.rows += len(lines)
        self._lines.append(lines)
        for k, text in enumerate(frame.iter_columns()):
            piece = text if self.as_text else _recognised(text)
            if piece.dtype.is_float():
                self._dots[k] = self._dots[k] or bool(text.str.contains(".", literal=True).any())
            self._columns[k].append(piece)

    @property
    def columns(self) -> list[pl.Series]:
        """All pieces, text or numbers."""
        return [piece for pieces in self._columns for piece in pieces]

    @property
    def dots(self) -> bool:
        """Has a number that was recognised a decimal point?"""
        return any(self._dots)

    def misread(self, decimal: str) -> bool:
        """Would some of what was recognised mean something else beside the other cells of its column?"""
        for pieces, dots in zip(self._columns, self._dots, strict=True):
            kinds = {piece.dtype for piece in pieces}
            if len(kinds) > 1 and ((decimal == "," and dots) or any(kind.is_temporal() for kind in kinds)):
                return True
        return False

    def frame(self) -> pl.DataFrame:
        """All blocks in one; a column is text if not all of it was recognised. What was collected is given away."""
        import polars as pl

        whole = {}
        for name, pieces in zip(self.names, self._columns, strict=True):
            alike = len({piece.dtype for piece in pieces}) == 1
            whole[name] = pl.concat([p if alike else p.cast(pl.String) for p in pieces], rechunk=True)
            pieces.clear()
        return pl.DataFrame(whole)

    def lines(self) -> Lines:
        """Of all rows."""
        filled = [lines for lines in self._lines if len(lines)]
        if all(isinstance(lines, range) for lines in filled) and filled[-1][-1] - filled[0][0] + 1 == self.rows:
            return range(int(filled[0][0]), int(filled[-1][-1]) + 1)
        return np.concatenate([np.asarray(lines, dtype=np.int64) for lines in self._lines])


def _recognised(text: pl.Series) -> pl.Series:
    """Numbers or stamps, where all cells are that."""
    import polars as pl

    numbers = text.cast(pl.Float64, strict=False)
    if numbers.null_count() == text.null_count():
        return numbers
    first = text.drop_nulls()[0]
    form = next((form for form, shape in _ISO.items() if re.fullmatch(shape, first)), None)
    stamps = numbers if form is None else text.str.to_datetime(form, strict=False, time_unit="us", exact=True)
    return stamps if stamps.null_count() == text.null_count() else text
