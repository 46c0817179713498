"""Settings tried before they are entered: what they do beside today's, on all plants that may be."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from starlette.concurrency import run_in_threadpool
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from trueplant.app.folder import ProjectFile
from trueplant.app.pages import body, ok, page, project_of
from trueplant.app.saved import Saved, saved_of
from trueplant.app.screens.candidates import as_text, candidate, with_candidates, with_tuning
from trueplant.app.warm import warm_of
from trueplant.errors import TrueplantError


async def whatif(request: Request) -> Response:
    """The page. What it is about comes from the process of the what-ifs, which is made ready meanwhile."""
    project = project_of(request)
    saved = await run_in_threadpool(saved_of, request)
    if saved is not None:
        await run_in_threadpool(warm_of(request.app).start)
    result = None if saved is None else {"name": saved.name, "stale": saved.is_stale}
    return page(request, "whatif.html.j2", screen="whatif", result=result, name=project.path.name)


async def _saved(request: Request) -> Saved:
    saved = await run_in_threadpool(saved_of, request)
    if saved is None:
        raise HTTPException(404, "The project has no result yet: run it first.")
    return saved


async def _asked(request: Request, kind: str) -> tuple[dict[str, Any], Any]:
    """What was sent, and what the process says of it."""
    said = await body(request)
    saved = await _saved(request)
    what = {**said, "folder": str(saved.folder)}
    return said, await warm_of(request.app).ask(kind, str(said.get("page", "")), what)


async def opened(request: Request) -> Response:
    """The loops with today's settings and the presets; refused with the reason where nothing can be tried."""
    _, found = await _asked(request, "open")
    return ok(found.answer or {"overtaken": True})


async def curves(request: Request) -> Response:
    """Curves of one loop under other settings."""
    _, found = await _asked(request, "curves")
    return ok({"overtaken": True} if found.answer is None else {**found.answer, "milliseconds": found.milliseconds})


async def numbers(request: Request) -> Response:
    """Numbers of all loops, the judgement, and the settings as text of a project."""
    said, found = await _asked(request, "numbers")
    if found.answer is None:
        return ok({"overtaken": True})
    project = project_of(request)
    try:
        text = await run_in_threadpool(lambda: as_text(_entries(project.text, said)))
    except TrueplantError as error:
        text = f"# {error}"
    return ok({**found.answer, "text": text, "milliseconds": found.milliseconds})


async def save(request: Request) -> Response:
    """The settings that were tried as [[candidate]] entries; the next run judges them beside those that it proposes."""
    said, project = await body(request), project_of(request)
    return ok(await run_in_threadpool(_save, project, said))


def _save(project: ProjectFile, said: Mapping[str, Any]) -> dict[str, Any]:
    if not _entries(project.text, said):
        raise HTTPException(400, "The settings are today's: there is nothing to save.")
    version = project.change(
        lambda text: with_tuning(with_candidates(text, _entries(text, said))), said.get("version") or None
    )
    return {"version": version, "can_undo": project.can_undo, "can_redo": project.can_redo}


async def tuning(request: Request) -> Response:
    """Have the next run propose settings."""
    said, project = await body(request), project_of(request)
    version = await run_in_threadpool(project.change, with_tuning, said.get("version") or None)
    return ok({"version": version, "can_undo": project.can_undo, "can_redo": project.can_redo})


def _entries(text: str, said: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Candidates of the loops whose settings were changed."""
    settings, units = said.get("settings"), said.get("gain_units")
    if not isinstance(settings, Mapping) or not isinstance(units, Mapping):
        raise HTTPException(400, "The settings are missing.")
    changed = said.get("changed")
    inputs = [name for name in settings if not isinstance(changed, list) or name in changed]
    return [candidate(text, name, settings[name], str(units.get(name, "engineering"))) for name in inputs]


ROUTES = [
    Route("/whatif", whatif),
    Route("/api/whatif/open", opened, methods=["POST"]),
    Route("/api/whatif/curves", curves, methods=["POST"]),
    Route("/api/whatif/numbers", numbers, methods=["POST"]),
    Route("/api/whatif/save", save, methods=["POST"]),
    Route("/api/whatif/tuning", tuning, methods=["POST"]),
]
