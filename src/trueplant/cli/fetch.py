"""The command ``fetch``."""

from __future__ import annotations

from pathlib import Path

from trueplant.cli.analyse import saying
from trueplant.cli.layout import say_lines
from trueplant.connect import Fetched
from trueplant.project.project import Project


def fetch(path: Path, refresh: bool) -> int:
    """Read the historian of a project, and say what came of it."""
    found = _fetch(path, refresh)
    say_lines(f"{found.path}: {'' if found.new else 'there already, '}{found.about['events']} events")
    for tag in found.about["tags"]:
        doubtful = [f"{tag[word]} {word}" for word in ("uncertain", "bad") if tag[word]]
        say_lines(f"  {tag['tag']}: {', '.join([str(tag['events']), *doubtful])}, {tag['first']} to {tag['last']}")
    if not found.new:
        say_lines("read the historian again with --refresh")
    return 0


def read_again(path: Path) -> None:
    """The same in silence, for a command that goes on from there. A project without a historian has no snapshot."""
    _fetch(path, refresh=True)


def _fetch(path: Path, refresh: bool) -> Fetched:
    from trueplant.connect import fetch

    project = Project.load(path)
    with saying() as say:
        return fetch(project, refresh, say)
