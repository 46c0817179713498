"""The model, element by element, and the controllers; at once whether these wrote the OPs that were recorded."""

from __future__ import annotations

import os
import tomllib
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from starlette.concurrency import run_in_threadpool
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from trueplant.app.folder import ProjectFile
from trueplant.app.pages import body, ok, page, project_of
from trueplant.app.screens import laws
from trueplant.app.screens.model_edits import AUTO, Place, set_controller, set_element
from trueplant.app.svg import picture, step_picture
from trueplant.errors import ProjectError, TrueplantError
from trueplant.lti import to_formula
from trueplant.lti.structure import structure_of
from trueplant.project import Project
from trueplant.project.fields import require_reason
from trueplant.project.models import DeclaredModel
from trueplant.record.readers import read_table

SHOWN = 600
"""Points of a replay's trend."""
OF_STEP = ("column", "time", "sample_time", "kind", "ramp")
KEYS = ("tf", "step", *OF_STEP, "state_space", "gain_unit", "estimate", "structure")
"""Of an element that the page sets; what else there is stays."""
KINDS = {
    "none": "no response",
    "auto": "find it",
    "tf": "formula",
    "step": "step coefficients",
    "state_space": "state space",
}
STRUCTURES = ("auto", "fopdt", "sopdt", "sopdt+lead", "integrator", "integrator+lag", "pair", "gain")
"""Offered for what the plant's element may be."""


async def model(request: Request) -> Response:
    """The page."""
    project = project_of(request)
    said = await run_in_threadpool(_page, project)
    return page(request, "model.html.j2", screen="model", name=project.path.name, **said)


def _page(file: ProjectFile) -> dict[str, Any]:
    project = file.load()
    sources = (*project.input_names, *project.disturbance_names)
    cells = {
        output: {source: cell(project, i, j) for j, source in enumerate(sources)}
        for i, output in enumerate(project.output_names)
    }
    return {
        "outputs": [{"name": one.name, "unit": one.unit} for one in project.outputs],
        "sources": [
            *({"name": one.name, "unit": one.unit, "is": "OP"} for one in project.inputs),
            *({"name": one.name, "unit": one.unit, "is": "measured disturbance"} for one in project.disturbances),
        ],
        "cells": cells,
        "kinds": KINDS,
        "structures": STRUCTURES,
        "laws": laws.shown(project, tomllib.loads(file.text)),
        "choices": laws.choices(),
        "files": [name for name in file.folder.data_files() if name not in project.data.files],
        "json_files": sorted(
            file.folder.name(path) for path in file.path.parent.glob("*.json") if path.name != "result.json"
        ),
        "time_unit": project.time_unit,
        "has_data": bool(project.experiments),
    }


# -- elements ------------------------------------------------------------------------------------------------------


def cell(project: Project, i: int, j: int) -> dict[str, Any]:
    """What is declared of one element, in words and drawn."""
    output, source = project.output_names[i], (*project.input_names, *project.disturbance_names)[j]
    entry, found = project.element(i, j), project.models.get((output, source))
    kind = "auto" if project.wanted(i, j) else "none"
    keys: dict[str, Any] = {}
    if entry is not None:
        keys = {key: getattr(entry, key) for key in KEYS if key in entry.model_fields_set}
        kind = next((key for key in ("tf", "step", "state_space") if getattr(entry, key) is not None), kind)
    is_zero = found is not None and found.system.is_zero
    if kind == "tf" and is_zero and not (entry and entry.structure):
        kind = "none"
    return {"kind": kind, "keys": keys, **_drawn(found, project, output, source)}


def _drawn(found: DeclaredModel | None, project: Project, output: str, source: str) -> dict[str, Any]:
    if found is None or found.system.is_zero:
        return {"svg": "", "formula": "", "words": ""}
    fitted = found.system if found.measured is not None else None
    svg = step_picture(found.measured or found.system, fitted, project.time_unit)
    words = found.source
    if found.measured is not None:
        words += f"; fitted within {100 * found.error:.2g} % of the gain"
    return {"svg": svg, "formula": to_formula(found.system), "words": words}


async def check(request: Request) -> Response:
    """An element as it is typed: drawn, or what is wrong with it in the words of the library. Nothing is written."""
    said, file = await body(request), project_of(request)
    return ok(await run_in_threadpool(_checked, file, said))


def _checked(file: ProjectFile, said: Mapping[str, Any]) -> dict[str, Any]:
    try:
        place, keys = _asked(file, said)
        if keys is not None and isinstance(keys.get("tf"), str):
            _parsed(keys["tf"])
        project = _would_be(file, set_element(file.text, place, keys, _places(file)))
        i = project.output_names.index(place[0])
        j = (*project.input_names, *project.disturbance_names).index(place[1])
        shown = cell(project, i, j)
        found = project.models.get(place)
        told = "" if found is None or found.system.is_zero else _told(found, project)
        return {"right": True, "told": told, **shown}
    except TrueplantError as error:
        return {"right": False, "why": file.folder.plain(str(error))}


def _parsed(text: str) -> None:
    """The formula alone, so that its message is the parser's. Raises FormulaError."""
    from trueplant.lti import require_proper, tf

    system = tf(text)
    require_proper(system, "the transfer function")
    require_reason(system)


def _told(found: DeclaredModel, project: Project) -> str:
    try:
        structure, values = structure_of(found.system)
    except TrueplantError:
        return to_formula(found.system)
    named = [f"{name.replace('_', ' ')} {value:.4g}" for name, value in zip(structure.names, values, strict=True)]
    return f"{structure}: {', '.join(named)} (times in {project.time_unit})"


async def element(request: Request) -> Response:
    """Write an element into the project."""
    said, file = await body(request), project_of(request)
    return ok(await run_in_threadpool(_write_element, file, said))


def _write_element(file: ProjectFile, said: Mapping[str, Any]) -> dict[str, Any]:
    place, keys = _asked(file, said)
    places = _places(file)
    _changed(file, lambda text: set_element(text, place, keys, places), said)
    return {**_history(file), **_cells(file)}


def _cells(file: ProjectFile) -> dict[str, Any]:
    return {"cells": _page(file)["cells"]}


def _asked(file: ProjectFile, said: Mapping[str, Any]) -> tuple[Place, dict[str, Any] | None]:
    """The element that is meant, and its keys; None: it is zero. Raises HTTPException for what no page sends."""
    place: Place = str(said.get("output")), str(said.get("input"))
    kind, given = said.get("kind"), said.get("keys")
    if place not in _places(file) or kind not in KINDS or not isinstance(given, Mapping):
        raise HTTPException(400, "Which element this is about is not clear: load the page again.")
    if kind == "none":
        return place, None
    keys = {key: value for key, value in given.items() if key in KEYS and value not in (None, "")}
    if kind == "auto":
        own = keys.get("structure")
        return place, {"structure": own} if own else dict(AUTO)
    if kind not in keys:
        what = {"tf": "type a formula", "step": "choose a file", "state_space": "choose a file"}[str(kind)]
        raise ProjectError(f"{what}, such as 1.2 exp(-3 s)/(18 s + 1)" if kind == "tf" else what)
    for other in ("tf", "step", "state_space"):
        if other != kind:
            keys.pop(other, None)
    if kind != "step":
        for other in OF_STEP:
            keys.pop(other, None)
    for key in ("step", "state_space"):
        if isinstance(keys.get(key), str):
            keys[key] = _named(file, keys[key])
    return place, keys


def _named(file: ProjectFile, name: str) -> str:
    """A file of the folder as the project names it. Raises Outside."""
    return Path(os.path.relpath(file.folder.path(name), file.path.parent.resolve())).as_posix()


def _places(file: ProjectFile) -> list[Place]:
    project = file.load()
    sources = (*project.input_names, *project.disturbance_names)
    return [(output, source) for output in project.output_names for source in sources]


async def columns(request: Request) -> Response:
    """Of a file with coefficients."""
    file, name = project_of(request), request.query_params.get("file", "")
    path = file.folder.path(name)
    table = await run_in_threadpool(lambda: read_table(path, fewest=1))
    return ok({"columns": list(table.names)})


# -- controllers ---------------------------------------------------------------------------------------------------


async def check_law(request: Request) -> Response:
    """A controller as it is typed. Nothing is written."""
    said, file = await body(request), project_of(request)
    return ok(await run_in_threadpool(_checked_law, file, said))


def _checked_law(file: ProjectFile, said: Mapping[str, Any]) -> dict[str, Any]:
    try:
        place, keys = _asked_law(file, said)
        project = _would_be(file, set_controller(file.text, place, keys))
        return {"right": True, "told": laws.plain_words(project, place) if keys is not None else ""}
    except TrueplantError as error:
        return {"right": False, "why": file.folder.plain(str(error))}


async def controller(request: Request) -> Response:
    """Write a controller into the project, or take it out."""
    said, file = await body(request), project_of(request)
    return ok(await run_in_threadpool(_write_law, file, said))


def _write_law(file: ProjectFile, said: Mapping[str, Any]) -> dict[str, Any]:
    place, keys = _asked_law(file, said)
    _changed(file, lambda text: set_controller(text, place, keys), said)
    return _history(file)


def _asked_law(file: ProjectFile, said: Mapping[str, Any]) -> tuple[Place, dict[str, Any] | None]:
    project = file.load()
    output, source = said.get("output"), said.get("input")
    if output not in project.output_names or source not in project.input_names:
        raise HTTPException(400, "Which controller this is about is not clear: load the page again.")
    place = (str(output), str(source))
    if said.get("gone"):
        return place, None
    if not isinstance(said.get("keys"), Mapping):
        raise HTTPException(400, "The settings are missing.")
    return place, laws.keys_of(tomllib.loads(file.text), place, said["keys"])


def _would_be(file: ProjectFile, text: str) -> Project:
    """The project if its text were this. Raises ProjectError, which names the file as it is called."""
    try:
        return Project.from_toml(text, file.path.parent)
    except ProjectError as error:
        raise ProjectError(str(error).replace(str(file.path.parent / "project.toml"), file.name)) from None


def _changed(file: ProjectFile, edit: Any, said: Mapping[str, Any]) -> None:
    file.change(edit, said.get("version") or None)


def _history(file: ProjectFile) -> dict[str, Any]:
    return {"version": file.version, "can_undo": file.can_undo, "can_redo": file.can_redo}


# -- replay --------------------------------------------------------------------------------------------------------


async def replay(request: Request) -> Response:
    """Do the controllers as they are declared reproduce the OPs that were recorded, and from when on not?"""
    return ok({"replays": await run_in_threadpool(_replayed, project_of(request))})


def _replayed(file: ProjectFile) -> list[dict[str, Any]]:
    project = file.load()
    if not project.controllers or not project.experiments:
        return []
    stamps = tuple(_stamp(plan.path) for plan in project.experiments if not plan.file.startswith("dataset:"))
    return _replays(file.path, file.version, stamps)


def _stamp(path: Path) -> tuple[int, int]:
    try:
        seen = path.stat()
    except OSError:
        return 0, 0
    return seen.st_mtime_ns, seen.st_size


@lru_cache(maxsize=8)
def _replays(path: Path, version: str, stamps: tuple[tuple[int, int], ...]) -> list[dict[str, Any]]:
    """Kept as long as the project and its records are as they were."""
    from trueplant.study.data.law_trend import replays_of

    found = []
    for one in replays_of(Project.load(path)):
        check, trend = one.check, one.trend
        svg, words = "", ""
        if trend is not None and trend.t.size:
            thin = np.unique(np.linspace(0, trend.t.size - 1, min(trend.t.size, SHOWN)).astype(int))
            t = np.nan_to_num(trend.t, nan=float(np.nanmin(trend.t)))
            ends = (one.calendar.text(float(np.nanmin(trend.t))), one.calendar.text(float(np.nanmax(trend.t))))
            words = f"OP of {check.input} from {ends[0]} to {ends[1]}, as recorded and as the controller writes it"
            order = np.maximum.accumulate(t[thin])
            svg = picture(order, {"measured": trend.op[thin], "law": trend.law[thin]}, words, wide=True)
        found.append(
            {
                "input": check.input,
                "experiment": check.experiment,
                "confirmed": check.confirmed,
                "message": check.message,
                "since": check.since_calendar or (None if check.since is None else one.calendar.text(check.since)),
                "svg": svg,
                "words": words,
            }
        )
    return found


ROUTES = [
    Route("/model", model),
    Route("/api/model/check", check, methods=["POST"]),
    Route("/api/model/element", element, methods=["POST"]),
    Route("/api/model/columns", columns),
    Route("/api/model/check-law", check_law, methods=["POST"]),
    Route("/api/model/controller", controller, methods=["POST"]),
    Route("/api/model/replay", replay),
]
