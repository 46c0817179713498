"""What came out, first for the shift, then for the engineer: all of it from the saved result."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from starlette.concurrency import run_in_threadpool
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from trueplant.app.pages import ok, page, url
from trueplant.app.saved import Saved, saved_of
from trueplant.result import Code, Curves, Element, ElementVerdict, Reason, Result, Status
from trueplant.result.headline import has_moved, is_another
from trueplant.result.shift_words import Action

MARKS = {"changed": "changed", "unchanged": "unchanged", "found": "found", "none found": "absent"}
"""Colour of each verdict of an element, as in the report; "unknown" for what the data do not say."""


@dataclass(frozen=True)
class ToDo:
    """What the action asks for, and the screens that help with it."""

    title: str
    words: str
    links: tuple[tuple[str, str], ...]
    """Screen, and what is found there."""


TO_DO: Mapping[Action, ToDo] = {
    Action.NONE: ToDo("Nothing to do now", "Nothing that was found has to be acted on at the panel.", ()),
    Action.RETUNE: ToDo(
        "Retune",
        "Other settings than today's suit the plant as it is now.",
        (("out", "Settings to enter"), ("whatif", "Try them first")),
    ),
    Action.CHECK_VALVE: ToDo(
        "Check the valve",
        "A valve does not follow its OP. Mend that first: tuning would be for the valve, not for the plant.",
        (("trends", "See it in the record"),),
    ),
    Action.GET_DATA: ToDo(
        "Get data",
        "These data do not say enough. Nothing should be changed on their account.",
        (("trends", "Look at the record"), ("plan", "Moves that would tell")),
    ),
}


ANOTHER_CONTROLLER = ToDo(
    "Look up the controller's settings",
    "OP was not written by the controller that is declared. What the loops do today, and which settings would suit "
    "them, is not known before its settings are.",
    (("model", "Model and controllers"),),
)
"""In place of more data, where the settings are the data that is missing."""
MOVED = ToDo(
    "Find out what it does now",
    "The plant did not do the same throughout the record. What is given for it lies between before and after.",
    (("track", "When it changed, and to what"), ("trends", "Look at the record")),
)


TUNING_UNKNOWN = ToDo(
    "See whether the tuning still suits it",
    "The plant has changed, and what today's controllers do with it is not known.",
    (("model", "Model and controllers"),),
)
"""In place of "nothing", where nothing is known of the loops."""


async def verdict(request: Request) -> Response:
    """The page."""
    found = await run_in_threadpool(saved_of, request)
    if found is None:
        return page(request, "verdict.html.j2", screen="verdict", body=None, saved=None, said={})
    links = {screen: url(request, screen) for screen in ("run", "trends", "model", "whatif", "plan", "track")}
    links["out"] = url(request, "out", **_named(request))
    report = url(request, "out/report", **_named(request))
    ready = request.app.state.screens
    body = await run_in_threadpool(_body, found, {k: v for k, v in links.items() if k in ready}, report)
    said = {"result": request.query_params.get("result", ""), "refused": found.result.status == Status.REFUSED}
    return page(request, "verdict.html.j2", screen="verdict", body=body, saved=found, said=said)


async def element(request: Request) -> Response:
    """One element: HTML and figures."""
    found = await run_in_threadpool(saved_of, request)
    place = request.query_params.get("output", ""), request.query_params.get("input", "")
    elements = () if found is None else found.result.elements
    asked = next((one for one in elements if (one.output, one.input) == place), None)
    if found is None or asked is None:
        raise HTTPException(404, f"There is no element {place[1]} → {place[0]} in this result: load the page again.")
    from trueplant.app.element_view import element_view

    return ok(await run_in_threadpool(element_view, found.result, asked))


def _named(request: Request) -> dict[str, str]:
    named = request.query_params.get("result", "")
    return {"result": named} if named else {}


def _body(found: Saved, links: Mapping[str, str], report: str) -> Any:
    from trueplant.app.fragments import fragment
    from trueplant.report.cells import step_cells
    from trueplant.report.still import still_trends
    from trueplant.result.reason import is_common
    from trueplant.result.summary import loop_line, settings_lines, told_reasons

    result = found.result
    curves = result.curves
    refused = result.status == Status.REFUSED
    trends, more = still_trends(curves) if curves is not None and refused else ((), 0)
    return fragment(
        "verdict_body.html.j2",
        result=result,
        tone=_tone(result),
        headline=result.headline,
        action=to_do(result),
        links=links,
        report=report,
        inputs=_inputs(result, curves),
        rows=_rows(result, curves),
        drawings={} if curves is None or refused else step_cells(curves),
        marks=MARKS,
        modelled=any(e.tf_model is not None for e in result.elements),
        percent=100 * result.provenance.settings.confidence,
        loop_line=loop_line(result),
        settings=settings_lines(result),
        told=told_reasons(result),
        notes=_worth_knowing(result),
        more=next((note.message for note in result.notes if note.code == Code.MORE_DATA), ""),
        common=[note for note in result.notes if is_common(note)],
        trends=trends,
        more_trends=more,
        has_excluded=any(trend.has_excluded for trend in trends),
    )


def to_do(result: Result) -> ToDo:
    """What is to be done, as the sentence for the shift has it."""
    changed = any(element.verdict == ElementVerdict.CHANGED for element in result.elements)
    if result.action is Action.GET_DATA and is_another(result):
        return ANOTHER_CONTROLLER
    if result.action is Action.GET_DATA and has_moved(result):
        return MOVED
    return (
        TUNING_UNKNOWN if result.action is Action.NONE and changed and not result.robustness else TO_DO[result.action]
    )


def _tone(result: Result) -> str:
    """Colour of the verdict as a whole."""
    verdicts = {str(e.verdict) for e in result.elements}
    if result.status == Status.REFUSED:
        return "refused"
    if "changed" in verdicts:
        return "mismatch"
    return "partial" if "not identifiable" in verdicts else "agreement"


def _inputs(result: Result, curves: Curves | None) -> list[str]:
    own = list(curves.inputs) if curves is not None else []
    return list(dict.fromkeys([*own, *(e.input for e in result.elements)]))


def _rows(result: Result, curves: Curves | None) -> list[tuple[str, list[Element | None]]]:
    """Of the matrix: each output with its elements in the order of the inputs."""
    found = {(e.output, e.input): e for e in result.elements}
    own = list(curves.outputs) if curves is not None else []
    outputs = dict.fromkeys([*own, *(e.output for e in result.elements)])
    return [(output, [found.get((output, name)) for name in _inputs(result, curves)]) for output in outputs]


def _worth_knowing(result: Result) -> list[Reason]:
    """The notes in their order, but for the common ones, those that an element says as its reason, and the plan."""
    from trueplant.result.reason import is_common, ranked

    said = {(f"{e.input} -> {e.output}", e.reason) for e in result.elements if e.verdict == "not identifiable"}
    shown = [note for note in ranked(result.notes) if not is_common(note) and note.code != Code.MORE_DATA]
    return [note for note in shown if (note.where, note.message) not in said]


ROUTES = [Route("/verdict", verdict), Route("/api/verdict/element", element)]
