"""Any table as raw columns: text files, Parquet, XLSX and frames in memory."""

from __future__ import annotations

import difflib
import hashlib
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from trueplant.arrays import Array, BoolArray
from trueplant.errors import DataError
from trueplant.record import levels
from trueplant.record.numbers import decimal_mark, to_numbers
from trueplant.record.text import looks_like_data, split_cells
from trueplant.record.types import Finding

if TYPE_CHECKING:
    import polars as pl


@dataclass(frozen=True, eq=False)
class Table:
    """Raw columns of one file or frame; text stays text until `numbers` is asked for a column."""

    names: tuple[str, ...]
    frame: pl.DataFrame
    source: str
    sha256: str = ""
    lines: NDArray[np.int64] | None = None
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
    """The nearest of the names as a question that ends a sentence; a full stop where none is near."""
    lower = {n.strip().casefold(): n for n in reversed(names)}
    near = difflib.get_close_matches(name.strip().casefold(), lower, n=1, cutoff=levels.NEAR_NAME)
    return f"; did you mean {lower[near[0]]!r}?" if near else "."


def read_table(path: str | Path, *, separator: str | None = None, sheet: str | None = None) -> Table:
    """Read a CSV, TXT, Parquet or XLSX file as raw columns; finds separator, decimal mark, encoding and header.

    Raises DataError (file, line, what to do) when the file is missing, empty, not a table, or ragged.
    """
    file = Path(path)
    source = file.name
    try:
        if file.is_dir():
            raise DataError(f"{file} is a folder; name a file in it")
        data = file.read_bytes()
    except FileNotFoundError:
        raise DataError(
            f"{file} does not exist; correct the path (in a project file it is relative to that file)"
        ) from None
    except OSError as error:
        raise DataError(
            f"{file} cannot be read ({error.strerror or error}); check the file and its permissions"
        ) from None
    if not data.strip():
        raise DataError(f"{source} is empty; export the data again")
    digest = hashlib.sha256(data).hexdigest()
    if data.startswith(b"PAR1"):
        return _read_parquet(data, source, digest)
    if data.startswith((b"PK\x03\x04", b"\xd0\xcf\x11\xe0")):
        return _read_sheet(data, source, digest, sheet)
    if data.startswith((b"\x1f\x8b", b"BZh", b"\xfd7zXZ", b"7z\xbc\xaf")):
        raise DataError(f"{source} is compressed; unpack it first")
    if file.suffix.lower() in {".parquet", ".pq", ".xlsx", ".xlsm", ".xls"}:
        raise DataError(f"{source} is not the {file.suffix} file that its name says; export it again")
    cells = split_cells(data, source, separator)
    return _with_header(cells.head, cells.frame, cells.lines, source, digest, cells.separator, cells.encoding)


def as_table(data: Any, name: str) -> Table:
    """A polars or pandas frame, or a mapping of names to arrays, as a Table."""
    import polars as pl

    try:
        if isinstance(data, pl.LazyFrame):
            data = data.collect()
        if isinstance(data, pl.DataFrame):
            frame = data
        elif isinstance(data, Mapping):
            frame = pl.DataFrame([_series(str(k), v) for k, v in data.items()])
        elif hasattr(data, "columns") and hasattr(data, "index"):
            frame = _from_pandas(data, name)
        else:
            raise DataError(f"{name}: a {type(data).__name__} is not a table; give a path, a frame or a dict of arrays")
    except pl.exceptions.PolarsError as error:
        raise DataError(f"{name}: the columns do not form a table ({str(error).splitlines()[0]})") from None
    if frame.height == 0:
        raise DataError(f"{name} has no rows; give a frame with data")
    digest = hashlib.sha256()
    for series in frame.iter_columns():
        digest.update(series.name.encode())
        digest.update(
            np.ascontiguousarray(series.to_numpy()).tobytes()
            if series.dtype.is_numeric()
            else "\n".join(map(str, series.to_list())).encode()
        )
    return _checked(tuple(frame.columns), frame, None, name, digest.hexdigest())


def _series(name: str, values: Any) -> pl.Series:
    import polars as pl

    array = np.asarray(values)
    if array.ndim != 1:
        raise DataError(f"column {name!r} has shape {array.shape}; give one value for each sample")
    return pl.Series(name, values if array.dtype.kind == "O" else array, strict=False)


def _from_pandas(data: Any, name: str) -> pl.DataFrame:
    import polars as pl

    labels = [str(c) for c in data.columns]
    repeated = [n for n, k in Counter(labels).items() if k > 1]
    if repeated:
        raise DataError(f"{name} has the column {repeated[0]!r} more than once; rename one of them")
    columns = [_pandas_series(label, data[c]) for label, c in zip(labels, data.columns, strict=True)]
    index = data.index
    # a plain row number says nothing; any other index is most likely the time
    if type(index).__name__ != "RangeIndex":
        label = str(index.name) if index.name is not None else "time"
        if label not in labels:
            columns.insert(0, _pandas_series(label, index.to_series()))
    return pl.DataFrame(columns)


def _pandas_series(name: str, series: Any) -> pl.Series:
    import polars as pl

    if getattr(series.dtype, "tz", None) is not None:
        naive = series.dt.tz_convert("UTC").dt.tz_localize(None).to_numpy()
        return pl.Series(name, naive).cast(pl.Datetime("us")).dt.replace_time_zone("UTC")
    values = series.to_numpy()
    if values.dtype.kind in "OTUS":
        return pl.Series(name, [None if v is None or v != v else v for v in values.tolist()], strict=False)
    return pl.Series(name, values)


def _read_parquet(data: bytes, source: str, digest: str) -> Table:
    import io

    import polars as pl

    try:
        frame = pl.read_parquet(io.BytesIO(data))
    except Exception as error:  # polars reports damaged files by several classes, panics among them
        raise DataError(
            f"{source} is not a readable Parquet file ({str(error).splitlines()[0]}); export it again"
        ) from None
    if frame.height == 0:
        raise DataError(f"{source} has columns but no rows; export the data again")
    return _checked(tuple(frame.columns), frame, None, source, digest)


def _read_sheet(data: bytes, source: str, digest: str, sheet: str | None) -> Table:
    import fastexcel
    import polars as pl

    try:
        book = fastexcel.read_excel(data)
    except Exception as error:
        reason = str(error).splitlines()[0]
        raise DataError(f"{source} is not a readable Excel workbook ({reason}); save it as XLSX again") from None
    names = list(book.sheet_names)
    if sheet is not None and sheet not in names:
        raise DataError(f"{source} has no sheet {sheet!r}; it has: {', '.join(names)}")
    chosen = sheet if sheet is not None else names[0]
    notes: tuple[Finding, ...] = ()
    if sheet is None and len(names) > 1:
        message = f"{source}: sheet {chosen!r} was read, the first of {len(names)}; name another one in `sheet`."
        notes = (Finding("sheet", source, message),)
    frame = book.load_sheet(chosen, header_row=None, skip_rows=0, dtypes="string").to_polars()
    # as text, numbers come rounded to nine decimals
    exact = book.load_sheet(chosen, header_row=None, skip_rows=0, dtypes="float").to_polars()
    frame = pl.DataFrame([_exact(frame[c], exact[c]) for c in frame.columns])
    numbered = frame.with_row_index("line", offset=1).filter(~pl.all_horizontal(pl.exclude("line").is_null()))
    frame = numbered.drop("line")
    rows = [["" if c is None else c for c in row] for row in frame.head(100).rows()]
    first = next(
        (k for k, row in enumerate(rows) if sum(map(looks_like_data, row)) >= 1 and sum(map(bool, row)) > 1), None
    )
    if first is None:
        raise DataError(f"{source}, sheet {chosen!r}: no rows of numbers; name the right sheet in `sheet`")
    lines = numbered["line"].to_numpy()[first:].astype(np.int64)
    return _with_header(rows[:first], frame[first:], lines, source, digest, None, None, notes)


def _exact(text: pl.Series, value: pl.Series) -> pl.Series:
    """Cells as text, those that are numbers in full precision."""
    import polars as pl

    if value.dtype != pl.Float64:
        return text
    number = text.cast(pl.Float64, strict=False).is_not_null() & value.is_not_null()
    return value.cast(pl.String).zip_with(number, text).alias(text.name)


def _with_header(
    head: list[list[str]],
    frame: pl.DataFrame,
    lines: NDArray[np.int64],
    source: str,
    digest: str,
    separator: str | None,
    encoding: str | None,
    notes: tuple[Finding, ...] = (),
) -> Table:
    """Find the names among the lines above the data, and the units if there is a row of them."""
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
    empty = [k for k, n in enumerate(names) if not n and frame.to_series(k).null_count() == frame.height]
    kept = [k for k in range(width) if k not in empty]
    frame = frame.select([frame.columns[k] for k in kept])
    names = [names[k] or f"column {k + 1}" for k in kept]
    decimal, guessed = decimal_mark(frame, separator)
    if guessed:
        message = (
            f"{source}: numbers such as 1,234 can be read in two ways; "
            f"the comma was taken as {'the decimal mark' if decimal == ',' else 'a thousands separator'}."
        )
        notes = (*notes, Finding("decimal", source, message))
    return _checked(names, frame, lines, source, digest, decimal, separator, encoding, units, notes)


def _checked(
    names: Sequence[str],
    frame: pl.DataFrame,
    lines: NDArray[np.int64] | None,
    source: str,
    digest: str,
    decimal: str = ".",
    separator: str | None = None,
    encoding: str | None = None,
    units: Mapping[str, str] | None = None,
    notes: tuple[Finding, ...] = (),
) -> Table:
    repeated = [n for n, k in Counter(names).items() if k > 1]
    if repeated:
        raise DataError(f"{source} has the column {repeated[0]!r} more than once; rename one of them")
    frame = frame.rename(dict(zip(frame.columns, names, strict=True)))
    return Table(tuple(names), frame, source, digest, lines, decimal, separator, encoding, units or {}, notes)
