"""The screen Trends: the record as it is, what of it is used, and which stretches are left out."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
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
from trueplant.app.screens import edits
from trueplant.app.screens.aside import Aside, Question
from trueplant.app.screens.lights import light_of
from trueplant.app.screens.loops import pairs_of
from trueplant.app.screens.records import ALL, Records, Shown, Struck, signature, struck_of
from trueplant.app.screens.struck import exclusions, overruled, struck_list
from trueplant.calendar import Calendar, unit_seconds, zone_of
from trueplant.connect import ensure
from trueplant.errors import DataError, ProjectError
from trueplant.project import ExperimentPlan, Project
from trueplant.project.exclusions import all_but_usable, moment_of
from trueplant.record.types import Kind
from trueplant.result import Check, UsableStretch

POINTS = 4000
"""Stretches of a view at most: a wide screen has that many pixels."""
QUARTER = 900.0
"""Seconds: the clock changes at whole quarters of an hour only."""


@dataclass
class Seen:
    """What the screen keeps while the app runs."""

    records: Records = field(default_factory=Records)
    aside: Aside = field(default_factory=Aside)
    struck: dict[tuple[Path, str], Struck] = field(default_factory=dict)
    """By project and record: what `check` struck last, without what the user excludes."""


def _seen(request: Request) -> Seen:
    state = request.app.state
    if not hasattr(state, "trends"):
        state.trends = Seen()
    seen: Seen = state.trends
    return seen


async def _page(request: Request) -> Response:
    file = project_of(request)
    project = await run_in_threadpool(file.load)
    loops = []
    for i, j in pairs_of(project):
        output = None if i is None else project.outputs[i]
        input_ = None if j is None else project.inputs[j]
        loops.append(
            {
                "output": output and output.name,
                "sp": output is not None and output.sp is not None,
                "unit": output.unit if output else "",
                "input": input_ and input_.name,
                "input_unit": input_.unit if input_ else "",
            }
        )
    records = [plan.name for plan in project.experiments]
    return page(request, "trends.html.j2", screen="trends", records=records, state={"loops": loops, "records": records})


# -- one record ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Asked:
    """The project and the record that a request is about."""

    file: ProjectFile
    project: Project
    plan: ExperimentPlan

    @property
    def version(self) -> Any:
        """Of the project and all its records, on which answers depend."""
        return self.file.version, *(signature(self.project, plan) for plan in self.project.experiments)


def _asked(request: Request, k: Any = None) -> Asked:
    file = project_of(request)
    project = file.load()
    plans = project.experiments
    if not plans:
        raise ProjectError(f"{file.name}: names no data: set data.files, or choose a file on the page Start")
    if project.data.source is not None:
        ensure(project)
    number = str(request.query_params.get("record", "0") if k is None else k)
    if not number.isdigit() or int(number) >= len(plans):
        raise HTTPException(400, "There is no such record in this project.")
    return Asked(file, project, plans[int(number)])


def _shown(seen: Seen, asked: Asked) -> Shown:
    """The record without what is struck, as far as that is known yet."""
    shown = seen.records.get(asked.project, asked.plan)
    own = [(one["from"], one["to"], ALL) for one in exclusions(asked.project, asked.plan, shown.calendar)]
    struck = (*seen.struck.get((asked.file.path, asked.plan.name), ()), *own)
    return seen.records.struck(asked.project, asked.plan, struck)


async def _record(request: Request) -> Response:
    """What there is to say of a record before it is drawn."""
    seen = _seen(request)

    def told() -> dict[str, Any]:
        asked = _asked(request)
        shown = _shown(seen, asked)
        calendar = shown.calendar
        return {
            "unit": asked.project.time_unit,
            "label": calendar.label,
            "start": _unix(calendar),
            "seconds": unit_seconds(asked.project.time_unit),
            "offsets": _offsets(calendar, float(shown.t[0]), float(shown.t[-1])),
            "first": float(shown.t[0]),
            "last": float(shown.t[-1]),
            "step": shown.step,
            "samples": int(shown.t.size),
            "span": calendar.span(float(shown.t[0]), float(shown.t[-1])),
            "signals": [f"{kind} {name}" for kind, name in shown.signals],
            "exclusions": exclusions(asked.project, asked.plan, calendar),
        }

    return ok(await run_in_threadpool(told))


def _unix(calendar: Calendar) -> float | None:
    if calendar.start is None:
        return None
    return calendar.start.replace(tzinfo=calendar.start.tzinfo or UTC).timestamp()


def _offsets(calendar: Calendar, first: float, last: float) -> list[tuple[float, float]]:
    """(seconds since 1970, offset from UTC from then on) of the record's zone over its length."""
    start = _unix(calendar)
    if start is None or calendar.zone is None:
        return []
    zone, per_unit = zone_of(calendar.zone), unit_seconds(calendar.unit)
    lowest = math.floor((start + first * per_unit) / QUARTER) * QUARTER
    highest = start + last * per_unit

    def offset(at: float) -> float:
        found = (datetime(1970, 1, 1, tzinfo=UTC) + timedelta(seconds=at)).astimezone(zone).utcoffset()
        return (found or timedelta()).total_seconds()

    found = [(lowest, offset(lowest))]
    day = 86400.0
    at = lowest
    while at < highest:
        if offset(at + day) != found[-1][1]:
            change = next(q for q in np.arange(at, at + day + QUARTER, QUARTER) if offset(float(q)) != found[-1][1])
            found.append((float(change), offset(float(change))))
        at += day
    return found


async def _view(request: Request) -> Response:
    """The signals of a stretch of time as doubles: "t", then each signal of the record in its order."""
    query, seen = request.query_params, _seen(request)

    def drawn() -> bytes:
        shown = _shown(seen, _asked(request))
        try:
            start, end = float(query.get("from", shown.t[0])), float(query.get("to", shown.t[-1]))
            points = min(max(int(query.get("points", 1000)), 2), POINTS)
        except ValueError:
            raise HTTPException(400, "This is no stretch of time.") from None
        if not math.isfinite(start) or not math.isfinite(end):
            raise HTTPException(400, "This is no stretch of time.")
        return np.concatenate([*shown.view(start, end, points).values()]).astype("<f8").tobytes()

    return Response(await run_in_threadpool(drawn), media_type="application/octet-stream")


async def _time(request: Request) -> Response:
    """A time that was typed, as the record has it."""
    text, seen = request.query_params.get("text", "").strip(), _seen(request)

    def read() -> dict[str, Any]:
        shown = _shown(seen, _asked(request))
        return {"time": _typed(text, shown.calendar)}

    return ok(await run_in_threadpool(read))


def _typed(text: str, calendar: Calendar) -> float:
    """Raises DataError for what is no time of the record."""
    if calendar.start is None:
        try:
            value = float(text.replace(",", "."))
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            raise DataError(f"{text[:40]!r} is no time of this record: give a number in {calendar.unit}")
        return value
    try:
        moment = datetime.fromisoformat(text)
    except ValueError:
        raise DataError(f"{text[:40]!r} is no time: write it as {calendar.text(0)[:19]}") from None
    return calendar.time(moment)


# -- what check and find say -------------------------------------------------------------------------------------------


async def _ask(request: Request) -> Response:
    """Begin `check` or `find`, unless the answer is known."""
    kind, seen = (await body(request)).get("kind"), _seen(request)
    if kind not in ("check", "find"):
        raise HTTPException(400, "There is no such question.")

    def begun() -> dict[str, Any]:
        asked = _asked(request)
        seen.aside.ask(kind, asked.file.path, asked.version)
        return {}

    return ok(await run_in_threadpool(begun))


async def _cancel(request: Request) -> Response:
    seen, file = _seen(request), project_of(request)
    await run_in_threadpool(seen.aside.cancel, file.path)
    return ok({})


async def _answer(request: Request) -> Response:
    """How far the question is, and its answer; waits a moment for it."""
    seen, kind = _seen(request), request.query_params.get("kind")

    def told() -> dict[str, Any]:
        asked = _asked(request)
        question = seen.aside.known("find" if kind == "find" else "check", asked.file.path, asked.version)
        if question is None:
            return {"state": "unknown"}
        question.ended.wait(0.4)
        out: dict[str, Any] = {"state": question.state, "stage": question.stage, "seconds": question.seconds}
        if question.state == "failed":
            out["error"] = asked.file.folder.plain(question.error)
        if question.answer is not None:
            _note(seen, asked, question)
            out |= _found(asked, question.answer)
        return out

    return ok(await run_in_threadpool(told))


def _note(seen: Seen, asked: Asked, question: Question) -> None:
    """Keep what was struck for the views."""
    assert question.answer is not None
    for one in question.answer.data:
        own = struck_of(x for x in one.excluded if x.reason != Kind.EXCLUDED)
        seen.struck[asked.file.path, one.name] = own


def _found(asked: Asked, found: Check) -> dict[str, Any]:
    """The answer as far as it concerns one record."""
    project = asked.project
    record = next(one for one in found.data if one.name == asked.plan.name)
    calendar = record.calendar(project.time_unit)
    noticed = [one.message for one in record.findings if not one.excludes]
    out: dict[str, Any] = {
        "headline": found.headline,
        "refused": found.status != "ok",
        "reasons": [f"{one.where}: {one.message}" if one.where else one.message for one in found.reasons],
        "lights": {name: light_of(found, record, name).to_dict() for name in project.output_names},
        "struck": struck_list(project, record),
        "noticed": list(dict.fromkeys(noticed)),
        "shares": dict(record.usable_share),
    }
    if found.usable is not None:
        out["usable"] = [_usable(one, calendar) for one in found.usable if one.experiment == record.name]
        out["usable_elsewhere"] = len(found.usable) - len(out["usable"])
    return out


def _usable(one: UsableStretch, calendar: Calendar) -> dict[str, Any]:
    gains = [
        {"element": f"{e.input} → {e.output}",
         "percent": None if e.std_error is None else 100 * e.std_error / max(abs(e.value), 1e-300)}
        for e in one.expected
    ]  # fmt: skip
    return {
        "from": one.start,
        "to": one.end,
        "text": calendar.span(one.start, one.end),
        "moves": one.moves,
        "moved": list(one.moved),
        "gains": gains,
    }


# -- what is changed ---------------------------------------------------------------------------------------------------


async def _changed(request: Request, file: ProjectFile, version: Any, edit: Any, **more: Any) -> Response:
    now = await run_in_threadpool(file.change, edit, version)
    return ok({"version": now, "can_undo": file.can_undo, "can_redo": file.can_redo, **more})


async def _exclude(request: Request) -> Response:
    given, seen = await body(request), _seen(request)

    def entry() -> tuple[ProjectFile, dict[str, Any], str]:
        asked = _asked(request, given.get("record", 0))
        shown = _shown(seen, asked)
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
    given, seen = await body(request), _seen(request)

    def entries() -> tuple[ProjectFile, list[dict[str, Any]]]:
        asked = _asked(request)
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
    Route("/trends", _page),
    Route("/api/trends/record", _record),
    Route("/api/trends/view", _view),
    Route("/api/trends/time", _time),
    Route("/api/trends/ask", _ask, methods=["POST"]),
    Route("/api/trends/cancel", _cancel, methods=["POST"]),
    Route("/api/trends/answer", _answer),
    Route("/api/trends/exclude", _exclude, methods=["POST"]),
    Route("/api/trends/include", _include, methods=["POST"]),
    Route("/api/trends/overrule", _overrule, methods=["POST"]),
    Route("/api/trends/write", _write, methods=["POST"]),
]
