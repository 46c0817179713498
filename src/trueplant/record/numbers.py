"""Numbers written as text: decimal commas, thousands separators, words among the numbers."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np

from trueplant.arrays import Array, BoolArray
from trueplant.record import levels

if TYPE_CHECKING:
    import polars as pl

MISSING = ("", "na", "n/a", "nan", "null", "none", "-nan", "nil")
"""Words for a value that is not there; other words are reported."""

_COMMA_SURE = (
    r"^[+-]?(\d*,(\d{1,2}|\d{4,})|0?,\d+|0+,\d+|\d{4,},\d+|\d{1,3}(\.\d{3})+,\d+)([eE][+-]?\d+)?$|^[+-]?\d*,\d+[eE]"
)
_THOUSANDS_SURE = r"^[+-]?\d{1,3}(,\d{3})+\.\d+|^[+-]?\d{1,3}(,\d{3}){2,}$"
_EITHER = r"^[+-]?[1-9]\d{0,2},\d{3}$"
_GROUPED = {".": r"^[+-]?[1-9]\d{0,2}(,\d{3})+(\.|$)", ",": r"^[+-]?[1-9]\d{0,2}(\.\d{3})+(,|$)"}


def counted(n: int, word: str) -> str:
    """A number with its noun: 1 row, 2 rows."""
    return f"{n} {word}{'' if n == 1 else 's'}"


def _plain(text: pl.Series) -> pl.Series:
    """Trimmed, with a plain minus sign and no blank or apostrophe between digits."""
    text = text.str.strip_chars()
    return text.str.replace("−", "-", literal=True).str.replace_all(r"(\d)[\x{00a0}\x{202f} '](\d{3})", "$1$2")


def decimal_mark(columns: Iterable[pl.Series], separator: str | None, dots: bool = False) -> tuple[str, bool]:
    """The decimal mark of a table of text, and whether it had to be guessed.

    `dots`: was a decimal point seen in columns that are numbers already?
    """
    import polars as pl

    sure = against = unsure = 0
    for series in columns:
        if series.dtype != pl.String:
            continue
        bad = series.is_not_null() & series.cast(pl.Float64, strict=False).is_null()
        if not bad.all():
            dots = dots or bool(series.filter(~bad).str.contains(r"\d\.\d").any())
        words = _plain(series.filter(bad).head(100_000))
        sure += int(words.str.contains(_COMMA_SURE).sum())
        against += int(words.str.contains(_THOUSANDS_SURE).sum())
        unsure += int(words.str.contains(_EITHER).sum())
    if sure or against:
        return ("," if sure > against else "."), bool(sure and against)
    if unsure:
        return ("." if separator == "," or dots else ","), True
    return ".", False


def to_numbers(series: pl.Series, decimal: str) -> tuple[Array, BoolArray]:
    """Float64 values (NaN where there is none) and where a word stood instead of a number."""
    import polars as pl

    if series.dtype == pl.Boolean or series.dtype.is_numeric() or series.dtype == pl.Null:
        return _array(series.cast(pl.Float64)), np.zeros(len(series), dtype=bool)
    if series.dtype in (pl.Categorical, pl.Enum):
        series = series.cast(pl.String)
    if series.dtype != pl.String:
        return np.full(len(series), np.nan), np.asarray(series.is_not_null().to_numpy(), dtype=bool)
    numbers = series.cast(pl.Float64, strict=False)
    rest = series.is_not_null() & numbers.is_null()
    commas = decimal == "," and bool(series.str.contains(r"^\s*[+-]?[\d.]*,\d").any())
    if commas or bool(rest.any()):
        text = _plain(series)
        if commas or decimal == ".":
            grouped = text.str.contains(_GROUPED[decimal])
            without = text.str.replace_all("." if decimal == "," else ",", "", literal=True)
            text = without.zip_with(grouped.fill_null(False), text)
        if commas:
            text = text.str.replace(",", ".", literal=True)
        numbers = text.cast(pl.Float64, strict=False)
        missing = text.str.to_lowercase().is_in(list(MISSING))
        rest = text.is_not_null() & numbers.is_null() & ~missing.fill_null(True)
    return _array(numbers), np.asarray(rest.to_numpy(), dtype=bool)


def _array(numbers: pl.Series) -> Array:
    """Float64 values in an array of its own, NaN where there are none."""
    return np.asarray(numbers.fill_null(float("nan")).to_numpy(writable=True), dtype=float)


def no_measurements(values: Array) -> BoolArray:
    """Where numbers (N,) are infinite, larger than anything that is measured, or a code far off all others."""
    with np.errstate(invalid="ignore"):
        bad = (values > levels.LARGEST_VALUE) | (values < -levels.LARGEST_VALUE)
    # most signals never come near a code, and to ask each sample for each of them takes longer than to read it
    far = np.flatnonzero(np.abs(values) >= min(map(abs, levels.SENTINELS)))
    far = far[np.isin(values[far], levels.SENTINELS)]
    if not far.size:
        return np.asarray(bad)
    codes = np.zeros(values.shape, dtype=bool)
    codes[far] = True
    others = values[np.isfinite(values) & ~bad & ~codes]
    if not others.size:
        return np.asarray(bad)
    low, high = float(others.min()), float(others.max())
    away = max(levels.SENTINEL_AWAY * (high - low), levels.SENTINEL_STEP * max(-low, high))
    return np.asarray(bad | codes & ((values < low - away) | (values > high + away)))
