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
from trueplant.record import levels
from trueplant.record.header import Cells, with_header
from trueplant.record.numbers import counted
from trueplant.record.source import Source
from trueplant.record.table import Table

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
        if max(zeros) > levels.UTF16_ZEROS and min(zeros) < levels.TEXT_ZEROS:
            encoding = "utf-16-le" if zeros[1] > zeros[0] else "utf-16-be"
        elif np.any(head == 0) or np.mean((head < 32) & ~np.isin(head, (9, 10, 12, 13, 26))) > levels.TEXT_CONTROLS:
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
        if len(rows) < levels.SAME_WIDTH_SHARE * len(lines):
            continue
        width, count = Counter(len(row) for row in rows).most_common(1)[0]
        cells = [cell for row in rows if len(row) == width for cell in row]
        score = (count / len(lines)) * sum(map(looks_like_data, cells)) / len(cells)
        if score > best_score + 1e-9:
            best, best_score = separator, score
    return best


def read_text(source: Source) -> Table:
    """A CSV or TXT file: separator, decimal mark, encoding and header are found. Raises DataError where that fails."""
    return with_header(split_cells(source.data, source.name, source.separator), source)


def split_cells(data: bytes, source: str, separator: str | None = None) -> Cells:
    """Cut a text file into cells, all rows checked to have the same number of them."""
    text, encoding = decode(data, source)
    if not text.strip():
        raise DataError(f"{source} is empty; export the data again")
    sample = [line for line in text[: 1 << 18].split("\n")[: levels.SNIFFED_LINES] if line.strip()]
    if len(text) > 1 << 18 and len(sample) > 1:
        sample = sample[:-1]
    chosen = _NAMED.get(separator.lower(), separator) if separator else _sniff(sample)
    if chosen is None:
        if sum(map(_has_data, sample)) == 0:
            raise DataError(f"{source} holds no rows of numbers below its header; export the data again")
        chosen = max(SEPARATORS, key=lambda c: sum(c in line for line in sample))
    if chosen == " ":
        text = re.sub(
            r'("[^"\n]*")|[^\S\n]+', lambda m: m.group(1) or "\t", re.sub(r"(?m)^[^\S\n]+|[^\S\n]+$", "", text)
        )
    return _cut(text, "\t" if chosen == " " else chosen, source, encoding, chosen)


def _has_data(line: str) -> bool:
    return any(looks_like_data(cell) for cell in re.split(r"[;,\t| ]", line))


@dataclass(frozen=True, eq=False)
class _Lines:
    """Lines of a text file as positions in its bytes, with the number of fields in each."""

    data: bytes
    starts: NDArray[np.int64]
    ends: NDArray[np.int64]
    width: NDArray[np.int64]
    separator: str
    source: str

    def text(self, k: int) -> str:
        return self.data[self.starts[k] : self.ends[k]].decode()

    def fields(self, k: int) -> list[str]:
        return _split(self.text(k), self.separator)


def _cut(text: str, separator: str, source: str, encoding: str, shown: str) -> Cells:
    if len(separator.encode()) != 1:
        raise DataError(f"separator {separator!r} is not a single plain character; correct `separator`")
    data = text.encode()
    if not data.endswith(b"\n"):
        data += b"\n"
    raw = np.frombuffer(data, dtype=np.uint8)
    # a quote inside a word (12" valve) quotes nothing
    opening = re.search(rb"(^|[\n" + re.escape(separator.encode()) + rb'])"', data)
    quoted = opening is not None and data.count(b'"') % 2 == 0
    outside = (np.cumsum(raw == 34) & 1) == 0 if quoted else np.ones(raw.size, dtype=bool)
    ends = np.flatnonzero((raw == 10) & outside)
    starts = np.concatenate([[0], ends[:-1] + 1])
    cuts = np.flatnonzero((raw == ord(separator)) & outside)
    width = np.searchsorted(cuts, ends) - np.searchsorted(cuts, starts) + 1
    lines = _Lines(data, starts, ends, width, separator, source)
    # blank lines hold nothing but separators, quotes and spaces
    printed = (raw > 34) & (raw != ord(separator)) | (raw == 33)
    blank = ~np.logical_or.reduceat(printed[: ends[-1] + 1], starts)
    first, usual = _first_data_row(lines, np.flatnonzero(~blank))
    head = [lines.fields(int(k)) for k in np.flatnonzero(~blank[:first])]
    keep = ~blank & (np.arange(blank.size) >= first)
    keep &= (raw[starts] != ord("#")) | (width == usual)
    rows = np.flatnonzero(keep)
    _check_ragged(lines, rows, usual)
    body = data if bool(keep.all()) else raw[np.repeat(keep, ends - starts + 1)].tobytes()
    return Cells(head, _parse(body, separator, usual, quoted, source), rows + 1, shown, encoding)


def _first_data_row(lines: _Lines, filled: NDArray[np.int64]) -> tuple[int, int]:
    """The first line with numbers, and the usual number of fields of the lines below the top quarter."""
    values, counts = np.unique(lines.width[filled[filled.size // 4 :]], return_counts=True)
    usual = int(values[np.argmax(counts)])
    if usual < 2:
        raise DataError(
            f"{lines.source} has only one column when cut at {lines.separator!r}; name its separator in `separator`"
        )
    for k in filled[: levels.SNIFFED_LINES]:
        comment = lines.text(k).startswith(("#", "//"))
        if lines.width[k] == usual and not comment and any(map(looks_like_data, lines.fields(k))):
            return int(k), usual
    raise DataError(f"{lines.source} holds no rows of numbers below its header; export the data again")


def _check_ragged(lines: _Lines, rows: NDArray[np.int64], usual: int) -> None:
    odd = rows[lines.width[rows] != usual]
    if not odd.size:
        return
    k = int(odd[0])
    hint = "correct or delete that line"
    if lines.separator == "," and odd.size > levels.RAGGED_SHARE * rows.size:
        hint = "if these are decimal commas, export with ; between the columns"
    more = f" (and {counted(odd.size - 1, 'more line')})" if odd.size > 1 else ""
    raise DataError(
        f"{lines.source}, line {k + 1}: {counted(int(lines.width[k]), 'field')} where the lines above have "
        f"{usual}{more}: {lines.text(k)[:80]!r}; {hint}"
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
