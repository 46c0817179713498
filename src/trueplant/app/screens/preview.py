"""The first rows of a data file with what was understood of it, and the project that is made from that."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from trueplant.project.draft import draft_project
from trueplant.project.guess import Seen, guess_counted_unit, guess_loops, guess_time_unit
from trueplant.project.hints import Hints, first_look
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
    return Preview(*first_look(path, hints), hints)


def project_text(path: Path, project: Path, hints: Hints) -> str:
    """The text of the first project of a data file, as `trueplant init` writes it. Raises DataError."""
    name = Path(os.path.relpath(path, project.parent)).as_posix()
    return draft_project(name, preview(path, hints).seen)


def command(path: str, project: str, hints: Hints) -> str:
    """How `trueplant init` is asked for the same."""
    import shlex

    return shlex.join(["trueplant", "init", path, "--out", project, *hints.options])


def _cell(value: Any) -> str:
    if value is None:
        return ""
    text = f"{value:.10g}" if isinstance(value, float) else str(value)
    return text if len(text) <= CELL else f"{text[: CELL - 1]}…"


def _duration(seconds: float) -> str:
    for unit, size in (("d", 86400), ("h", 3600), ("min", 60)):
        if seconds >= size:
            return f"{seconds / size:.4g} {unit}"
    return f"{seconds:.4g} s" if seconds >= 1 else f"{seconds * 1e3:.4g} ms"


assert set(WORDS) == set(SEPARATORS)
