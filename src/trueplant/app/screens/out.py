"""What is taken along: settings, files, the plant as the new model, a bundle; and the commands for all of it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from starlette.concurrency import run_in_threadpool
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from trueplant.app.downloads import download
from trueplant.app.errands import errands_of
from trueplant.app.faceplates import faceplates, vendor_names
from trueplant.app.folder import ProjectFile
from trueplant.app.fragments import fragment
from trueplant.app.offered import bundle_name, command_lines, content, offered
from trueplant.app.pages import body, folder_of, ok, page, project_of, sandboxed, url
from trueplant.app.saved import Saved, saved_of
from trueplant.errors import TrueplantError, UsageError
from trueplant.notebook.accepting import accepting, changed_since, free_copy, require_news, told_accepted
from trueplant.output import PLANT, REPORT, SHIFT, write_files
from trueplant.project import Project
from trueplant.result import Status


async def out(request: Request) -> Response:
    """The page."""
    found = await run_in_threadpool(saved_of, request)
    project = project_of(request) if request.query_params.get("project") else None
    context: dict[str, Any] = {"saved": found, "project_file": project, "said": {}, "body": None, "lines": ()}
    context["named"] = {"result": _named(request)} if _named(request) else {}
    if found is not None:
        links = {key: url(request, key) for key in ("run", "whatif", "verdict", "compare", "track")}
        links |= {key: _address(request, key) for key in ("out/report", "out/shift")}
        parts = await run_in_threadpool(_parts, found)
        context["body"] = fragment("out_body.html.j2", links=links, address=_filer(request), **parts)
        context["lines"] = command_lines(found)
        context["said"] = {"result": _named(request)}
    return page(request, "out.html.j2", screen="out", **context)


async def faceplate(request: Request) -> Response:
    """The settings as another system shows them."""
    found = await _there(request)
    vendor = request.query_params.get("vendor", "")
    return ok({"html": await run_in_threadpool(lambda: _settings(found, vendor))})


async def file(request: Request) -> Response:
    """One of the files, to be saved."""
    found = await _there(request)
    name = request.query_params.get("name", "")
    made = await run_in_threadpool(content, found, name)
    if made is None:
        raise HTTPException(404, f"This result has no file {name}.")
    return download(made, f"{found.folder.name.removesuffix('-result')}-{name}")


async def report(request: Request) -> Response:
    """The whole report in a tab of its own."""
    return await _shown(request, REPORT)


async def shift(request: Request) -> Response:
    """One page of A4, to be printed."""
    return await _shown(request, SHIFT)


async def acceptable(request: Request) -> Response:
    """What accepting would do, or why it cannot be done."""
    found = await _there(request)
    return ok(await run_in_threadpool(_acceptable, found, project_of(request)))


async def accept(request: Request) -> Response:
    """Make the plant found the project's model."""
    found, project = await _there(request), project_of(request)
    force = (await body(request)).get("force") is True
    lines = await run_in_threadpool(_accept, found, project, force)
    return ok(
        {
            "said": [folder_of(request).plain(line) for line in lines],
            "version": project.version,
            "can_undo": project.can_undo,
            "can_redo": project.can_redo,
        }
    )


async def tuning(request: Request) -> Response:
    """Ask for new settings in the next run."""
    project = project_of(request)

    def add(text: str) -> str:
        end = "\r\n" if "\r\n" in text else "\n"
        return f"{text.rstrip()}{end}{end}[tuning]{end}"

    if (await run_in_threadpool(project.load)).tuning is not None:
        raise UsageError(f"{project.name} asks for new settings already: run it again")
    version = await run_in_threadpool(project.change, add)
    return ok({"version": version, "can_undo": project.can_undo, "can_redo": project.can_redo})


async def bundle(request: Request) -> Response:
    """Begin to write the bundle. `replace`: the one that is there."""
    project = project_of(request)
    replace = (await body(request)).get("replace") is True
    errand = await run_in_threadpool(lambda: errands_of(request).start("bundle", project, force=replace))
    return ok(errand.told(folder_of(request).plain))


async def bundle_state(request: Request) -> Response:
    """How far it is."""
    errand = errands_of(request).of("bundle", project_of(request))
    return ok({"state": "none"} if errand is None else errand.told(folder_of(request).plain))


async def bundle_file(request: Request) -> Response:
    """The ZIP file that was written."""
    project = project_of(request)
    place = project.path.with_name(bundle_name(project))
    if not place.is_file():
        raise HTTPException(404, "There is no bundle yet: make one first.")
    return download(await run_in_threadpool(place.read_bytes), place.name)


# -- what the handlers are made of ---------------------------------------------------------------------------------


async def _there(request: Request) -> Saved:
    found = await run_in_threadpool(saved_of, request)
    if found is None:
        raise HTTPException(404, "There is no result of this project yet: run the analysis first.")
    return found


async def _shown(request: Request, name: str) -> Response:
    made = await run_in_threadpool(content, await _there(request), name)
    assert made is not None  # these can be drawn from any result
    return sandboxed(made)


def _named(request: Request) -> str:
    return request.query_params.get("result", "")


def _address(request: Request, screen: str, **query: str) -> str:
    named = {"result": _named(request)} if _named(request) else {}
    return url(request, screen, **named, **query)


def _filer(request: Request) -> Callable[[str], str]:
    return lambda name: _address(request, "out/file", name=name)


def _parts(found: Saved) -> dict[str, Any]:
    """What the page shows."""
    result = found.result
    refused = result.status == Status.REFUSED
    bundled = found.project is not None and found.project.path.with_name(bundle_name(found.project)).is_file()
    return {
        "result": result,
        "name": found.name,
        "refused": refused,
        "own": found.project is not None,
        "settings": _settings(found, ""),
        "vendors": vendor_names(),
        "asked": bool(result.controllers),
        "asks": _asks_for_settings(found),
        "offered": offered(found),
        "bundled": bundled,
        "bundle_name": bundle_name(found.project) if found.project else "",
    }


def _asks_for_settings(found: Saved) -> bool:
    """Will the next run look for them?"""
    try:
        return found.project is not None and found.project.load().tuning is not None
    except TrueplantError:
        return False


def _settings(found: Saved, vendor: str) -> str:
    """The tables of settings as HTML."""
    shown = faceplates(found.result, _declared(found) if vendor else None, vendor)
    return fragment("out_settings.html.j2", shown=shown, vendor=vendor)


def _declared(found: Saved) -> Project | None:
    """The project as it is, or else as it was analysed: it says the spans."""
    if found.project is not None:
        return found.project.load()
    return Project.load(found.folder / PLANT) if (found.folder / PLANT).is_file() else None


def _acceptable(found: Saved, project: ProjectFile) -> dict[str, Any]:
    """`state`: ready, changed (it can be forced), or refused."""
    plain = project.folder.plain
    try:
        require_news(found.result, found.name)
        loaded = project.load()
        since = [plain(one) for one in changed_since(loaded, found.result)]
        ready = accepting(found.result, loaded, found.name, force=True)
    except TrueplantError as error:
        return {"state": "refused", "message": plain(str(error))}
    return {
        "state": "changed" if since else "ready",
        "message": f"{'; '.join(since)} since this result was written." if since else "",
        "changes": [f"{e.input} → {e.output}" for e in ready.changed],
        "kept": [f"{e.input} → {e.output} ({e.verdict})" for e in ready.kept],
        "doubts": list(ready.doubts),
    }


def _accept(found: Saved, project: ProjectFile, force: bool) -> list[str]:
    """As `trueplant accept` does it, with a copy of the old file beside; the app can undo it besides."""
    version, before = project.version, project.content
    ready = accepting(found.result, project.load(), found.name, force)
    copy = free_copy(project.path)
    write_files(project.path.parent, {copy.name: before})
    try:
        project.change(lambda text: ready.text, version)
    except TrueplantError:
        copy.unlink(missing_ok=True)
        raise
    return list(told_accepted(ready, project.name, copy.name))


ROUTES = [
    Route("/out", out),
    Route("/out/file", file),
    Route("/out/report", report),
    Route("/out/shift", shift),
    Route("/out/bundle", bundle_file),
    Route("/api/out/faceplate", faceplate),
    Route("/api/out/acceptable", acceptable),
    Route("/api/out/accept", accept, methods=["POST"]),
    Route("/api/out/tuning", tuning, methods=["POST"]),
    Route("/api/out/bundle", bundle, methods=["POST"]),
    Route("/api/out/bundle-state", bundle_state),
]
