"""A lake of Parquet files: one file, a pattern of many, or folders named by their columns (hive)."""

from __future__ import annotations

import glob
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from trueplant.connect.events import events
from trueplant.connect.settings import Settings
from trueplant.connect.source import COLUMNS, TagInfo, Window
from trueplant.errors import DataError, SourceError

if TYPE_CHECKING:
    import polars as pl


class Lake:
    """Only the columns and, as far as the files know their ranges, the rows that are asked for are read."""

    def __init__(self, settings: Settings) -> None:
        import polars as pl

        self._settings = settings
        self._path = settings.path("path")
        self.server = str(self._path)
        if not self._path.is_dir() and not glob.glob(str(self._path), recursive=True):
            raise SourceError(f"{self._path}: there is no such Parquet file: correct data.source.path")
        try:
            self._frame = pl.scan_parquet(str(self._path), hive_partitioning=settings.table.hive)
            have = self._frame.collect_schema()
        except (pl.exceptions.PolarsError, OSError) as error:
            raise SourceError(
                f"{self._path} cannot be read as Parquet ({settings.clean(error)}): check the files"
            ) from None
        named = settings.table.columns
        wanted = list(named or COLUMNS)
        if named is None and COLUMNS[3] not in have:
            wanted = wanted[:3]
        for column in wanted:
            if column not in have:
                raise DataError(
                    f"{self._path} has no column {column!r}: name those of tag, time, value and quality, in this "
                    f"order, as data.source.columns. It has: {', '.join(have)}"
                )
        self._columns, self._types = wanted, have

    def describe(self, tags: Sequence[str]) -> list[TagInfo]:
        return [TagInfo(tag) for tag in tags]

    def read(self, tags: Sequence[str], window: Window) -> Iterator[pl.DataFrame]:
        import polars as pl

        tag, time, *_ = self._columns
        rows = self._frame.filter(pl.col(tag).cast(pl.String).is_in(list(tags)))
        kind = self._types[time]
        if isinstance(kind, pl.Datetime):
            zone = kind.time_zone or self._settings.time_zone
            if zone is not None:
                start, end = (pl.lit(at).dt.convert_time_zone(zone) for at in (window.start, window.end))
                if kind.time_zone is None:  # an hour more: the clock may go back meanwhile
                    start = start.dt.replace_time_zone(None).dt.offset_by("-1h")
                    end = end.dt.replace_time_zone(None).dt.offset_by("1h")
                rows = rows.filter(pl.col(time).is_between(start, end))
        frame = rows.select(self._columns).collect()
        if frame.height:
            table = self._settings.table
            yield events(frame.sort(time, maintain_order=True), self.server, table.quality, self._settings.time_zone)

    def close(self) -> None:
        """Nothing is kept open."""
