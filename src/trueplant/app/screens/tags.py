"""The screen Tags: which column is what, a row a loop. Every change is written into the project file at once."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from starlette.concurrency import run_in_threadpool
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from trueplant.app.folder import ProjectFile
from trueplant.app.pages import body, ok, page, project_of
from trueplant.app.screens import edits
from trueplant.app.screens.columns import Column, Columns, certainty
from trueplant.app.screens.loops import pairs_of
from trueplant.project import Project
from trueplant.project.guess import guess_disturbances
from trueplant.record.modes import is_automatic

KINDS = ("flow", "pressure", "level", "temperature", "other")
OWN: Mapping[str, tuple[str, ...]] = {
    "output": ("pv", "sp", "status", "unit", "kind", "limits", "span"),
    "input": ("op", "mode", "status", "unit", "limits", "span", "automatic_values", "slave_sp", "slave_pv"),
}
"""Keys that this screen changes."""
NEEDED = ("pv", "op")


async def _page(request: Request) -> Response:
    project = project_of(request)
    state = await run_in_threadpool(_state, project)
    return page(request, "tags.html.j2", screen="tags", state=state, kinds=KINDS, source=project.load().data.source)


async def _columns(request: Request) -> Response:
    """All columns with their small trends; it may take seconds for a large file."""
    project = project_of(request)
    kept: Columns = _kept(request)
    loaded = await run_in_threadpool(project.load)
    if loaded.data.source is not None and not loaded.experiments[0].path.is_file():
        return ok({"columns": [], "told": f"fetch the historian's data first: trueplant fetch {project.name}"})
    found = await run_in_threadpool(kept.of, loaded)
    layout, time = loaded.layout(), loaded.data.time
    used = {time, *layout.held, *(output.column for output in layout.outputs)}
    shown = [one for one in found if one.name != time]
    return ok(
        {
            "columns": [{**one.to_dict(), "modes": _meant(one)} for one in shown],
            "outside": guess_disturbances(one.name for one in shown if one.name not in used),
        }
    )


def _meant(column: Column) -> list[tuple[str, int, bool | None]] | None:
    """Each mode, how often it is there, and whether it is known to be automatic."""
    return None if column.modes is None else [(mode, n, is_automatic(mode)) for mode, n in column.modes.items()]


def _kept(request: Request) -> Columns:
    state = request.app.state
    if not hasattr(state, "columns"):
        state.columns = Columns()
    kept: Columns = state.columns
    return kept


def _state(file: ProjectFile) -> dict[str, Any]:
    """What the page shows of a project."""
    project = file.load()
    loops = []
    for i, j in pairs_of(project):
        output = {} if i is None else project.outputs[i].model_dump(include={"name", *OWN["output"]})
        input_ = {} if j is None else project.inputs[j].model_dump(include={"name", *OWN["input"]})
        found = {
            "pv": certainty(output.get("pv"), "pv"),
            "sp": certainty(output.get("sp"), "sp"),
            "op": certainty(input_.get("op"), "op"),
            "mode": certainty(input_.get("mode"), "mode"),
            "status_output": certainty(output.get("status"), "pv", True),
            "status_input": certainty(input_.get("status"), "op", True),
        }
        named = _named(project, output.get("name"), input_.get("name"))
        loops.append({"output": output or None, "input": input_ or None, "certainty": found, "named": named})
    return {
        "time_unit": project.time_unit,
        "time": project.data.time,
        "files": [plan.name for plan in project.experiments],
        "loops": loops,
        "disturbances": [entry.model_dump(include={"name", "column", "unit"}) for entry in project.disturbances],
    }


def _named(project: Project, output: str | None, input_: str | None) -> str:
    """What else goes with a loop that is removed, in words."""
    elements = sum(one.output == output or one.input == input_ for one in project.model)
    laws = sum(one.output == output or one.input == input_ for one in project.controllers)
    counted = [(elements, "element of the model", "elements of the model"), (laws, "controller", "controllers")]
    return " and ".join(f"{n} {one if n == 1 else many}" for n, one, many in counted if n)


async def _changed(request: Request, edit: Any, version: str | None) -> Response:
    file = project_of(request)
    now = await run_in_threadpool(file.change, edit, version)
    state = await run_in_threadpool(_state, file)
    return ok({"version": now, "can_undo": file.can_undo, "can_redo": file.can_redo, "state": state})


async def _set(request: Request) -> Response:
    given = await body(request)
    table, name = str(given.get("table")), str(given.get("name"))
    keys = given.get("keys")
    if table not in OWN or not isinstance(keys, dict) or set(keys) - set(OWN[table]):
        raise HTTPException(400, "This cannot be changed here.")
    wanted = {key: _value(key, value) for key, value in keys.items()}
    if missing := next((key for key in NEEDED if key in wanted and wanted[key] is None), None):
        raise HTTPException(400, f"A loop needs its {missing.upper()}: choose a column, or remove the loop.")
    return await _changed(request, lambda text: edits.set_keys(text, table, name, wanted), given.get("version"))


def _value(key: str, value: Any) -> Any:
    """A value of the form as the project has it; None: not said."""
    if key in ("limits", "span") and isinstance(value, list):
        ends = [_number(one) for one in value]
        return None if all(one is None for one in ends) else ends
    if isinstance(value, list):
        return [_mode(one) for one in value] or None
    text = str(value or "").strip()
    return text or None


def _number(value: Any) -> int | float | None:
    text = str(value).strip().replace(",", ".")
    if not text:
        return None
    try:
        number = float(text)
    except ValueError:
        raise HTTPException(400, f"{str(value)[:40]!r} is no number: correct it.") from None
    return int(number) if number == int(number) and abs(number) < 1e15 else number


def _mode(value: Any) -> int | float | str:
    """A value of a mode column as a project names it."""
    text = str(value).strip()
    try:
        number = float(text.replace(",", "."))
    except ValueError:
        return text
    return int(number) if number == int(number) else number


async def _add(request: Request) -> Response:
    given = await body(request)
    pv, op = (str(given.get(key) or "").strip() for key in NEEDED)
    if not pv or not op:
        raise HTTPException(400, "A loop needs a PV and an OP: choose both columns.")
    project = await run_in_threadpool(project_of(request).load)
    stem = re.sub(r"[^\w]+", "_", str(given.get("name") or "")).strip("_")
    taken = {*project.output_names, *project.input_names, *project.disturbance_names}
    names = [_free(f"{stem}_pv" if stem else _plain(pv), taken), _free(f"{stem}_op" if stem else _plain(op), taken)]
    output = {"name": names[0], "pv": pv, "sp": given.get("sp") or None}
    input_ = {"name": names[1], "op": op, "mode": given.get("mode") or None}
    return await _changed(
        request, lambda text: edits.add_loop(text, _there(output), _there(input_)), given.get("version")
    )


def _there(entry: Mapping[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in entry.items() if value is not None}


def _plain(name: str) -> str:
    return re.sub(r"[^\w]+", "_", name.casefold()).strip("_") or "signal"


def _free(name: str, taken: set[str]) -> str:
    count, found = 2, name
    while found in taken:
        found, count = f"{name}_{count}", count + 1
    taken.add(found)
    return found


async def _remove(request: Request) -> Response:
    given = await body(request)
    output, input_ = given.get("output") or None, given.get("input") or None
    project = await run_in_threadpool(project_of(request).load)
    if (output and len(project.outputs) < 2) or (input_ and len(project.inputs) < 2):
        raise HTTPException(400, "A project has at least one loop: change this one instead.")
    return await _changed(request, lambda text: edits.remove_loop(text, output, input_), given.get("version"))


async def _use(request: Request) -> Response:
    """Another column as a measured disturbance, or not any more."""
    given = await body(request)
    column, use = str(given.get("column") or ""), given.get("use")
    project = await run_in_threadpool(project_of(request).load)
    known = next((entry for entry in project.disturbances if entry.column == column), None)
    if use == "disturbance" and known is None:
        taken = {*project.output_names, *project.input_names, *project.disturbance_names}
        entry = _there({"name": _free(column, taken), "column": column, "unit": given.get("unit") or None})
        return await _changed(request, lambda text: edits.add_disturbance(text, entry), given.get("version"))
    if use == "ignore" and known is not None:
        name = known.name
        return await _changed(request, lambda text: edits.remove_disturbance(text, name), given.get("version"))
    return await _changed(request, lambda text: text, given.get("version"))


ROUTES = [
    Route("/tags", _page),
    Route("/api/tags/columns", _columns),
    Route("/api/tags/set", _set, methods=["POST"]),
    Route("/api/tags/add", _add, methods=["POST"]),
    Route("/api/tags/remove", _remove, methods=["POST"]),
    Route("/api/tags/use", _use, methods=["POST"]),
]
