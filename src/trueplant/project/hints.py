"""What somebody says of a data file that it does not show of itself, and the first look that goes by it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from trueplant.errors import DataError, UsageError
from trueplant.printable import printable
from trueplant.project.guess import Seen
from trueplant.project.look import look
from trueplant.record.readers import read_table
from trueplant.record.table import Table

READING = ("separator", "encoding", "sheet")
"""What is said to the reader; the rest to the first look."""
SAID = (*READING, "time_format", "time_zone", "time_unit", "tag", "value")
"""Keys of [data] that can be said, beside the column of the time."""
GRID = ("sample_time", "max_gap")
"""Of the even grid that a long export may be put on: numbers in the unit of time."""
OWN = ("separator", "encoding")
"""Those that have an option of their own."""


@dataclass(frozen=True)
class Hints:
    """What the user says of a data file; what is not said is found."""

    time: str | None = None
    """The column of the time."""
    long: bool | None = None
    """Does it list tags below each other?"""
    said: Mapping[str, str | float] = field(default_factory=dict)
    """Some of `SAID` and `GRID`, which a project file has to say too."""

    @classmethod
    def of(cls, given: Mapping[str, Any]) -> Hints:
        """From fields of these names, with time and shape ("long" or "wide"); empty ones are not said.

        Raises DataError for numbers that are none.
        """
        said: dict[str, str | float] = {key: str(given[key]) for key in SAID if given.get(key)}
        said |= {key: _number(str(given[key])) for key in GRID if str(given.get(key) or "").strip()}
        if any(key in said for key in GRID) and not all(key in said for key in GRID):
            raise DataError(
                "the time between samples (sample_time) and the longest gap (max_gap) go together: give both, or none"
            )
        shape = {"long": True, "wide": False}.get(str(given.get("shape") or ""))
        return cls(str(given["time"]) if given.get("time") else None, shape, said)

    @property
    def options(self) -> list[str]:
        """How `trueplant init` is told the same."""
        told = [] if self.time is None else ["--time", self.time]
        for key, value in self.said.items():
            text = f"{value:.12g}" if isinstance(value, float) else value
            told += [f"--{key}", text] if key in OWN else ["--set", f"{key}={text}"]
        return told if self.long is None else [*told, "--long" if self.long else "--wide"]


def keys_said(pairs: Sequence[str]) -> dict[str, str]:
    """What "key=value" says. Raises UsageError."""
    said = {}
    for pair in pairs:
        key, sign, value = (part.strip() for part in pair.partition("="))
        if key not in (*SAID, *GRID) or not sign or not value:
            raise UsageError(
                f"--set {printable(pair)}: it takes KEY=VALUE, as time_zone=Europe/Oslo; the keys are "
                f"{', '.join((*SAID, *GRID))}"
            )
        said[key] = value
    return said


def first_look(path: Path, hints: Hints) -> tuple[Table, Seen]:
    """A data file as it is read, and what it shows. Raises DataError."""
    reading = {key: str(value) for key, value in hints.said.items() if key in READING}
    table = read_table(path, **reading)
    return table, look(table, hints.time, dict(hints.said), hints.long)


def _number(text: str) -> float:
    try:
        value = float(text.replace(",", "."))
    except ValueError:
        value = math.nan
    if not 0 < value < math.inf:
        raise DataError(f"{text[:40]!r} is no length of time: give a number above 0")
    return value
