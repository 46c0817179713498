"""The command ``accept``: the plant found becomes the project's model."""

from __future__ import annotations

import codecs
from collections.abc import Iterator
from datetime import date
from pathlib import Path

from trueplant.claims import OPTION, sum_of
from trueplant.cli.layout import say_lines
from trueplant.errors import ProjectError, Refused, TrueplantError, UsageError
from trueplant.output import read_results, results_folder, write_files
from trueplant.project import Project
from trueplant.project.accepted import NEWS, Accepted, accepted
from trueplant.result import Result, Status
from trueplant.result.numbers import counted


def accept(saved: Path, named: Path | None, force: bool) -> int:
    """Write the plant of a saved result into its project file, with a copy of the old file beside it."""
    result = read_results(saved)
    folder = results_folder(saved)
    _require_news(result, folder)
    place = _project_of(result, named)
    content = place.read_bytes()
    project = Project.load(place)
    since = [] if force else list(_changed_since(project, result))
    if since:
        raise UsageError(
            f"{'; '.join(since)} since {folder} was written: run the analysis again, or accept it "
            f"all the same with {OPTION}"
        )
    found = accepted(project, result, f"{date.today().isoformat()} (trueplant accept {folder})")
    mark = codecs.BOM_UTF8 if content.startswith(codecs.BOM_UTF8) else b""
    copy = _free(place)
    write_files(place.parent, {copy.name: content, place.name: mark + found.text.encode("utf-8")})
    say_lines(*_told(found, place, copy))
    return 0


def _require_news(result: Result, folder: Path) -> None:
    if result.status == Status.REFUSED:
        raise Refused(f"{folder} is a refusal: no plant was found that could be accepted")
    if not any(element.verdict in NEWS for element in result.elements):
        raise UsageError(f"{folder}: nothing has changed or was found, so the project's model stands as it is")


def _project_of(result: Result, named: Path | None) -> Path:
    place = named or Path(result.provenance.project)
    if named is None and not place.is_file():
        raise UsageError(f"the project of this result ({place}) is not there: name its file with --project")
    if not place.is_file():
        raise ProjectError(f"{place} does not exist or is no file: correct the path after --project")
    return place.resolve()


def _changed_since(project: Project, result: Result) -> Iterator[str]:
    """What of the project, its records and the files of its model is not what was analysed."""
    origin = result.provenance
    if project.sha256 != origin.project_sha256:
        yield f"{project.source} has changed"
    for plan in project.experiments:
        try:
            there = sum_of(plan.path)
        except TrueplantError:
            there = ""
        if there != origin.data_sha256.get(plan.name):
            yield f"{plan.file} {'has changed' if there else 'is no longer there'}"
    for name, digest in origin.model_sha256.items():
        if sum_of(project.folder / name) != digest:
            yield f"{name} has changed"


def _free(place: Path) -> Path:
    """A name for the copy of the old file that nothing has yet."""
    k = 1
    while (copy := place.with_name(f"{place.name}.bak{k if k > 1 else ''}")).exists():
        k += 1
    return copy


def _told(found: Accepted, place: Path, copy: Path) -> Iterator[str]:
    names = ", ".join(f"{e.input} -> {e.output}" for e in found.changed)
    yield f"{place}: the model is now the plant for {counted(len(found.changed), 'element')} ({names})"
    if found.kept:
        yield f"kept, since the data do not answer them: {', '.join(f'{e.input} -> {e.output}' for e in found.kept)}"
    yield f"{copy}: the file as it was; the old lines stand in the new one as comments, too"
