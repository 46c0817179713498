"""How the command line does what a screen does: one line to be pasted into a shell in the folder that was opened."""

from __future__ import annotations

import shlex
from pathlib import PurePosixPath

from trueplant.app.folder import ProjectFile


def command(*words: str) -> str:
    """``trueplant run 'my plant.toml'``."""
    return shlex.join(["trueplant", *words])


def run_line(project: ProjectFile) -> str:
    """The results go where the app puts them: beside the project."""
    return command("run", project.name, *_out(project, "result"))


def track_line(project: ProjectFile, precision: float | None = None) -> str:
    """Likewise."""
    asked = [] if precision is None else ["--precision", f"{precision:g}"]
    return command("track", project.name, *_out(project, "track"), *asked)


def _out(project: ProjectFile, kind: str) -> list[str]:
    """By default results go into the folder that one stands in."""
    place = PurePosixPath(project.name)
    return [] if place.parent == PurePosixPath(".") else ["--out", str(place.with_name(f"{place.stem}-{kind}"))]
