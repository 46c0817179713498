"""SQLite: a file that is opened to be read only."""

from __future__ import annotations

import contextlib
import json
import sqlite3
import time
from collections.abc import Iterator, Sequence
from datetime import datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Any

from trueplant.calendar import zone_of
from trueplant.connect import levels
from trueplant.connect.events import events
from trueplant.connect.settings import Settings
from trueplant.connect.source import Lost, TagInfo, Window
from trueplant.connect.sql import given, placed
from trueplant.errors import ProjectError, SourceError

if TYPE_CHECKING:
    import polars as pl

_WRITTEN = {
    "tags": "(select value from json_each(?{}))",
    **{name: "?{}" for name in ("from", "to", "from_unix", "to_unix")},
}


class Sqlite:
    """The query of a project, asked of a file.

    The standard library's module is used: a driver that hands columns over whole fails on a text cell among numbers.
    """

    def __init__(self, settings: Settings) -> None:
        self._settings, self._path = settings, settings.path("path")
        self.server = str(self._path)
        if not self._path.is_file():
            raise SourceError(f"{self._path} does not exist: correct data.source.path")
        self._query, self._names = placed(settings.table.query or "", _WRITTEN)
        uri = f"{Path(self._path).resolve().as_uri()}?mode=ro"
        self._connection = sqlite3.connect(uri, uri=True, timeout=settings.table.timeout)
        self._until = 0.0
        self._connection.set_progress_handler(lambda: time.monotonic() > self._until, levels.SQLITE_STEPS)

    def describe(self, tags: Sequence[str]) -> list[TagInfo]:
        return [TagInfo(tag) for tag in tags]

    def read(self, tags: Sequence[str], window: Window) -> Iterator[pl.DataFrame]:
        margin = timedelta(seconds=levels.SQLITE_MARGIN)
        wide = Window(window.start - margin, window.end + margin)
        values = given(tags, wide, json.dumps(list(tags))) | {
            "from": self._clock(wide.start),
            "to": self._clock(wide.end),
        }
        self._until = time.monotonic() + self._settings.table.timeout
        with self._answering(), contextlib.closing(self._connection.cursor()) as cursor:
            cursor.execute(self._query, [values[name] for name in self._names])
            names = [column[0] for column in cursor.description]
            while rows := cursor.fetchmany(levels.ROWS):
                yield self._page(names, rows)

    def close(self) -> None:
        self._connection.close()

    def _clock(self, moment: datetime) -> str:
        """A moment as the stamps of the file are written: by their clock, without an offset."""
        zone = self._settings.time_zone
        local = moment if zone is None else moment.astimezone(zone_of(zone))
        return local.strftime("%Y-%m-%d %H:%M:%S.%f")

    def _page(self, names: list[str], rows: list[tuple[Any, ...]]) -> pl.DataFrame:
        import polars as pl

        # a column may hold numbers in some rows and text in others
        columns = [pl.Series(f"{k}", column, strict=False) for k, column in enumerate(zip(*rows, strict=True))]
        if len(columns) > 2:
            columns[2] = _numbers(rows)
        table = self._settings.table
        where = f"{self.server}, data.source.query"
        if len(columns) > 1 and columns[1].dtype == pl.Null:
            columns[1] = columns[1].cast(pl.String)
        return events(pl.DataFrame(columns), where, table.quality, self._settings.time_zone)

    @contextlib.contextmanager
    def _answering(self) -> Iterator[None]:
        try:
            yield
        except sqlite3.OperationalError as error:
            code = getattr(error, "sqlite_errorcode", sqlite3.SQLITE_ERROR) & 0xFF
            if code in (sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED):
                raise Lost(f"{self._path} is locked by another program") from None
            if code == sqlite3.SQLITE_INTERRUPT:
                seconds = self._settings.table.timeout
                raise SourceError(
                    f"{self._path} did not answer within {seconds:g} s: an index on tag and time helps, or set "
                    "data.source.timeout"
                ) from None
            if code == sqlite3.SQLITE_READONLY:
                raise ProjectError("data.source.query: would write, and historians are only read") from None
            raise ProjectError(f"data.source.query: {self._settings.clean(error)}") from None
        except sqlite3.DatabaseError as error:
            text = (
                f"{self._path} cannot be read as an SQLite file ({self._settings.clean(error)}): check data.source.path"
            )
            raise SourceError(text) from None


def _numbers(rows: list[tuple[Any, ...]]) -> pl.Series:
    """The third column; text that is no number becomes none, unless all of it is text."""
    import polars as pl

    column = [row[2] for row in rows]
    kinds = {type(cell) for cell in column}
    if kinds <= {int, float, type(None)}:
        return pl.Series("2", column, dtype=pl.Float64, strict=False)
    return pl.Series("2", [None if cell is None else str(cell) for cell in column], dtype=pl.String)
