"""The plant over a long record: since when, how fast, step or drift."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from starlette.concurrency import run_in_threadpool
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from trueplant.app.command_lines import track_line
from trueplant.app.downloads import download
from trueplant.app.errands import OUT, errands_of
from trueplant.app.folder import ProjectFile
from trueplant.app.fragments import fragment
from trueplant.app.pages import body, folder_of, ok, page, project_of, sandboxed, url
from trueplant.errors import UsageError
from trueplant.notebook.errands import TRACK, TRACK_PAGE
from trueplant.result import ElementHistory, Track, build
from trueplant.result.track_words import change_sentence, refused_stretches, told_reasons, word_of

PRECISION = 10
"""Percent, as the command line has it by default."""
MARKS = {
    ElementHistory.CONSTANT: ("unchanged", "●"),
    ElementHistory.NOT_IDENTIFIABLE: ("unknown", "?"),
}
"""Colour and symbol; anything else has changed."""


async def track(request: Request) -> Response:
    """The page, with the track that is there."""
    project = project_of(request)
    found = await run_in_threadpool(_saved, project)
    shown = None
    if found is not None:
        links = {name: url(request, f"track/{name}") for name in ("page", "file")}
        shown = fragment(
            "track_body.html.j2",
            track=found,
            elements=[(e, *_mark(e.history, word_of(e))) for e in found.elements],
            changes=[(c, change_sentence(c, found.calendar)) for c in found.changes],
            refused=refused_stretches(found),
            told=told_reasons(found),
            links=links,
        )
    errand = errands_of(request).of("track", project)
    told = {"errand": None if errand is None else errand.told(folder_of(request).plain)}
    return page(
        request,
        "track.html.j2",
        screen="out",
        body=shown,
        told=told,
        precision=PRECISION,
        line=track_line(project),
    )


async def start(request: Request) -> Response:
    """Begin; a track that is there is replaced when the new one is done."""
    project = project_of(request)
    precision = (await body(request)).get("precision", PRECISION)
    if not isinstance(precision, int | float) or not 0 < precision <= 100:
        raise HTTPException(400, "The precision is a number of percent above 0 and up to 100.")
    errand = await run_in_threadpool(lambda: errands_of(request).start("track", project, precision=float(precision)))
    return ok(errand.told(folder_of(request).plain))


async def state(request: Request) -> Response:
    """How far it is."""
    errand = errands_of(request).of("track", project_of(request))
    return ok({"state": "none"} if errand is None else errand.told(folder_of(request).plain))


async def cancel(request: Request) -> Response:
    """End it; a track that is there stays."""
    project = project_of(request)
    await run_in_threadpool(errands_of(request).cancel, "track", project)
    return await state(request)


async def whole(request: Request) -> Response:
    """The page of the track with its figures, in a tab of its own."""
    return sandboxed(await run_in_threadpool(_content, project_of(request), TRACK_PAGE))


async def file(request: Request) -> Response:
    """track.json."""
    project = project_of(request)
    return download(await run_in_threadpool(_content, project, TRACK), f"{project.path.stem}-{TRACK}")


def _folder(project: ProjectFile) -> Path:
    return project.path.with_name(f"{project.path.stem}{OUT['track']}")


def _content(project: ProjectFile, name: str) -> bytes:
    place = _folder(project) / name
    if not place.is_file():
        raise HTTPException(404, "This project was not tracked yet.")
    return place.read_bytes()


def _saved(project: ProjectFile) -> Track | None:
    place = _folder(project) / TRACK
    if not place.is_file():
        return None
    try:
        document: dict[str, Any] = json.loads(place.read_text(encoding="utf-8"))
        return build(Track, document)
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise UsageError(f"{place} is no track of this version ({error}): track again") from None


def _mark(history: ElementHistory, word: str) -> tuple[str, str, str]:
    """Colour, symbol and word; what is constant but off the model is no agreement."""
    style, symbol = MARKS.get(history, ("changed", "▲"))
    return ("changed", "▲", word) if word != history else (style, symbol, word)


ROUTES = [
    Route("/track", track),
    Route("/track/page", whole),
    Route("/track/file", file),
    Route("/api/track/start", start, methods=["POST"]),
    Route("/api/track/cancel", cancel, methods=["POST"]),
    Route("/api/track/state", state),
]
