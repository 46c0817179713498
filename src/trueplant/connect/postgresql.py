"""PostgreSQL, and what speaks like it (TimescaleDB): a session that is read-only and limited in time."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any
from urllib.parse import parse_qsl, quote, urlencode, urlsplit, urlunsplit

from trueplant.connect.events import events
from trueplant.connect.settings import Settings, host_of, missing_extra
from trueplant.connect.source import Lost, TagInfo, Window
from trueplant.connect.sql import given, placed
from trueplant.errors import ProjectError

if TYPE_CHECKING:
    import polars as pl

_SEPARATOR = "\x1f"
"""Between tags; a control character that no tag holds."""
_WRITTEN = {
    "tags": f"string_to_array(${{}}::text, chr({ord(_SEPARATOR)}))",
    "from": "${}::text::timestamptz",
    "to": "${}::text::timestamptz",
    "from_unix": "${}::float8",
    "to_unix": "${}::float8",
}
"""Text throughout: the driver binds neither arrays nor moments to all types of columns."""


class PostgreSql:
    """The query of a project, asked of a server."""

    def __init__(self, settings: Settings) -> None:
        try:
            from adbc_driver_postgresql import dbapi
        except ImportError:
            raise missing_extra("postgresql", "adbc-driver-postgresql", "sql") from None
        self._settings = settings
        url = settings.address()
        if urlsplit(url).scheme not in ("postgresql", "postgres"):
            raise ProjectError("the address of data.source must be a URL such as postgresql://reader@host/database")
        self.server = host_of(url)
        self._query, self._names = placed(settings.table.query or "", _WRITTEN)
        try:
            self._connection: Any = dbapi.connect(_limited(url, settings), autocommit=True)
        except dbapi.Error as error:
            raise Lost(settings.clean(error)) from None
        self._errors = dbapi

    def describe(self, tags: Sequence[str]) -> list[TagInfo]:
        return [TagInfo(tag) for tag in tags]

    def read(self, tags: Sequence[str], window: Window) -> Iterator[pl.DataFrame]:
        import polars as pl

        values = given(tags, window, _SEPARATOR.join(tags))
        with self._answering(), contextlib.closing(self._connection.cursor()) as cursor:
            cursor.execute(self._query, [values[name] for name in self._names])
            # without pyarrow the cursor has no rows to give, and from_arrow makes one column of all
            frame = pl.DataFrame(cursor.fetch_arrow())
        where = f"{self.server}, data.source.query"
        if frame.height:
            yield events(frame, where, self._settings.table.quality, self._settings.time_zone)

    def close(self) -> None:
        self._connection.close()

    @contextlib.contextmanager
    def _answering(self) -> Iterator[None]:
        import polars as pl

        try:
            yield
        except self._errors.ProgrammingError as error:
            raise ProjectError(f"data.source.query: {self._settings.clean(error)}") from None
        except (self._errors.Error, pl.exceptions.ComputeError) as error:
            raise Lost(self._settings.clean(error)) from None


def _limited(url: str, settings: Settings) -> str:
    """The URL with the limits of a session: nothing is written, and no statement runs for ever."""
    parts = urlsplit(url)
    said = dict(parse_qsl(parts.query, keep_blank_values=True))
    milliseconds = max(1, round(settings.table.timeout * 1000))
    own = (
        f"-c default_transaction_read_only=on -c statement_timeout={milliseconds} "
        f"-c TimeZone={settings.time_zone or 'UTC'}"
    )
    said["options"] = f"{said['options']} {own}" if "options" in said else own
    said.setdefault("connect_timeout", str(max(2, round(min(settings.table.timeout, 30)))))
    said.setdefault("application_name", "trueplant")
    return urlunsplit(parts._replace(query=urlencode(said, quote_via=quote)))
