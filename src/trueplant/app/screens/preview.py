"""The first rows of a data file with what was understood of it, and the project that is made from that."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from trueplant.errors import DataError
from trueplant.project.draft import draft_project
from trueplant.project.guess import Seen, guess_counted_unit, guess_loops, guess_time_unit
from trueplant.project.look import look
from trueplant.record.readers import read_table
from trueplant.record.table import Table
from trueplant.record.text import SEPARATORS

ROWS = 12
"""Of a file that are shown. Judgement: a header, a date and a dozen numbers fit on a screen."""
COLUMNS = 40
"""Of a file that are shown."""
CELL = 60
"""Characters of a cell that are shown."""
WORDS = {";": "semicolon", "\t": "tab", "|": "pipe", ",": "comma", " ": "spaces"}
ENCODINGS = ("utf-8", "utf-8-sig", "utf-16", "cp1252", "latin-1", "cp850")
READING = ("separator", "encoding", "sheet")
"""What is said to the reader; the rest to the first look."""
SAID = (*READING, "time_format", "time_zone", "time_unit", "tag", "value")
"""Keys of [data] that can be corrected, beside the column of the time."""
GRID = ("sample_time", "max_gap")
"""Of the even grid that a long export may be put on: numbers in the unit of time."""


@dataclass(frozen=True)
class Hints:
    """What the user says of a data file; what is not said is found."""

    time: str | None = None
    long: bool | None = None
    said: Mapping[str, str | float] = field(default_factory=dict)
    """Some of `SAID` and `GRID`."""

    @classmethod
    def of(cls, given: Mapping[str, Any]) -> Hints:
        """From the fields of a form; empty ones are not said. Raises DataError for numbers that are none."""
        said: dict[str, str | float] = {key: str(given[key]) for key in SAID if given.get(key)}
        said |= {key: _number(str(given[key])) for key in GRID if str(given.get(key) or "").strip()}
        shape = {"long": True, "wide": False}.get(str(given.get("shape", "")))
        return cls(str(given["time"]) if given.get("time") else None, shape, said)


@dataclass(frozen=True, eq=False)
class Preview:
    """A data file at first sight."""

    table: Table
    seen: Seen
    hints: Hints

    @property
    def rows(self) -> list[list[str]]:
        """The first ones, as text."""
        head = self.table.frame.head(ROWS)
        return [[_cell(value) for value in row[:COLUMNS]] for row in head.iter_rows()]

    @property
    def grid_unit(self) -> str:
        """In which the project will count the time between samples."""
        seen = self.seen
        counted = str(self.hints.said.get("time_unit") or guess_counted_unit(seen.time or "") or "s")
        return guess_time_unit(seen.interval) if seen.stamped else counted

    def to_dict(self) -> dict[str, Any]:
        """What the page shows."""
        table, seen = self.table, self.seen
        loops = guess_loops(name for name in seen.names if name != seen.time)
        return {
            "columns": list(table.frame.columns[:COLUMNS]),
            "more_columns": max(len(table.frame.columns) - COLUMNS, 0),
            "rows": self.rows,
            "height": len(table),
            "names": list(table.names),
            "units": dict(table.units),
            "separator": None if table.separator is None else WORDS.get(table.separator, table.separator),
            "encoding": table.encoding,
            "decimal": None if table.separator is None else {",": "comma", ".": "point"}[table.decimal],
            "long": seen.long,
            "time": seen.time,
            "stamped": seen.stamped,
            "grid_unit": self.grid_unit,
            "interval": None if seen.interval is None else _duration(seen.interval),
            "zone": seen.zone,
            "span": seen.span,
            "doubt": seen.doubt,
            "notes": list(dict.fromkeys(seen.notes)),
            "modes": list(seen.modes.values()),
            "loops": [{"pv": loop.pv, "sp": loop.sp, "op": loop.op, "mode": loop.mode} for loop in loops],
            "tags": list(seen.names) if seen.long else [],
        }


def preview(path: Path, hints: Hints) -> Preview:
    """Read a file as `trueplant init` does. Raises DataError."""
    reading = {key: value for key, value in hints.said.items() if key in READING}
    if any(key in hints.said for key in GRID) and not all(key in hints.said for key in GRID):
        raise DataError("the time between samples and the longest gap go together: give both, or none")
    table = read_table(path, **reading)
    return Preview(table, look(table, hints.time, dict(hints.said), hints.long), hints)


def project_text(path: Path, project: Path, hints: Hints) -> str:
    """The text of the first project of a data file, as `trueplant init` writes it. Raises DataError."""
    name = Path(os.path.relpath(path, project.parent)).as_posix()
    return draft_project(name, preview(path, hints).seen)


def command(path: str, project: str, hints: Hints) -> str:
    """How `trueplant init` is asked for the same, as far as it takes that on the command line."""
    import shlex

    options = [("--separator", hints.said.get("separator")), ("--encoding", hints.said.get("encoding"))]
    given = [part for option, value in [*options, ("--time", hints.time)] if value for part in (option, str(value))]
    return shlex.join(["trueplant", "init", path, "--out", project, *given])


def _cell(value: Any) -> str:
    if value is None:
        return ""
    text = f"{value:.10g}" if isinstance(value, float) else str(value)
    return text if len(text) <= CELL else f"{text[: CELL - 1]}…"


def _number(text: str) -> float:
    try:
        value = float(text.replace(",", "."))
    except ValueError:
        value = math.nan
    if not 0 < value < math.inf:
        raise DataError(f"{text[:40]!r} is no length of time: give a number above 0")
    return value


def _duration(seconds: float) -> str:
    for unit, size in (("d", 86400), ("h", 3600), ("min", 60)):
        if seconds >= size:
            return f"{seconds / size:.4g} {unit}"
    return f"{seconds:.4g} s" if seconds >= 1 else f"{seconds * 1e3:.4g} ms"


assert set(WORDS) == set(SEPARATORS)
