"""What a historian is to the rest: it describes tags and reads their events."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from enum import StrEnum
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    import polars as pl

COLUMNS = ("tag", "time", "value", "quality")
"""Of a page: text, datetime in us UTC, float64 (null where there is none), one of `Quality`."""


class Quality(StrEnum):
    """What a source says of a value, in words: numbers alone would have to be guessed at."""

    GOOD = "good"
    UNCERTAIN = "uncertain"
    BAD = "bad"


class Lost(Exception):
    """The connection was lost or the server is busy: worth another attempt. `pause` is what the server asks for."""

    def __init__(self, message: str, pause: float = 0.0) -> None:
        super().__init__(message)
        self.pause = pause


@dataclass(frozen=True)
class TagInfo:
    """What a source tells of a tag; None where it says nothing."""

    name: str
    """As the source calls it."""
    unit: str | None = None
    span: tuple[float, float] | None = None
    step: bool | None = None
    """Does its value hold until the next event?"""
    states: Mapping[int, str] = field(default_factory=dict)
    """Names of the values of a digital tag."""


@dataclass(frozen=True)
class Window:
    """A stretch of time in UTC: from start up to, but without, end."""

    start: datetime
    end: datetime

    def slices(self, seconds: float) -> Iterator[Window]:
        """Its parts of this length; the last one is shorter."""
        start = self.start
        while start < self.end:
            end = min(start + timedelta(seconds=seconds), self.end)
            yield Window(start, end)
            start = end


class Source(Protocol):
    """A historian that is open. Neither it nor its `server` shows a secret.

    Its methods raise `Lost` where another attempt may help, and SourceError, DataError or ProjectError where not.
    """

    @property
    def server(self) -> str:
        """What is read, in words: host, file or folder."""

    def describe(self, tags: Sequence[str]) -> list[TagInfo]:
        """One a tag, in their order."""

    def read(self, tags: Sequence[str], window: Window) -> Iterator[pl.DataFrame]:
        """The events of the window in pages of bounded size with the columns `COLUMNS`.

        In time order for each tag. An event may come twice, and some beside the window.
        """

    def close(self) -> None:
        """End the connection; it is not used after that."""
