"""The saved results in the folder that was opened: which one a page shows, and which there are."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime
from functools import lru_cache
from pathlib import Path

from starlette.requests import Request

from trueplant.app import levels
from trueplant.app.folder import Folder, Outside, ProjectFile
from trueplant.app.pages import folder_of, project_of
from trueplant.output import RESULT, read_results
from trueplant.result import Result

KEPT = 4
"""Results that are kept read: those of the pages that are open at a time; each takes some MB."""


@dataclass(frozen=True)
class Saved:
    """One saved result."""

    name: str
    """Its folder, relative to the one that was opened."""
    folder: Path
    result: Result
    project: ProjectFile | None
    """None where the page names none."""

    @property
    def is_own(self) -> bool:
        """Is it the one that the project's last run wrote?"""
        return self.project is not None and self.folder == self.project.out

    @property
    def is_stale(self) -> bool:
        """Has the project file changed since?"""
        project = self.project
        return project is not None and self.is_own and project.version != self.result.provenance.project_sha256


_SUM = 64
"""Letters of a SHA-256."""


@dataclass(frozen=True)
class Listed:
    """One of the saved results, to be chosen from."""

    name: str
    headline: str
    when: str

    @property
    def label(self) -> str:
        """Its folder and when it was written; of a name that is a sum, as audits give them, the beginning."""
        above, slash, last = self.name.rpartition("/")
        return f"{above}{slash}{last if len(last) < _SUM else f'{last[:8]}…'}, {self.when}"


def saved_of(request: Request) -> Saved | None:
    """That of ``?result=``, else of the project's last run; None where it has not run yet.

    Raises HTTPException where neither is named, Outside for a folder that is not inside, and UsageError where what is
    there cannot be read.
    """
    named = request.query_params.get("result", "")
    folder = folder_of(request)
    project = project_of(request) if request.query_params.get("project") or not named else None
    if named:
        place = folder.path(named)
        if not (place / RESULT).is_file():
            raise Outside(f"there is no saved result in {named}")
    else:
        assert project is not None  # else project_of has raised
        place = project.out
    result = read_saved(place)
    return None if result is None else Saved(folder.name(place), place, result, project)


def read_saved(place: Path) -> Result | None:
    """The result in a folder, None without one; read again only when it has changed."""
    try:
        seen = os.stat(place / RESULT)
    except OSError:
        return None
    return _read(place, seen.st_mtime_ns, seen.st_size)


@lru_cache(maxsize=KEPT)
def _read(place: Path, changed: int, size: int) -> Result:
    return read_results(place)


def listed(folder: Folder) -> list[Listed]:
    """All saved results, the newest first."""
    found = [(place.stat().st_mtime, place) for place in _places(folder)]
    return [
        Listed(folder.name(place.parent), _headline(place), f"{datetime.fromtimestamp(when):%Y-%m-%d %H:%M}")
        for when, place in sorted(found, key=lambda one: one[0], reverse=True)
    ]


def _places(folder: Folder) -> Iterator[Path]:
    yield from files_named(folder, RESULT)


def files_named(folder: Folder, name: str) -> Iterator[Path]:
    """Files of that name in the folder, no deeper than projects are looked for."""
    count = 0
    for place, below, files in os.walk(folder.root):
        depth = len(Path(place).relative_to(folder.root).parts)
        below[:] = sorted(one for one in below if not one.startswith(".") and depth < levels.DEEPEST)
        count += len(files)
        if name in files and Path(place, name).resolve().is_relative_to(folder.root):
            yield Path(place, name)
        if count > levels.MOST_FILES:
            return


def _headline(place: Path) -> str:
    """Of a result.json, without what else it holds; empty where it cannot be read."""
    try:
        return str(json.loads(place.read_text(encoding="utf-8")).get("headline", ""))
    except (OSError, ValueError, AttributeError):
        return ""
