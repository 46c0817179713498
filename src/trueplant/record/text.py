"""From the bytes of a text file to a table, block by block: encoding, separator, header, columns."""

from __future__ import annotations

import codecs
import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from trueplant.errors import DataError
from trueplant.record import levels
from trueplant.record.cut import Block, fields_of, looks_like_data
from trueplant.record.header import Header, decimal_note, header_of
from trueplant.record.numbers import decimal_mark
from trueplant.record.pieces import Pieces
from trueplant.record.source import Source
from trueplant.record.table import Table

SEPARATORS = (";", "\t", "|", ",", " ")
"""In order of preference: a comma may also be a decimal comma, a space may stand inside a time stamp."""
_NAMED = {"tab": "\t", "\\t": "\t", "space": " ", "spaces": " ", "comma": ",", "semicolon": ";", "pipe": "|"}


def read_text(source: Source) -> Table:
    """A CSV or TXT file: separator, decimal mark, encoding and header are found. Raises DataError where that fails."""
    pieces, start = _collected(source, as_text=False)
    decimal, guessed = decimal_mark(pieces.columns, start.separator, pieces.dots)
    if pieces.misread(decimal):
        pieces, start = _collected(source, as_text=True)
    return Table(
        start.header.names,
        pieces.frame(),
        source.name,
        source.sha256,
        lines=pieces.lines(),
        decimal=decimal,
        separator=start.separator,
        encoding=start.encoding,
        units=start.header.units,
        notes=decimal_note(source.name, decimal, guessed),
    )


def _collected(source: Source, as_text: bool) -> tuple[Pieces, _Start]:
    """All blocks of a file; numbers are recognised at once unless `as_text`."""
    texts = _texts(source)
    start = _start(*next(texts), source)
    names = [start.header.names[k] for k in start.columns]
    places = [start.header.places[k] for k in start.columns]
    pieces = Pieces(names, as_text or start.as_text)
    block, begin = start.block, start.first
    while True:
        pieces.add(*block.cells(begin, start.width, places))
        source.within_limit(pieces.rows, len(places))
        following = next(texts, None)
        if following is None:
            return pieces, start
        block, begin = _block(following[0], start.separator, source.name, block.before + len(block)), 0


@dataclass(frozen=True, eq=False)
class _Start:
    """What the first block tells of a whole file."""

    block: Block
    separator: str
    """As it stands in the file."""
    encoding: str
    first: int
    """Line of the first row of data."""
    width: int
    """Fields of each row."""
    header: Header
    columns: tuple[int, ...]
    """Columns of the header that are read."""
    as_text: bool
    """Nobody said what will be used, or how."""


def _start(text: str, encoding: str, source: Source) -> _Start:
    if not text.strip():
        raise DataError(f"{source.name} is empty; export the data again")
    separator = _separator(text, source)
    block = _block(text, separator, source.name, 0)
    first, width = block.first_data_row(source.fewest)
    head = [block.fields(int(k)) for k in np.flatnonzero(~block.blank[:first])]
    frame, lines = block.cells(first, width, list(range(width)))
    header = header_of(head, frame, source.name)
    rows = header.frame_of(frame).head(levels.START_ROWS)
    wanted = source.columns(Table(header.names, rows, source.name, lines=lines))
    used = frozenset(header.names if wanted is None else wanted)
    columns = tuple(k for k, name in enumerate(header.names) if name in used)
    return _Start(block, separator, encoding, first, width, header, columns, wanted is None)


def _block(text: str, separator: str, source: str, before: int) -> Block:
    """Lines cut by one plain character: where spaces separate, several count as one."""
    if separator == " ":
        text = re.sub(
            r'("[^"\n]*")|[^\S\n]+', lambda m: m.group(1) or "\t", re.sub(r"(?m)^[^\S\n]+|[^\S\n]+$", "", text)
        )
        separator = "\t"
    if len(separator.encode()) != 1:
        raise DataError(f"separator {separator!r} is not a single plain character; correct `separator`")
    return Block((text if text.endswith("\n") else text + "\n").encode(), separator, source, before)


def _texts(source: Source) -> Iterator[tuple[str, str]]:
    """The text of each block of lines, and its encoding. Raises DataError for what is not text."""
    encoding = _encoding(source.head, source.name) if source.encoding is None else _named_encoding(source)
    wide = encoding.startswith(("utf-16", "utf-32"))
    for data in [source.data] if wide else source.blocks():
        for candidate in (encoding, "cp1252", "latin-1") if source.encoding is None else (encoding,):
            try:
                text = data.decode(candidate)
            except UnicodeDecodeError as error:
                if source.encoding is not None:
                    raise DataError(
                        f"{source.name} is not {source.encoding}: {error.reason} at {data[error.start : error.end]!r}; "
                        "correct `encoding`, or leave it out to have it found"
                    ) from None
                if wide:
                    raise DataError(f"{source.name} starts as {encoding} but is damaged; export it again") from None
                continue
            yield text.replace("\r\n", "\n").replace("\r", "\n").rstrip("\x1a\x00"), candidate
            break


def _named_encoding(source: Source) -> str:
    """The encoding that was named, if there is such a one of text."""
    assert source.encoding is not None
    try:
        "".encode(source.encoding)
        return codecs.lookup(source.encoding).name
    except (LookupError, ValueError):
        raise DataError(
            f"{source.name}: {source.encoding!r} is no encoding of text; name one such as utf-8, utf-16 or cp1252"
        ) from None


def _encoding(head: bytes, source: str) -> str:
    """What the first bytes of a file show. Raises DataError for what is not text."""
    if head.startswith((b"\xff\xfe", b"\xfe\xff")):
        return "utf-16"
    if head.startswith(b"\xef\xbb\xbf"):
        return "utf-8-sig"
    codes = np.frombuffer(head, dtype=np.uint8)
    zeros = [float(np.mean(codes[k::2] == 0)) if codes[k::2].size else 0.0 for k in (0, 1)]
    if max(zeros) > levels.UTF16_ZEROS and min(zeros) < levels.TEXT_ZEROS:
        return "utf-16-le" if zeros[1] > zeros[0] else "utf-16-be"
    if np.any(codes == 0) or np.mean((codes < 32) & ~np.isin(codes, (9, 10, 12, 13, 26))) > levels.TEXT_CONTROLS:
        raise DataError(f"{source} is not a text file; give CSV, TXT, Parquet or XLSX")
    return "utf-8"


def _separator(text: str, source: Source) -> str:
    """The one that was named, else the one that cuts the first lines best."""
    if source.separator:
        return _NAMED.get(source.separator.lower(), source.separator)
    sample = [line for line in text[: 1 << 18].split("\n")[: levels.SNIFFED_LINES] if line.strip()]
    if len(text) > 1 << 18 and len(sample) > 1:
        sample = sample[:-1]
    chosen = _sniff(sample)
    if chosen is None:
        rows = [line for line in sample if _has_data(line)]
        if not rows:
            raise DataError(f"{source.name} holds no rows of numbers below its header; export the data again")
        # a column by itself has none, whatever stands in its name
        chosen = max(SEPARATORS, key=lambda c: sum(c in line for line in rows))
    return chosen


def _sniff(lines: list[str]) -> str | None:
    """The separator that cuts most lines into the same number of cells, most of them numbers or times."""
    best, best_score = None, 0.0
    for separator in SEPARATORS:
        if separator == " " and best == "\t":
            continue  # the spaces then stand inside the cells, as in time stamps and messages
        rows = [row for line in lines if len(row := fields_of(line, separator)) > 1]
        if len(rows) < levels.SAME_WIDTH_SHARE * len(lines):
            continue
        width, count = Counter(len(row) for row in rows).most_common(1)[0]
        cells = [cell for row in rows if len(row) == width for cell in row]
        score = (count / len(lines)) * sum(map(looks_like_data, cells)) / len(cells)
        if score > best_score + 1e-9:
            best, best_score = separator, score
    return best


def _has_data(line: str) -> bool:
    return any(looks_like_data(cell) for cell in re.split(r"[;,\t| ]", line))
