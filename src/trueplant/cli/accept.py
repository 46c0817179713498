"""The command ``accept``: the plant found becomes the project's model."""

from __future__ import annotations

import codecs
from pathlib import Path

from trueplant.cli.layout import say_lines
from trueplant.errors import ProjectError, UsageError
from trueplant.notebook.accepting import accepting, free_copy, require_news, told_accepted
from trueplant.output import read_results, results_folder, write_files
from trueplant.project import Project
from trueplant.result import Result


def accept(saved: Path, named: Path | None, force: bool) -> int:
    """Write the plant of a saved result into its project file, with a copy of the old file beside it."""
    result = read_results(saved)
    folder = results_folder(saved)
    require_news(result, folder)
    place = _project_of(result, named)
    content = place.read_bytes()
    found = accepting(result, Project.load(place), folder, force)
    mark = codecs.BOM_UTF8 if content.startswith(codecs.BOM_UTF8) else b""
    copy = free_copy(place)
    write_files(place.parent, {copy.name: content, place.name: mark + found.text.encode("utf-8")})
    say_lines(*told_accepted(found, place, copy))
    return 0


def _project_of(result: Result, named: Path | None) -> Path:
    place = named or Path(result.provenance.project)
    if named is None and not place.is_file():
        raise UsageError(f"the project of this result ({place}) is not there: name its file with --project")
    if not place.is_file():
        raise ProjectError(f"{place} does not exist or is no file: correct the path after --project")
    return place.resolve()
