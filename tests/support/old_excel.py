"""Old Excel workbooks (BIFF8 records in an OLE2 container), which no library at hand writes: numbers of one sheet."""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence

SECTOR = 512
END, FREE, TABLE = 0xFFFFFFFE, 0xFFFFFFFF, 0xFFFFFFFD


def old_workbook(names: Sequence[str], cells: Mapping[tuple[int, int], float]) -> bytes:
    """A workbook with the names in its first row and numbers at (row, column), both from 0."""
    sheet = [_record(0x204, struct.pack("<HHHHB", 0, c, 0, len(n), 0) + n.encode()) for c, n in enumerate(names)]
    sheet += [_record(0x203, struct.pack("<HHHd", *place, 0, value)) for place, value in cells.items()]
    before = len(_globals(0))
    stream = _globals(before) + _begin(0x10) + b"".join(sheet) + _record(0x0A)
    return _container(stream.ljust(8 * SECTOR, b"\0"))


def _record(kind: int, body: bytes = b"") -> bytes:
    return struct.pack("<HH", kind, len(body)) + body


def _begin(kind: int) -> bytes:
    return _record(0x809, struct.pack("<HHHHII", 0x600, kind, 0x0DBB, 0x07CC, 0, 6))


def _globals(sheet: int) -> bytes:
    """What comes before the sheet, which begins at that byte."""
    return _begin(5) + _record(0x85, struct.pack("<IBBBB", sheet, 0, 0, 6, 0) + b"Sheet1") + _record(0x0A)


def _container(stream: bytes) -> bytes:
    """A file with the stream "Workbook": head, table of sectors, directory, stream."""
    count = -(-len(stream) // SECTOR)
    tables = next(n for n in range(1, 109) if SECTOR // 4 * n >= count + n + 1)
    table = [TABLE] * tables + [END, *(tables + 2 + k for k in range(count - 1)), END]
    table += [FREE] * (SECTOR // 4 * tables - len(table))
    directory = _entry("Root Entry", 5, END, 0, 1) + _entry("Workbook", 2, tables + 1, len(stream), FREE)
    head = b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1" + bytes(16) + struct.pack("<HHHHH", 0x3E, 3, 0xFFFE, 9, 6) + bytes(6)
    head += struct.pack("<9I", 0, tables, tables, 0, 4096, END, 0, END, 0)
    head += struct.pack("<109I", *range(tables), *[FREE] * (109 - tables))
    parts = struct.pack(f"<{len(table)}I", *table), directory.ljust(SECTOR, b"\0"), stream.ljust(SECTOR * count, b"\0")
    return head + b"".join(parts)


def _entry(name: str, kind: int, start: int, size: int, child: int) -> bytes:
    raw = name.encode("utf-16-le") + b"\0\0"
    links = struct.pack("<HBBIII", len(raw), kind, 1, FREE, FREE, child)
    return raw.ljust(64, b"\0") + links + bytes(36) + struct.pack("<IQ", start, size)
