"""The screen Trends: the record as it is, what of it is used, and which stretches are left out."""

from __future__ import annotations

import math
from datetime import UTC, datetime, timedelta
from typing import Any

import numpy as np
from starlette.concurrency import run_in_threadpool
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from trueplant.app import levels
from trueplant.app.pages import ok, page, project_of
from trueplant.app.screens import answers, stretches
from trueplant.app.screens.asking import asked_by, seen_by, shown_to
from trueplant.app.screens.loops import pairs_of
from trueplant.app.screens.struck import exclusions
from trueplant.calendar import Calendar, unit_seconds, zone_of
from trueplant.errors import DataError

POINTS = 4000
"""Stretches of a view at most: a wide screen has that many pixels."""


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


async def _record(request: Request) -> Response:
    """What there is to say of a record before it is drawn."""
    seen = seen_by(request)

    def told() -> dict[str, Any]:
        asked = asked_by(request, fetched=False)
        shown = shown_to(seen, asked)
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
    lowest = math.floor((start + first * per_unit) / levels.QUARTER) * levels.QUARTER
    highest = start + last * per_unit

    def offset(at: float) -> float:
        found = (datetime(1970, 1, 1, tzinfo=UTC) + timedelta(seconds=at)).astimezone(zone).utcoffset()
        return (found or timedelta()).total_seconds()

    found = [(lowest, offset(lowest))]
    day = 86400.0
    at = lowest
    while at < highest:
        if offset(at + day) != found[-1][1]:
            change = next(
                q for q in np.arange(at, at + day + levels.QUARTER, levels.QUARTER) if offset(float(q)) != found[-1][1]
            )
            found.append((float(change), offset(float(change))))
        at += day
    return found


async def _view(request: Request) -> Response:
    """The signals of a stretch of time as doubles: "t", then each signal of the record in its order."""
    query, seen = request.query_params, seen_by(request)

    def drawn() -> bytes:
        shown = shown_to(seen, asked_by(request))
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
    text, seen = request.query_params.get("text", "").strip(), seen_by(request)

    def read() -> dict[str, Any]:
        shown = shown_to(seen, asked_by(request))
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


ROUTES = [
    Route("/trends", _page),
    Route("/api/trends/record", _record),
    Route("/api/trends/view", _view),
    Route("/api/trends/time", _time),
    *answers.ROUTES,
    *stretches.ROUTES,
]
