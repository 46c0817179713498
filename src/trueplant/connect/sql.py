"""The user's own query: where its placeholders are, and what stands there instead."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

from trueplant.connect.source import Window
from trueplant.errors import ProjectError

_PLACE = re.compile(r"(?<!:):(tags|from|to|from_unix|to_unix)\b")
"""Not the second half of a cast such as val::float8."""


def placed(query: str, written: Mapping[str, str]) -> tuple[str, list[str]]:
    """The query with each placeholder as it is `written` (with {} for its number), and their names by number.

    Raises ProjectError for a query without :tags, :from or :to.
    """
    names: list[str] = []

    def put(found: re.Match[str]) -> str:
        if found[1] not in names:
            names.append(found[1])
        return written[found[1]].replace("{}", str(names.index(found[1]) + 1))

    text = _PLACE.sub(put, query)
    for end, other in (("tags", "tags"), ("from", "from_unix"), ("to", "to_unix")):
        if end not in names and other not in names:
            raise ProjectError(f"data.source.query: has no :{end}; it must ask for :tags, :from and :to alone")
    return text, names


def given(tags: Sequence[str], window: Window, tags_as: str) -> dict[str, str | float]:
    """The values of all placeholders; moments as text in UTC."""
    return {
        "tags": tags_as,
        "from": window.start.isoformat(),
        "to": window.end.isoformat(),
        "from_unix": window.start.timestamp(),
        "to_unix": window.end.timestamp(),
    }
