"""What `check` struck out of a record, each stretch with its reason, and what of it the project file can overrule."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from trueplant.app.screens import edits
from trueplant.calendar import Calendar
from trueplant.errors import ProjectError
from trueplant.project import ExperimentPlan, Project
from trueplant.project.exclusions import time_of
from trueplant.record.types import Kind
from trueplant.result import ExperimentData

SHOWN = 200
"""Stretches of one reason that are listed: more are for nobody to read."""
WORDS = {
    Kind.EXCLUDED: "excluded by you",
    Kind.OUT_OF_RANGE: "at or beyond the instrument's range",
    Kind.FROZEN: "stood still while OP moved",
    Kind.SPIKE: "short spike",
    Kind.MISSING: "no value",
    Kind.BAD_QUALITY: "bad status",
    Kind.COMPRESSED: "straight lines of a historian",
    Kind.TEXT: "text instead of a number",
    Kind.CODE: "a code instead of a measurement",
    Kind.OVERLAP: "in another record, too",
    Kind.DUPLICATE: "time of the row before",
}
KEPT = (Kind.FROZEN, Kind.SPIKE)
"""Kinds that `keep` of an output overrules."""
NEVER: dict[str, str] = {
    Kind.MISSING: "there is no value to use",
    Kind.TEXT: "there is no number to use",
    Kind.CODE: "such a number is no measurement",
    Kind.COMPRESSED: "what was measured there is not in the record",
    Kind.BAD_QUALITY: "the historian says so in the record itself",
    Kind.OVERLAP: "they count once, in the other record",
    Kind.DUPLICATE: "they count once",
}
"""Why samples of other kinds cannot be used."""


def struck_list(project: Project, record: ExperimentData) -> list[dict[str, Any]]:
    """A row a signal and reason: what it is, where, and how it is overruled."""
    calendar = record.calendar(project.time_unit)
    rows = []
    for finding in record.findings:
        kept = finding.kind in KEPT and not finding.excludes
        if finding.kind == Kind.EXCLUDED or not (finding.excludes or kept):
            continue
        spans = [span for span in finding.spans if span[1] >= span[0]]
        rows.append(
            {
                "signal": finding.signal,
                "reason": finding.kind,
                "words": WORDS.get(Kind(finding.kind), finding.kind) + (": used all the same" if kept else ""),
                "message": finding.message,
                "samples": finding.samples,
                "count": len(spans),
                "spans": [[*span, calendar.span(*span)] for span in spans[:SHOWN]],
                "overrule": "Leave them out again" if kept else _overrule(project, finding.signal, finding.kind),
                "never": NEVER.get(finding.kind, ""),
            }
        )
    return rows


def _overrule(project: Project, signal: str, reason: str) -> str | None:
    """What the button says; None where there is nothing to use, or the project file does not say it."""
    if reason in KEPT:
        return "Use them all the same"
    if reason == Kind.OUT_OF_RANGE and any(one.name == signal and one.limits for one in project.outputs):
        return "Use them: take the limits out"
    if reason == Kind.BAD_QUALITY and _of_status(project, signal) is not None:
        return "Use them: do without the status"
    return None


def _of_status(project: Project, column: str) -> tuple[str, str] | None:
    """The table and the name of the signal whose status strikes this column."""
    named = [("output", one.name, one.pv, one.status) for one in project.outputs]
    named += [("input", one.name, one.op, one.status) for one in project.inputs]
    return next(((table, name) for table, name, own, status in named if own == column and status), None)


def overruled(project: Project, signal: str, reason: str) -> Callable[[str], str]:
    """The edit that lets such samples be used, or no longer. Raises ProjectError where there is none."""
    output = next((one for one in project.outputs if one.name == signal), None)
    if reason in KEPT and output is not None:
        keep = [one for one in KEPT if (one in output.keep) != (one == reason)]
        return lambda text: edits.set_keys(text, "output", signal, {"keep": keep or None})
    if reason == Kind.OUT_OF_RANGE:
        return lambda text: edits.set_keys(text, "output", signal, {"limits": None})
    place = _of_status(project, signal) if reason == Kind.BAD_QUALITY else None
    if place is None:
        raise ProjectError(f"these samples cannot be used: {NEVER.get(reason, 'nothing overrules this reason')}")
    return lambda text: edits.set_keys(text, *place, {"status": None})


def exclusions(project: Project, plan: ExperimentPlan, calendar: Calendar) -> list[dict[str, Any]]:
    """The stretches of data.exclude that concern this record, with their places in that list."""
    rows = []
    for place, entry in enumerate(project.data.exclude):
        if entry.file not in (None, plan.file):
            continue
        start = time_of(project, calendar, entry.start)
        end = time_of(project, calendar, entry.end, late=True)
        rows.append({"place": place, "from": start, "to": end, "text": calendar.span(start, end)})
    return rows
