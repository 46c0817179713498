"""What `check` and `find` say of a record on the screen Trends."""

from __future__ import annotations

from typing import Any

from starlette.concurrency import run_in_threadpool
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from trueplant.app.pages import body, ok, project_of
from trueplant.app.screens.aside import Question
from trueplant.app.screens.asking import Asked, Seen, asked_by, seen_by
from trueplant.app.screens.lights import light_of
from trueplant.app.screens.records import struck_of
from trueplant.app.screens.struck import KEPT, struck_list
from trueplant.calendar import Calendar
from trueplant.record.types import Kind
from trueplant.result import Check, UsableStretch


async def _ask(request: Request) -> Response:
    """Begin `check` or `find`, unless the answer is known."""
    kind, seen = (await body(request)).get("kind"), seen_by(request)
    if kind not in ("check", "find"):
        raise HTTPException(400, "There is no such question.")

    def begun() -> dict[str, Any]:
        asked = asked_by(request)
        seen.aside.ask(kind, asked.file.path, asked.version)
        return {}

    return ok(await run_in_threadpool(begun))


async def _cancel(request: Request) -> Response:
    seen, file = seen_by(request), project_of(request)
    await run_in_threadpool(seen.aside.cancel, file.path)
    return ok({})


async def _answer(request: Request) -> Response:
    """How far the question is, and its answer; waits a moment for it."""
    seen, kind = seen_by(request), request.query_params.get("kind")

    def told() -> dict[str, Any]:
        asked = asked_by(request)
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
    noticed = [one.message for one in record.findings if not one.excludes and one.kind not in KEPT]
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


ROUTES = [
    Route("/api/trends/ask", _ask, methods=["POST"]),
    Route("/api/trends/cancel", _cancel, methods=["POST"]),
    Route("/api/trends/answer", _answer),
]
