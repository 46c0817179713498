"""A snapshot on disk: events in a Parquet file, and beside it a JSON file that says where they came from.

Both are written whole beside their places and then moved there, the JSON file first. It bears the SHA-256 of the
events, so that whatever a kill leaves is known for what it is: nothing, the old snapshot, or none that counts.
"""

from __future__ import annotations

import hashlib
import io
import json
import os
import re
import secrets
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from trueplant.connect import levels
from trueplant.errors import OutputError
from trueplant.files import runs

if TYPE_CHECKING:
    import polars as pl

WHAT = "snapshot of a historian"
_WAITING = re.compile(r"\.(?P<name>.+)\.(?P<process>\d+)-[0-9a-f]+\.part")


@dataclass(frozen=True)
class Snapshot:
    """Where a snapshot is, or would be."""

    events: Path

    @property
    def about(self) -> Path:
        """The JSON file."""
        return self.events.with_name(f"{self.events.name}.json")

    def told(self) -> dict[str, Any] | None:
        """What the JSON file says; None where there is none that trueplant wrote."""
        try:
            document = json.loads(self.about.read_text(encoding="utf-8"))
        except (OSError, ValueError, RecursionError):
            return None
        return document if isinstance(document, dict) and document.get("what") == WHAT else None

    def holds(self, query: Mapping[str, Any]) -> bool:
        """Is it there, whole, and the answer to this query?"""
        told = self.told()
        if (
            told is None
            or told.get("schema") != levels.SCHEMA
            or told.get("query") != query
            or not self.events.is_file()
        ):
            return False
        with open(self.events, "rb") as file:
            return told.get("sha256") == hashlib.file_digest(file, "sha256").hexdigest()

    def check_free(self) -> None:
        """Raise OutputError where a file that is no snapshot stands in its place; remove what a kill left behind."""
        for place in (self.events, self.about):
            if place.exists() and self.told() is None:
                raise OutputError(
                    f"{place} is there already, and no snapshot that trueplant wrote: move it away, or name another "
                    "place with data.source.snapshot"
                )
        for left in self.events.parent.glob(".*.part") if self.events.parent.is_dir() else ():
            found = _WAITING.fullmatch(left.name)
            if found and found["name"] in (self.events.name, self.about.name) and not runs(int(found["process"])):
                left.unlink(missing_ok=True)

    def write(self, events: pl.DataFrame, about: Mapping[str, Any]) -> dict[str, Any]:
        """Both files or none; returns what the JSON file says. Raises OutputError."""
        buffer = io.BytesIO()
        events.write_parquet(buffer, compression="zstd")
        content = buffer.getvalue()
        document = {
            "what": WHAT,
            "schema": levels.SCHEMA,
            "file": self.events.name,
            "sha256": hashlib.sha256(content).hexdigest(),
        } | dict(about)
        text = json.dumps(document, indent=1, ensure_ascii=False, allow_nan=False) + "\n"
        token = f"{os.getpid()}-{secrets.token_hex(4)}"
        waiting = {self.about: text.encode(), self.events: content}
        beside = {place: place.with_name(f".{place.name}.{token}.part") for place in waiting}
        try:
            self.events.parent.mkdir(parents=True, exist_ok=True)
            for place, data in waiting.items():
                with open(beside[place], "xb") as file:
                    file.write(data)
                    file.flush()
                    os.fsync(file.fileno())
            for place in waiting:
                beside[place].replace(place)
        except OSError as error:
            raise OutputError(
                f"cannot write {self.events} ({error.strerror or error}): name another place with data.source.snapshot"
            ) from None
        finally:
            for left in beside.values():
                left.unlink(missing_ok=True)
        return document
