"""The key of a loop: the same version, project and data have the same answer, wherever their files are."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

from trueplant.errors import DataError
from trueplant.files import opened
from trueplant.fleet import levels
from trueplant.project import Project
from trueplant.version import __version__


def key_of(project: Project, finds: bool) -> str:
    """SHA-256 over the version, the project without paths, and the content of its files. Raises DataError.

    `finds` is whether the audit looks for stretches with moves. A historian's snapshot has to be there.
    """
    said = project.model_dump(by_alias=True, exclude_unset=True, mode="json")
    said.pop("simulate", None)
    data = said.get("data", {})
    # what came out of a historian counts, not how it was asked
    for key in ("source", "files", "from", "to"):
        data.pop(key, None)
    names = list(dict.fromkeys(plan.file for plan in project.experiments))
    places = {name: f"record {k}" for k, name in enumerate(names)}
    for entry in (*said.get("experiment", ()), *data.get("exclude", ())):
        if entry.get("file") in places:
            entry["file"] = places[entry["file"]]
    for entry in said.get("model", ()):
        for form in ("step", "state_space"):
            if isinstance(entry.get(form), str):
                entry[form] = sum_of(project.folder / entry[form])
    records = [name if name.startswith("dataset:") else sum_of(project.folder / name) for name in names]
    return _sum({"version": __version__, "finds": finds, "project": said, "records": records})


def key_without_data(name: str, project: Path) -> str:
    """Of a loop whose data nobody could read, or that killed the process before they were read."""
    text = project.read_bytes().decode("utf-8", "replace") if project.is_file() else ""
    return _sum({"version": __version__, "loop": name, "text": text})


def sum_of(file: Path) -> str:
    """SHA-256 of a file; one that stays as it is is read once. Raises DataError."""
    try:
        status = file.stat()
    except (OSError, ValueError):
        status = None
    return _read(file, *(() if status is None else (status.st_size, status.st_mtime_ns, status.st_ino)))


@lru_cache(maxsize=1024)
def _read(file: Path, *status: int) -> str:
    found = hashlib.sha256()
    with opened(file, DataError) as content:
        while part := content.read(levels.AT_ONCE):
            found.update(part)
    return found.hexdigest()


def _sum(said: Mapping[str, Any]) -> str:
    return hashlib.sha256(json.dumps(said, sort_keys=True).encode()).hexdigest()
