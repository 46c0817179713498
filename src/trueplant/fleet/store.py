"""The store of an audit: a JSON file a loop, written beside its place and renamed: it is whole or absent."""

from __future__ import annotations

import json
import os
import re
import secrets
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from trueplant.errors import OutputError
from trueplant.files import runs
from trueplant.fleet.row import LoopRow
from trueplant.result.codec import build, plain

if TYPE_CHECKING:
    import polars as pl

LOOPS, RESULTS, TABLE, PAGE, LAST = "loops", "results", "audit.parquet", "index.html", "last.parquet"
_WAITING = re.compile(r"\..+\.(?P<process>\d+)-[0-9a-f]+\.part")


@dataclass(frozen=True)
class Store:
    """The folder of an audit: loops/<key>.json, results/<key>/, and run=<time>/ for each audit."""

    folder: Path

    def results(self, key: str) -> Path:
        """Where the whole result of a loop is."""
        return self.folder / RESULTS / key

    def write(self, row: LoopRow) -> None:
        """Keep a row, in place of an older one of the same key. Raises OutputError."""
        text = json.dumps(plain(row), indent=1, ensure_ascii=False, allow_nan=False)
        write_whole(self.folder / LOOPS / f"{row.key}.json", text.encode("utf-8", "backslashreplace"))

    def read(self, key: str) -> LoopRow | None:
        """The row of a key; None where there is none that this version understands."""
        try:
            document = json.loads((self.folder / LOOPS / f"{key}.json").read_text(encoding="utf-8"))
            return build(LoopRow, document)
        except (OSError, ValueError, TypeError, KeyError):
            return None

    @property
    def used(self) -> bool:
        """Is any row there?"""
        return (self.folder / LOOPS).is_dir()

    def clean(self) -> None:
        """Remove what processes that were killed had begun to write."""
        for left in (self.folder / LOOPS).glob(".*.part"):
            found = _WAITING.fullmatch(left.name)
            if found and not runs(int(found["process"])):
                left.unlink(missing_ok=True)

    def runs(self) -> list[Path]:
        """The folders of whole audits, the oldest first."""
        return sorted(path.parent for path in self.folder.glob(f"run=*/{TABLE}"))

    def last(self) -> pl.DataFrame | None:
        """What was known of every loop after the last audit (see `rank.known_after`), or else the table of that; None
        without any that can be read."""
        import polars as pl

        for file in (self.folder / LAST, *(run / TABLE for run in reversed(self.runs()))):
            try:
                return pl.read_parquet(file, hive_partitioning=False)
            except (OSError, pl.exceptions.PolarsError):
                continue
        return None


def write_whole(place: Path, content: bytes) -> None:
    """Write a file beside its place and rename it. Raises OutputError."""
    beside = place.with_name(f".{place.name}.{os.getpid()}-{secrets.token_hex(4)}.part")
    try:
        place.parent.mkdir(parents=True, exist_ok=True)
        with open(beside, "xb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        beside.replace(place)
    except OSError as error:
        beside.unlink(missing_ok=True)
        raise OutputError(f"cannot write {place} ({error.strerror or error}): name another folder with --out") from None
