"""Lines of a text file cut into fields, all at once."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from trueplant.arrays import BoolArray
from trueplant.errors import DataError
from trueplant.record import levels
from trueplant.record.numbers import counted
from trueplant.record.pieces import Lines

if TYPE_CHECKING:
    import polars as pl

_NUMBER = re.compile(r"^[+\-−]?(\d[\d.,'\u00a0\u202f]*|[.,]\d+)([eE][+\-]?\d+)?$")
_CLOCK = r"\d{1,2}:\d{2}(:\d{2}([.,]\d{1,9})?)?( ?[AaPp][Mm])?( ?(Z|UTC|GMT|[+-]\d{2}:?(\d{2})?))?"
_TIME = re.compile(
    rf"^(\d{{1,4}}[-/.](\d{{1,2}}|[A-Za-z]{{3}})[-/.]\d{{2,4}}|\d{{1,2}} [A-Za-z]{{3}} \d{{2,4}})([T ]+{_CLOCK})?$"
    rf"|^{_CLOCK}$|^\d{{8}}[T ]\d{{2}}:?\d{{2}}(:?\d{{2}})?$"
)


def looks_like_data(cell: str) -> bool:
    """True for a number (with either decimal mark) or a time stamp."""
    cell = cell.strip()
    return bool(_NUMBER.match(cell) or _TIME.match(cell))


def is_banner(row: Sequence[str], below: Iterable[Sequence[str]]) -> bool:
    """Does a row with a number or a date still stand above the header?

    Then a row of words alone, which fills more cells than it does, is among the rows below.
    """
    filled = sum(map(bool, row))
    return any(sum(map(bool, other)) > filled and not any(map(looks_like_data, other)) for other in below)


def fields_of(line: str, separator: str) -> list[str]:
    """The fields of one line; several spaces separate as one does."""
    if separator == " ":
        return [c.strip('"') for c in re.findall(r'"[^"]*"|[^\s"]+', line)]
    return next(csv.reader([line], delimiter=separator), [])


@dataclass(frozen=True, eq=False)
class Block:
    """Whole lines of a text file as bytes, the last one ended by a newline."""

    data: bytes
    separator: str
    """One plain character."""
    source: str
    before: int = 0
    """Lines of the file before it."""

    @cached_property
    def _raw(self) -> NDArray[np.uint8]:
        return np.frombuffer(self.data, dtype=np.uint8)

    @cached_property
    def quoted(self) -> bool:
        """Do quotes keep fields together? One inside a word (12" valve) quotes nothing."""
        count = self.data.count(b'"')
        opening = rb"(^|[\n" + re.escape(self.separator.encode()) + rb'])"'
        return count > 0 and count % 2 == 0 and re.search(opening, self.data) is not None

    @cached_property
    def _places(self) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
        """First and last byte of each line, and its number of fields."""
        raw = self._raw
        ends, cuts = raw == 10, raw == ord(self.separator)
        if self.quoted:
            outside = (np.cumsum(raw == 34) & 1) == 0
            ends, cuts = ends & outside, cuts & outside
        last = np.flatnonzero(ends)
        first = np.concatenate([[0], last[:-1] + 1])
        at = np.flatnonzero(cuts)
        return first, last, np.searchsorted(at, last) - np.searchsorted(at, first) + 1

    @cached_property
    def blank(self) -> BoolArray:
        """(n,) lines that hold nothing but separators, quotes and spaces."""
        raw, (first, last, _) = self._raw, self._places
        printed = (raw > 34) & (raw != ord(self.separator)) | (raw == 33)
        return np.asarray(~np.logical_or.reduceat(printed[: last[-1] + 1], first), dtype=bool)

    def __len__(self) -> int:
        return int(self._places[0].size)

    def text(self, k: int) -> str:
        """Of one line."""
        first, last, _ = self._places
        return self.data[first[k] : last[k]].decode()

    def fields(self, k: int) -> list[str]:
        """Of one line."""
        return fields_of(self.text(k), self.separator)

    def first_data_row(self, fewest: int) -> tuple[int, int]:
        """The first line with numbers, and the usual number of fields of the lines below the top quarter.

        Raises DataError where there is none, or where lines usually have less than `fewest` fields.
        """
        width, filled = self._places[2], np.flatnonzero(~self.blank)
        values, counts = np.unique(width[filled[filled.size // 4 :]], return_counts=True)
        usual = int(values[np.argmax(counts)])
        if usual < fewest:
            raise DataError(
                f"{self.source} has only one column when cut at {self.separator!r}; name its separator in `separator`"
            )
        lines = [int(k) for k in filled[: levels.SNIFFED_LINES] if width[k] == usual]
        for place, k in enumerate(lines):
            comment = self.text(k).startswith(("#", "//"))
            if comment or not any(map(looks_like_data, self.fields(k))):
                continue
            below = map(self.fields, lines[place + 1 : place + 1 + levels.BANNER_LINES])
            if not is_banner(self.fields(k), below):
                return k, usual
        raise DataError(f"{self.source} holds no rows of numbers below its header; export the data again")

    def cells(self, begin: int, usual: int, columns: list[int]) -> tuple[pl.DataFrame, Lines]:
        """Some of the columns as text, and the line in the file of each row, from line `begin` on.

        Raises DataError for lines with another than the `usual` number of fields.
        """
        first, last, width = self._places
        keep = ~self.blank
        keep[:begin] = False
        keep &= (self._raw[first] != ord("#")) | (width == usual)
        rows = np.flatnonzero(keep)
        self._check_ragged(rows, usual)
        if rows.size and rows[-1] - rows[0] + 1 == rows.size:
            body = self.data[first[rows[0]] : last[rows[-1]] + 1]
            lines: Lines = range(int(rows[0]) + 1 + self.before, int(rows[-1]) + 2 + self.before)
        else:
            body, lines = self._raw[np.repeat(keep, last - first + 1)].tobytes(), rows + 1 + self.before
        return self._parse(body, columns), lines

    def _check_ragged(self, rows: NDArray[np.int64], usual: int) -> None:
        width = self._places[2]
        odd = rows[width[rows] != usual]
        if not odd.size:
            return
        k = int(odd[0])
        hint = "correct or delete that line"
        if self.separator == "," and odd.size > levels.RAGGED_SHARE * rows.size:
            hint = "if these are decimal commas, export with ; between the columns"
        more = f" (and {counted(odd.size - 1, 'more line')})" if odd.size > 1 else ""
        raise DataError(
            f"{self.source}, line {self.before + k + 1}: {counted(int(width[k]), 'field')} where the lines above have "
            f"{usual}{more}: {self.text(k)[:80]!r}; {hint}"
        )

    def _parse(self, body: bytes, columns: list[int]) -> pl.DataFrame:
        import polars as pl

        if not body:
            return pl.DataFrame({str(k): pl.Series([], dtype=pl.String) for k in columns})
        try:
            return pl.read_csv(
                io.BytesIO(body),
                columns=columns,
                separator=self.separator,
                has_header=False,
                infer_schema=False,
                quote_char='"' if self.quoted else None,
            )
        except pl.exceptions.PolarsError as error:
            reason = str(error).splitlines()[0]
            raise DataError(
                f"{self.source} cannot be cut into columns ({reason}); check quotes and separators"
            ) from None
