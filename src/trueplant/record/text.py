"""From the bytes of a text file to cells: encoding, separator, lines."""

from __future__ import annotations

import csv
import io
import re
from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from trueplant.errors import DataError

if TYPE_CHECKING:
    import polars as pl

SEPARATORS = (";", "\t", "|", ",", " ")
"""In order of preference: a comma may also be a decimal comma, a space may stand inside a time stamp."""
_NAMED = {"tab": "\t", "\\t": "\t", "space": " ", "spaces": " ", "comma": ",", "semicolon": ";", "pipe": "|"}
_NUMBER = re.compile(r"^[+\-−]?(\d[\d.,'\u00a0\u202f]*|[.,]\d+)([eE][+\-]?\d+)?$")
_CLOCK = r"\d{1,2}:\d{2}(:\d{2}([.,]\d{1,9})?)?( ?[AaPp][Mm])?( ?(Z|UTC|GMT|[+-]\d{2}:?(\d{2})?))?"
_TIME = re.compile(
    rf"^(\d{{1,4}}[-/.](\d{{1,2}}|[A-Za-z]{{3}})[-/.]\d{{2,4}}|\d{{1,2}} [A-Za-z]{{3}} \d{{2,4}})([T ]+{_CLOCK})?$"
    rf"|^{_CLOCK}$|^\d{{8}}[T ]\d{{2}}:?\d{{2}}(:?\d{{2}})?$"
)
_SNIFFED_LINES = 300


@dataclass(frozen=True, eq=False)
class Cells:
    """A text file cut into cells. `head` holds the lines above the data as lists, `frame` all data rows as text."""

    head: list[list[str]]
    frame: pl.DataFrame
    lines: NDArray[np.int64]
    """Line number in the file of each row of `frame`."""
    separator: str
    encoding: str


def looks_like_data(cell: str) -> bool:
    """True for a number (with either decimal mark) or a time stamp."""
    cell = cell.strip()
    return bool(_NUMBER.match(cell) or _TIME.match(cell))


def decode(data: bytes, source: str) -> tuple[str, str]:
    """Text and encoding of a file. Raises DataError for what is not text."""
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        encoding = "utf-16"
    elif data.startswith(b"\xef\xbb\xbf"):
        encoding = "utf-8-sig"
    else:
        head = np.frombuffer(data[:4096], dtype=np.uint8)
        zeros = [float(np.mean(head[k::2] == 0)) if head[k::2].size else 0.0 for k in (0, 1)]
        if max(zeros) > 0.4 and min(zeros) < 0.05:
            encoding = "utf-16-le" if zeros[1] > zeros[0] else "utf-16-be"
        elif np.any(head == 0) or np.mean((head < 32) & ~np.isin(head, (9, 10, 12, 13, 26))) > 0.02:
            raise DataError(f"{source} is not a text file; give CSV, TXT, Parquet or XLSX")
        else:
            encoding = "utf-8"
    for candidate in (encoding, "cp1252", "latin-1"):
        try:
            text = data.decode(candidate)
        except UnicodeDecodeError:
            if encoding != "utf-8":
                raise DataError(f"{source} starts as {encoding} but is damaged; export it again") from None
            continue
        return text.replace("\r\n", "\n").replace("\r", "\n").rstrip("\x1a\x00"), candidate
    raise DataError(f"{source} is not a text file; give CSV, TXT, Parquet or XLSX")


def _split(line: str, separator: str) -> list[str]:
    if separator == " ":
        return [c.strip('"') for c in re.findall(r'"[^"]*"|[^\s"]+', line)]
    return next(csv.reader([line], delimiter=separator), [])


def _sniff(lines: list[str]) -> str | None:
    """The separator that cuts most lines into the same number of cells, most of them numbers or times."""
    best, best_score = None, 0.0
    for separator in SEPARATORS:
        rows = [row for line in lines if len(row := _split(line, separator)) > 1]
        if len(rows) < 0.3 * len(lines):
            continue
        width, count = Counter(len(row) for row in rows).most_common(1)[0]
        cells = [cell for row in rows if len(row) == width for cell in row]
        score = (count / len(lines)) * sum(map(looks_like_data, cells)) / len(cells)
        if score > best_score + 1e-9:
            best, best_score = separator, score
    return best


def split_cells(data: bytes, source: str, separator: str | None = None) -> Cells:
    """Cut a text file into cells, all rows checked to have the same number of them."""
    text, encoding = decode(data, source)
    if not text.strip():
        raise DataError(f"{source} is empty; export the data again")
    sample = [line for line in text[: 1 << 18].split("\n")[:_SNIFFED_LINES] if line.strip()]
    if len(text) > 1 << 18 and len(sample) > 1:
        sample = sample[:-1]
    chosen = _NAMED.get(separator.lower(), separator) if separator else _sniff(sample)
    if chosen is None:
        if sum(map(_has_data, sample)) == 0:
            raise DataError(f"{source} holds no rows of numbers below its header; export the data again")
        raise DataError(f"{source} has only one column, or its separator is unusual; name it in `separator`")
    if chosen == " ":
        text = re.sub(
            r'("[^"\n]*")|[^\S\n]+', lambda m: m.group(1) or "\t", re.sub(r"(?m)^[^\S\n]+|[^\S\n]+$", "", text)
        )
    return _cut(text, "\t" if chosen == " " else chosen, source, encoding, chosen)


def _has_data(line: str) -> bool:
    return any(looks_like_data(cell) for cell in re.split(r"[;,\t| ]", line))


def _cut(text: str, separator: str, source: str, encoding: str, shown: str) -> Cells:
    if len(separator.encode()) != 1:
        raise DataError(f"separator {separator!r} is not a single plain character; correct `separator`")
    data = text.encode()
    if not data.endswith(b"\n"):
        data += b"\n"
    raw = np.frombuffer(data, dtype=np.uint8)
    quoted = data.count(b'"') > 0 and data.count(b'"') % 2 == 0
    outside = (np.cumsum(raw == 34) & 1) == 0 if quoted else np.ones(raw.size, dtype=bool)
    ends = np.flatnonzero((raw == 10) & outside)
    starts = np.concatenate([[0], ends[:-1] + 1])
    cuts = np.flatnonzero((raw == ord(separator)) & outside)
    width = np.searchsorted(cuts, ends) - np.searchsorted(cuts, starts) + 1
    # blank: nothing but separators, quotes and spaces
    ink = (raw > 34) & (raw != ord(separator)) | (raw == 33)
    blank = ~np.logical_or.reduceat(ink[: ends[-1] + 1], starts)
    first = _first_data_row(data, starts, ends, width, blank, separator, source)
    rows = np.flatnonzero(~blank & (np.arange(blank.size) >= first))
    head = [_split(data[starts[k] : ends[k]].decode(), separator) for k in np.flatnonzero(~blank[:first])]
    _check_ragged(data, starts, ends, width, rows, head, separator, source)
    keep = np.zeros(blank.size, dtype=bool)
    keep[rows] = True
    body = data if bool(keep.all()) else raw[np.repeat(keep, ends - starts + 1)].tobytes()
    return Cells(head, _parse(body, separator, int(width[rows[0]]), quoted, source), rows + 1, shown, encoding)


def _first_data_row(
    data: bytes,
    starts: NDArray[np.int64],
    ends: NDArray[np.int64],
    width: NDArray[np.int64],
    blank: NDArray[np.bool_],
    separator: str,
    source: str,
) -> int:
    inked = np.flatnonzero(~blank)
    tail = width[inked[inked.size // 4 :]]
    values, counts = np.unique(tail, return_counts=True)
    usual = int(values[np.argmax(counts)])
    if usual < 2:
        raise DataError(f"{source} has only one column when cut at {separator!r}; correct `separator`")
    for k in inked[:_SNIFFED_LINES]:
        line = data[starts[k] : ends[k]].decode()
        if (
            width[k] == usual
            and not line.startswith(("#", "//"))
            and any(map(looks_like_data, _split(line, separator)))
        ):
            return int(k)
    raise DataError(f"{source} holds no rows of numbers below its header; export the data again")


def _check_ragged(
    data: bytes,
    starts: NDArray[np.int64],
    ends: NDArray[np.int64],
    width: NDArray[np.int64],
    rows: NDArray[np.int64],
    head: list[list[str]],
    separator: str,
    source: str,
) -> None:
    usual = int(width[rows[0]])
    odd = rows[width[rows] != usual]
    if not odd.size:
        return
    k = int(odd[0])
    excerpt = data[starts[k] : ends[k]].decode()[:80]
    hint = "correct or delete that line"
    if separator == "," and odd.size > 0.2 * rows.size:
        hint = "if these are decimal commas, export with ; between the columns"
    more = f" (and {odd.size - 1} more lines)" if odd.size > 1 else ""
    raise DataError(
        f"{source}, line {k + 1}: {width[k]} fields where the lines above have {usual}{more}: {excerpt!r}; {hint}"
    )


def _parse(body: bytes, separator: str, width: int, quoted: bool, source: str) -> pl.DataFrame:
    import polars as pl

    try:
        return pl.read_csv(
            io.BytesIO(body),
            separator=separator,
            has_header=False,
            infer_schema=False,
            new_columns=[f"column_{k + 1}" for k in range(width)],
            quote_char='"' if quoted else None,
        )
    except pl.exceptions.PolarsError as error:
        reason = str(error).splitlines()[0]
        raise DataError(f"{source} cannot be cut into columns ({reason}); check quotes and separators") from None
