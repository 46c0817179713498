"""Files as the browser saves them: under a name that is safe anywhere, as what they are."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterable, Sequence
from urllib.parse import quote

from starlette.responses import Response

KINDS = {
    ".csv": "text/csv; charset=utf-8",
    ".html": "text/html; charset=utf-8",
    ".json": "application/json",
    ".toml": "application/toml; charset=utf-8",
    ".zip": "application/zip",
}
_LONGEST = 100
"""Letters of a name: every file system takes that."""
_FORMULA = ("=", "+", "-", "@", "\t", "\r")
"""What a sheet program may take for a formula where a text begins with it."""


def download(content: bytes | str, name: str) -> Response:
    """A file to be saved."""
    safe = safe_name(name)
    suffix = f".{safe.rpartition('.')[2]}"
    plain = safe.encode("ascii", "replace").decode().replace("?", "_")
    disposition = f"attachment; filename=\"{plain}\"; filename*=UTF-8''{quote(safe, safe='')}"
    kind = KINDS.get(suffix, "application/octet-stream")
    return Response(content, media_type=kind, headers={"content-disposition": disposition})


def safe_name(name: str) -> str:
    """Without folders, control characters and what Windows forbids; never hidden, never empty, its ending kept."""
    base = re.sub(r'[\x00-\x1f\x7f-\x9f<>:"/\\|?*]', "_", name).strip(". ")
    stem, dot, suffix = base.rpartition(".")
    return f"{(stem or 'file')[:_LONGEST]}{dot}{suffix}" if dot else (base or "file")[:_LONGEST]


def as_csv(headings: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Numbers in full, nothing for what is missing; no text that a sheet program would run as a formula."""
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\r\n")
    writer.writerow([_cell(one) for one in headings])
    writer.writerows([_cell(one) for one in row] for row in rows)
    return buffer.getvalue()


def _cell(value: object) -> object:
    if value is None:
        return ""
    if isinstance(value, str) and value.startswith(_FORMULA):
        return f"'{value}"
    return value
