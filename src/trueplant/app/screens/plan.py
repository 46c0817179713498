"""The tests that would settle what an analysis had to leave open: their moves, and what these will do to every PV."""

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
from trueplant.app.screens.edits import set_keys
from trueplant.app.screens.model_edits import set_analysis
from trueplant.app.warm import warm_of
from trueplant.errors import ProjectError
from trueplant.result import MoreData, Settled
from trueplant.result.numbers import number
from trueplant.result.parameter_words import kind_of, word_of


async def plan(request: Request) -> Response:
    """The page."""
    file = project_of(request)
    saved = await run_in_threadpool(saved_of, request)
    project = await run_in_threadpool(file.load)
    plans = [] if saved is None else [_shown(k, one) for k, one in enumerate(saved.result.more_data)]
    if any(one["moves"] for one in plans):
        await run_in_threadpool(warm_of(request.app).start)
    signals = [
        *({"table": "output", "is": "PV", "name": one.name, "unit": one.unit, "limits": one.limits}
          for one in project.outputs),
        *({"table": "input", "is": "OP", "name": one.name, "unit": one.unit, "limits": one.limits}
          for one in project.inputs),
    ]  # fmt: skip
    return page(
        request,
        "plan.html.j2",
        screen="plan",
        name=file.path.name,
        saved=saved,
        answered=saved is not None and saved.result.plant is not None,
        plans=plans,
        signals=signals,
        longest=project.analysis.longest_test,
        time_unit=project.time_unit,
    )


def _shown(k: int, one: MoreData) -> dict[str, Any]:
    """A plan as the template takes it."""
    return {
        "number": k,
        "sentence": one.sentence[:1].upper() + one.sentence[1:],
        "moves": one.moves,
        "length": one.length,
        "suffices": one.suffices,
        "first": one.first_of_two,
        "not_worth": one.not_worth,
        "limited_by": one.limited_by,
        "settles": [_settled(row) for row in one.settles],
    }


def _settled(row: Settled) -> dict[str, Any]:
    name = word_of(row.parameter) if kind_of(row.parameter) == "tau" else row.parameter.replace("_", " ")
    unit = f" {row.unit}" if row.unit else ""
    return {
        "element": f"{row.input} -> {row.output}".replace("_", " "),
        "parameter": name,
        "now": "hardly known" if row.now is None else f"±{number(row.now, 2)}{unit}",
        "then": f"±{number(row.then, 2)}{unit}",
        "wanted": f"±{number(row.wanted, 2)}{unit}",
        "enough": row.then <= row.wanted,
        "matters": row.matters,
    }


async def _saved(request: Request) -> Saved:
    saved = await run_in_threadpool(saved_of, request)
    if saved is None:
        raise HTTPException(404, "The project has no result yet: run it first.")
    return saved


async def excursion(request: Request) -> Response:
    """What the moves of one plan will do to every PV and OP."""
    said = await body(request)
    saved = await _saved(request)
    if not isinstance(said.get("plan"), int):
        raise HTTPException(400, "Which plan this is about is not clear: load the page again.")
    what = {"plan": said["plan"], "folder": str(saved.folder)}
    found = await warm_of(request.app).ask("plan", f"{said.get('page', '')}{said['plan']}", what)
    return ok(found.answer or {"overtaken": True})


async def limits(request: Request) -> Response:
    """Limits of PVs and OPs and the longest test, written into the project: the next run plans within them."""
    said, file = await body(request), project_of(request)
    return ok(await run_in_threadpool(_write, file, said))


def _write(file: ProjectFile, said: Mapping[str, Any]) -> dict[str, Any]:
    rows, longest = said.get("limits"), said.get("longest")
    if not isinstance(rows, list) or not all(isinstance(row, Mapping) for row in rows):
        raise HTTPException(400, "The limits are missing.")

    def edit(text: str) -> str:
        for row in rows:
            if row.get("table") not in ("output", "input"):
                raise HTTPException(400, "The limits are missing.")
            pair = _pair(row)
            text = set_keys(text, row["table"], str(row.get("name")), {"limits": pair})
        return set_analysis(text, {"longest_test": None if longest is None else _number(longest, "The longest test")})

    file.change(edit, said.get("version") or None)
    return {"version": file.version, "can_undo": file.can_undo, "can_redo": file.can_redo}


def _pair(row: Mapping[str, Any]) -> list[float] | None:
    low, high = row.get("low"), row.get("high")
    if low is None and high is None:
        return None
    name = str(row.get("name")).replace("_", " ")
    if low is None or high is None:
        raise ProjectError(f"{name}: give both limits, or none")
    return [_number(low, name), _number(high, name)]


def _number(value: Any, name: str) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise ProjectError(f"{name}: {value!r} is no number")
    return value


ROUTES = [
    Route("/plan", plan),
    Route("/api/plan/excursion", excursion, methods=["POST"]),
    Route("/api/plan/limits", limits, methods=["POST"]),
]
