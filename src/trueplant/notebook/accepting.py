"""The plant found made the project's model: what stands against it, and what is written."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import date
from pathlib import Path

from trueplant.claims import OPTION, sum_of
from trueplant.errors import Refused, TrueplantError, UsageError
from trueplant.project import Project
from trueplant.project.accepted import NEWS, Accepted, accepted
from trueplant.result import Result, Status
from trueplant.result.numbers import counted


def require_news(result: Result, folder: Path | str) -> None:
    """Raise Refused for a refusal, and UsageError where nothing changed or was found. `folder` is the result's."""
    if result.status == Status.REFUSED:
        raise Refused(f"{folder} is a refusal: no plant was found that could be accepted")
    if not any(element.verdict in NEWS for element in result.elements):
        raise UsageError(f"{folder}: nothing has changed or was found, so the project's model stands as it is")


def accepting(result: Result, project: Project, folder: Path | str, force: bool = False) -> Accepted:
    """The new text of the project file. Raises UsageError where the project, its data or the files of its model have
    changed since the analysis (not with `force`), and what `accepted` raises."""
    require_news(result, folder)
    since = [] if force else list(changed_since(project, result))
    if since:
        raise UsageError(
            f"{'; '.join(since)} since {folder} was written: run the analysis again, or accept it "
            f"all the same with {OPTION}"
        )
    return accepted(project, result, f"{date.today().isoformat()} (trueplant accept {folder})")


def changed_since(project: Project, result: Result) -> Iterator[str]:
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


def free_copy(place: Path) -> Path:
    """A name for the copy of the old file that nothing has yet."""
    k = 1
    while (copy := place.with_name(f"{place.name}.bak{k if k > 1 else ''}")).exists():
        k += 1
    return copy


def told_accepted(found: Accepted, place: Path | str, copy: Path | str) -> Iterator[str]:
    """What was done, in lines."""
    names = ", ".join(f"{e.input} -> {e.output}" for e in found.changed)
    yield f"{place}: the model is now the plant for {counted(len(found.changed), 'element')} ({names})"
    if found.kept:
        yield f"kept as they are: {', '.join(f'{e.input} -> {e.output} ({e.verdict})' for e in found.kept)}"
    yield from (f"look at it before you rely on it: {doubt}" for doubt in found.doubts)
    yield f"{copy}: the file as it was; the old lines stand in the new one as comments, too"
