"""Any table as raw columns, wherever it was read from."""

from __future__ import annotations

import difflib
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from trueplant.arrays import Array, BoolArray
from trueplant.errors import DataError
from trueplant.record import levels
from trueplant.record.numbers import to_numbers
from trueplant.record.pieces import Lines
from trueplant.record.types import Finding

if TYPE_CHECKING:
    import polars as pl


@dataclass(frozen=True, eq=False)
class Table:
    """Raw columns of one file or frame; text stays text until `numbers` is asked for a column."""

    names: tuple[str, ...]
    """Of all its columns."""
    frame: pl.DataFrame
    """Those columns that were asked for."""
    source: str
    sha256: str = ""
    lines: Lines | None = None
    """Line in the file of each row, None where there are no lines."""
    decimal: str = "."
    separator: str | None = None
    encoding: str | None = None
    units: Mapping[str, str] = field(default_factory=dict)
    """From unit rows below the header."""
    notes: tuple[Finding, ...] = ()

    def __len__(self) -> int:
        return int(self.frame.height)

    def where(self, row: int) -> str:
        """The place of a row (0-based) in words."""
        return f"line {self.lines[row]}" if self.lines is not None else f"row {row + 1}"

    def column(self, name: str, role: str = "") -> pl.Series:
        """The raw column. Raises DataError with the nearest names if there is none."""
        if name in self.names:
            return self.frame[name]
        hint = did_you_mean(name, self.names)
        shown = ", ".join(self.names[:30]) + (", ..." if len(self.names) > 30 else "")
        wanted = f" for {role}" if role else ""
        raise DataError(f"{self.source} has no column {name!r}{wanted}{hint} It has: {shown}")

    def numbers(self, name: str) -> tuple[Array, BoolArray]:
        """A column as float64 (NaN where there is no number) and where a word stood instead of one."""
        return to_numbers(self.column(name), self.decimal)


def did_you_mean(name: str, names: Sequence[str]) -> str:
    """The nearest of the names as a question that ends a sentence; a full stop where none is near.

    The nearest is one that holds the whole name, if there is one: TIC1.PV (degC) for TIC1.PV, not TIC2.PV.
    """
    asked, lower = name.strip().casefold(), {n.strip().casefold(): n for n in reversed(names)}
    holding = sorted((n for n in lower if asked and asked in n), key=len)
    near = holding or difflib.get_close_matches(asked, lower, n=1, cutoff=levels.NEAR_NAME)
    return f"; did you mean {lower[near[0]]!r}?" if near else "."


def check_names(names: Sequence[str], source: str) -> None:
    """Raise DataError where two columns are called the same."""
    repeated = [n for n, k in Counter(names).items() if k > 1]
    if repeated:
        raise DataError(f"{source} has the column {repeated[0]!r} more than once; rename one of them")
