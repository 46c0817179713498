"""What is taken along: settings, files, the plant as the new model, a bundle; and the commands for all of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from starlette.concurrency import run_in_threadpool
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from trueplant.app.command_lines import command, run_line, track_line
from trueplant.app.downloads import as_csv, download
from trueplant.app.errands import OUT, errands_of
from trueplant.app.faceplates import faceplates, vendor_names
from trueplant.app.folder import ProjectFile
from trueplant.app.fragments import fragment
from trueplant.app.pages import body, folder_of, ok, page, project_of, sandboxed, url
from trueplant.app.saved import Saved, saved_of
from trueplant.errors import TrueplantError, UsageError
from trueplant.notebook.accepting import accepting, changed_since, free_copy, require_news, told_accepted
from trueplant.notebook.analysis import Analysis
from trueplant.output import CURVES, PLANT, REPORT, RESULT, SHIFT, write_files
from trueplant.project import Project
from trueplant.result import Status

PARAMETERS, SETTINGS = "parameters.csv", "settings.csv"


@dataclass(frozen=True)
class Offered:
    """One file that can be had."""

    name: str
    words: str
    command: str
    view: str = ""
    """Screen on which it can be looked at, too."""


async def out(request: Request) -> Response:
    """The page."""
    found = await run_in_threadpool(saved_of, request)
    project = project_of(request) if request.query_params.get("project") else None
    context: dict[str, Any] = {"saved": found, "project_file": project, "said": {}, "body": None, "lines": ()}
    if found is not None:
        links = {key: url(request, key) for key in ("run", "whatif", "verdict", "compare", "track")}
        links |= {key: _address(request, key) for key in ("out/report", "out/shift")}
        parts = await run_in_threadpool(_parts, found)
        context["body"] = fragment("out_body.html.j2", links=links, address=_filer(request), **parts)
        context["lines"] = _lines(found)
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
    makers: dict[str, Callable[[Saved], str | bytes]] = {
        PARAMETERS: _parameters,
        SETTINGS: _settings_csv,
        REPORT: _report,
        SHIFT: _shift,
        RESULT: lambda saved: (saved.folder / RESULT).read_bytes(),
        CURVES: lambda saved: (saved.folder / CURVES).read_bytes(),
        PLANT: lambda saved: (saved.folder / PLANT).read_bytes(),
    }
    if name not in makers or (name in (CURVES, PLANT) and not (found.folder / name).is_file()):
        raise HTTPException(404, f"This result has no file {name}.")
    content = await run_in_threadpool(makers[name], found)
    return download(content, f"{_stem(found)}-{name}")


async def report(request: Request) -> Response:
    """The whole report in a tab of its own."""
    return sandboxed(await run_in_threadpool(_report, await _there(request)))


async def shift(request: Request) -> Response:
    """One page of A4, to be printed."""
    return sandboxed(await run_in_threadpool(_shift, await _there(request)))


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
    place = project.path.with_name(f"{project.path.stem}{OUT['bundle']}")
    if not place.is_file():
        raise HTTPException(404, "There is no bundle yet: make one first.")
    return download(await run_in_threadpool(place.read_bytes), place.name)


# -- what the handlers are made of ---------------------------------------------------------------------------------


async def _there(request: Request) -> Saved:
    found = await run_in_threadpool(saved_of, request)
    if found is None:
        raise HTTPException(404, "There is no result of this project yet: run the analysis first.")
    return found


def _named(request: Request) -> str:
    return request.query_params.get("result", "")


def _address(request: Request, screen: str, **query: str) -> str:
    named = {"result": _named(request)} if _named(request) else {}
    return url(request, screen, **named, **query)


def _filer(request: Request) -> Callable[[str], str]:
    return lambda name: _address(request, "out/file", name=name)


def _stem(found: Saved) -> str:
    return found.folder.name.removesuffix("-result")


def _parts(found: Saved) -> dict[str, Any]:
    """What the page shows."""
    result = found.result
    refused = result.status == Status.REFUSED
    bundled = found.project is not None and found.project.path.with_name(_bundle_name(found.project)).is_file()
    return {
        "result": result,
        "name": found.name,
        "refused": refused,
        "own": found.project is not None,
        "settings": _settings(found, ""),
        "vendors": vendor_names(),
        "asked": bool(result.controllers),
        "asks": _asks_for_settings(found),
        "offered": [one for one in _offered(found) if one.name not in (PLANT, CURVES) or _is_there(found, one.name)],
        "bundled": bundled,
        "bundle_name": _bundle_name(found.project) if found.project else "",
    }


def _asks_for_settings(found: Saved) -> bool:
    """Will the next run look for them?"""
    try:
        return found.project is not None and found.project.load().tuning is not None
    except TrueplantError:
        return False


def _is_there(found: Saved, name: str) -> bool:
    return (found.folder / name).is_file()


def _bundle_name(project: ProjectFile) -> str:
    return f"{project.path.stem}{OUT['bundle']}"


def _offered(found: Saved) -> list[Offered]:
    again = command("report", found.name)
    return [
        Offered(REPORT, "Everything, for the engineer; one file that opens anywhere, offline.", again, "out/report"),
        Offered(SHIFT, "One page for the control room, to be printed or kept as PDF.", f"{again} --shift", "out/shift"),
        Offered(PLANT, "The project with the plant that was found as its model.", _run(found)),
        Offered(PARAMETERS, "Parameters of model and plant with their intervals, for a sheet.", _run(found)),
        *([Offered(SETTINGS, "The new settings, for a sheet.", _run(found))] if found.result.controllers else []),
        Offered(RESULT, "All numbers, for other programs.", f"{_run(found)} --json"),
        Offered(CURVES, "What is drawn, for other programs.", _run(found)),
    ]


def _run(found: Saved) -> str:
    return command("run", found.result.provenance.project) if found.project is None else run_line(found.project)


def _lines(found: Saved) -> list[tuple[str, str]]:
    """What each part of the page is on the command line."""
    name, project = found.name, found.project
    lines = [
        ("the report again", command("report", name)),
        ("the page for the shift", command("report", name, "--shift")),
    ]
    if project is not None:
        lines += [
            ("the analysis", run_line(project)),
            ("the plant as the model", command("accept", name, "--project", project.name)),
            ("a bundle", command("bundle", project.name, "--out", f"{_folder(project)}{_bundle_name(project)}")),
            ("over time", track_line(project)),
        ]
    return [*lines, ("two results", f"{command('compare', name)} OTHER")]


def _folder(project: ProjectFile) -> str:
    head, slash, _ = project.name.rpartition("/")
    return f"{head}{slash}"


def _settings(found: Saved, vendor: str) -> str:
    """The tables of settings as HTML."""
    declared = found.folder / PLANT
    project = None
    if vendor:
        project = Project.load(declared) if declared.is_file() else found.project.load() if found.project else None
    shown = faceplates(found.result, project, vendor)
    return fragment("out_settings.html.j2", shown=shown, vendor=vendor)


def _report(found: Saved) -> str | bytes:
    """As the run drew it, else drawn now."""
    if _is_there(found, REPORT):
        return (found.folder / REPORT).read_bytes()
    from trueplant.report import render

    return render(found.result)


def _shift(found: Saved) -> str:
    from trueplant.report.shift import render_shift

    return render_shift(found.result)


def _parameters(found: Saved) -> str:
    frame = Analysis(found.result).parameters
    return as_csv(frame.columns, frame.iter_rows())


def _settings_csv(found: Saved) -> str:
    frame = Analysis(found.result).settings
    return as_csv(frame.columns, frame.iter_rows())


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
        "kept": [f"{e.input} → {e.output}" for e in ready.kept],
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
