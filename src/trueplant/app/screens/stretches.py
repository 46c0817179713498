"""Stretches that are left out of a record on the screen Trends, and samples that are used in spite of the check."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from starlette.concurrency import run_in_threadpool
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from trueplant.app.folder import ProjectFile
from trueplant.app.pages import body, ok, project_of
from trueplant.app.screens import edits
from trueplant.app.screens.asking import asked_by, seen_by, shown_to
from trueplant.app.screens.struck import overruled
from trueplant.errors import DataError, ProjectError
from trueplant.project.exclusions import all_but_usable, moment_of


async def _changed(request: Request, file: ProjectFile, version: Any, edit: Any, **more: Any) -> Response:
    now = await run_in_threadpool(file.change, edit, version)
    return ok({"version": now, "can_undo": file.can_undo, "can_redo": file.can_redo, **more})


async def _exclude(request: Request) -> Response:
    given, seen = await body(request), seen_by(request)

    def entry() -> tuple[ProjectFile, dict[str, Any], str]:
        asked = asked_by(request, given.get("record", 0))
        shown = shown_to(seen, asked)
        start, end = _ends(given)
        inside = shown.first_last(start, end)
        if inside is None:
            raise DataError(f"no sample lies from {shown.calendar.span(start, end)}: choose a longer stretch")
        first, last = inside
        if first == last:  # a stretch has an end after its beginning
            last = first + shown.step / 2
        named = {"file": asked.plan.file} if len(asked.project.experiments) > 1 else {}
        calendar = shown.calendar
        moments = (moment_of(asked.project, calendar, at) for at in (first, last))
        return asked.file, named | dict(zip(("from", "to"), moments, strict=True)), calendar.span(first, last)

    file, stretch, told = await run_in_threadpool(entry)
    return await _changed(
        request, file, given.get("version"), lambda text: edits.exclude(text, [stretch]), excluded=told
    )


def _ends(given: Mapping[str, Any]) -> tuple[float, float]:
    ends = [given.get("from"), given.get("to")]
    if not all(isinstance(end, (int, float)) and math.isfinite(end) for end in ends):
        raise HTTPException(400, "Say from when and to when.")
    start, end = (float(end) for end in ends if end is not None)
    if end < start:
        raise HTTPException(400, "The end lies before the beginning: swap them.")
    return start, end


async def _include(request: Request) -> Response:
    given = await body(request)
    place = given.get("place")
    if not isinstance(place, int):
        raise HTTPException(400, "Say which stretch.")
    return await _changed(
        request, project_of(request), given.get("version"), lambda text: edits.include(text, int(place))
    )


async def _overrule(request: Request) -> Response:
    given = await body(request)
    file = project_of(request)
    project = await run_in_threadpool(file.load)
    edit = overruled(project, str(given.get("signal")), str(given.get("reason")))
    return await _changed(request, file, given.get("version"), edit)


async def _write(request: Request) -> Response:
    """Exclude all but the stretches that were found, as ``trueplant check --find --write`` does."""
    given, seen = await body(request), seen_by(request)

    def entries() -> tuple[ProjectFile, list[dict[str, Any]]]:
        asked = asked_by(request)
        question = seen.aside.known("find", asked.file.path, asked.version)
        if question is None or question.answer is None:
            raise ProjectError("the project has changed since windows were looked for: look for them again")
        return asked.file, all_but_usable(asked.project, question.answer)

    file, stretches = await run_in_threadpool(entries)
    if not stretches:
        raise ProjectError("there is nothing to write: all else is excluded already")
    return await _changed(
        request, file, given.get("version"), lambda text: edits.exclude(text, stretches), count=len(stretches)
    )


ROUTES = [
    Route("/api/trends/exclude", _exclude, methods=["POST"]),
    Route("/api/trends/include", _include, methods=["POST"]),
    Route("/api/trends/overrule", _overrule, methods=["POST"]),
    Route("/api/trends/write", _write, methods=["POST"]),
]
