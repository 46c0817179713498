"""Tracking as one straight line: records, windows, estimates, changes, the result."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np

from trueplant.calendar import unit_seconds
from trueplant.errors import DataError, ProjectError, UsageError
from trueplant.project.project import Project
from trueplant.record import Record
from trueplant.result import Code, Reason, Status, Track, TrackedExperiment, Window, WindowElement
from trueplant.study.data.excitation import blocked, doubts
from trueplant.study.data.prepare import prepare
from trueplant.study.data.tables import provenance
from trueplant.study.plant.parameters import parameters_of
from trueplant.study.study import Progress, Study, quiet
from trueplant.threads import one_thread
from trueplant.tracking import levels
from trueplant.tracking.changes import find_changes
from trueplant.tracking.rows import Fitted, follow_rows
from trueplant.tracking.series import Followed
from trueplant.tracking.standing import standings
from trueplant.tracking.windows import Stretch


@one_thread()
def track(
    project: Project,
    precision: float = levels.PRECISION,
    progress: Progress = quiet,
    frames: Sequence[Any] | None = None,
) -> Track:
    """Parameters over time, and since when they changed. Refusals are results; unusable input raises.

    `precision` is the relative standard error for which each window is made long enough. `progress` is told what is
    being done, in a few words, as each step begins. `frames` stand in for the files of the experiments.
    """
    if not 0 < precision <= levels.LARGEST_PRECISION:
        raise UsageError(f"a precision of {100 * precision:g} % cannot be asked for: name one above 0 and up to 50 %")
    say = progress
    say("reading the data")
    study = prepare(project, say, frames)
    if study.wanted:
        raise ProjectError(
            f"{project.source}: has no model for all elements, and track follows one: find it with trueplant run on a "
            "stretch with set-point moves, and give the plant.toml that it writes"
        )
    experiments = lay_out(study)
    reasons = list(doubts(study))
    if not study.segments or blocked(reasons):
        reasons = reasons or [Reason(Code.NO_DATA, "no usable data are left after screening")]
        return _refused(study, experiments, reasons, precision)
    offsets = {k: e.offset for k, e in enumerate(experiments)}
    settings = project.analysis
    rows = follow_rows(study, offsets, precision, say)
    followed, elements, changes = find_changes(rows, 1 - settings.confidence, settings.seed, say)
    standing = standings(followed, changes, say)
    windows = [_window(one, w) for one in followed for w in one.windows]
    if not any(w.status == Status.OK for w in windows):
        why = [w.reason for w in windows]
        longest = max(windows, key=lambda w: w.end - w.start).reason if why else "no output can be followed"
        reasons.append(Reason(Code.NO_WINDOW, f"no stretch of the record can be estimated: {longest}"))
    windows += [
        Window(output, e.name, e.span[0], e.span[1], Status.REFUSED, s.refusal)
        for s, e in zip(study.screened, experiments, strict=True)
        if s.refusal
        for output in project.output_names
    ]
    found = Track(
        status=Status.OK if any(w.status == Status.OK for w in windows) else Status.REFUSED,
        reasons=tuple(reasons),
        notes=(*study.notes, *_notes(followed)),
        provenance=provenance(study, 100 * precision),
        time_unit=project.time_unit,
        experiments=tuple(experiments),
        windows=tuple(sorted(windows, key=lambda w: (w.output, w.start))),
        elements=tuple(replace(e, standing=standing.get((e.output, e.input))) for e in elements),
        changes=tuple(changes),
    )
    return _with_calendar(found, study)


def lay_out(study: Study) -> list[TrackedExperiment]:
    """The records on one time axis: by their time stamps, else as they are if they follow each other, else in order.

    Raises DataError for records that overlap in time.
    """
    records = [s.record for s in study.screened]
    unit = unit_seconds(study.project.time_unit)
    spans = [(float(r.t[0]), float(r.t[-1])) for r in records]
    starts = [r.start for r in records]
    if _stamped(records):
        offsets = [(s - starts[0]).total_seconds() / unit for s in starts if s and starts[0]]
    elif all(b[0] > a[1] for a, b in pairwise(spans)):
        offsets = [0.0] * len(records)
    else:
        offsets, end = [], 0.0
        for record, span in zip(records, spans, strict=True):
            offsets.append(end - span[0])
            end += span[1] - span[0] + record.sample_time
    placed = sorted((o + a, o + b, r.name) for o, (a, b), r in zip(offsets, spans, records, strict=True))
    for (_, before, first), (after, _, second) in pairwise(placed):
        if after <= before:
            raise DataError(f"{first} and {second} overlap in time: a plant is followed through one record at a time")
    return [
        TrackedExperiment(
            r.name, o, r.start.isoformat() if r.start else None, (o + a, o + b), r.calendar.stamps((a, b))
        )
        for o, (a, b), r in zip(offsets, spans, records, strict=True)
    ]


def _stamped(records: Sequence[Record]) -> bool:
    """Do all records bear time stamps of one kind, so that these are their common axis?"""
    return {r.start is not None and r.start.tzinfo is None for r in records} != {True, False} and all(
        r.start is not None for r in records
    )


def _with_calendar(found: Track, study: Study) -> Track:
    """The time stamps beside the times, where the common axis has them."""
    records = [s.record for s in study.screened]
    if not _stamped(records):
        return found
    calendar = records[0].calendar
    return replace(
        found,
        start=records[0].start.isoformat() if records[0].start else None,
        time_zone=calendar.zone,
        windows=tuple(replace(w, calendar=calendar.stamps((w.start, w.end))) for w in found.windows),
        changes=tuple(
            replace(c, time_calendar=calendar.stamp(c.time), interval_calendar=calendar.stamps(c.interval))
            for c in found.changes
        ),
    )


def _window(one: Followed, window: Fitted | Stretch) -> Window:
    """A window of `Followed` as the result has it."""
    project = one.row.study.project
    output = project.output_names[one.row.output]
    blocks = one.plan.blocks
    inside = (blocks.start < window.end) & (blocks.end > window.start)
    name = ", ".join(project.experiments[k].name for k in dict.fromkeys(blocks.experiment[inside].tolist()))
    if isinstance(window, Stretch):
        return Window(output, name, window.start, window.end, Status.REFUSED, window.refusal)
    elements = tuple(_element(one, window, column) for column in sorted(window.found))
    return Window(output, name, window.start, window.end, Status.OK, "", elements)


def _element(one: Followed, window: Fitted, column: int) -> WindowElement:
    verdict = window.verdicts[column]
    parameters = parameters_of(window.found[column], verdict, one.row.units(column))
    return WindowElement(one.row.study.columns[column], verdict.verdict, verdict.p_adjusted, parameters)


def _notes(followed: list[Followed]) -> list[Reason]:
    notes = []
    for one in followed:
        output = one.row.study.project.output_names[one.row.output]
        if one.row.pilot.predicted_by:
            told = ", ".join(one.row.study.project.output_names[j] for j in one.row.pilot.predicted_by)
            text = f"a disturbance reaches {told} before it reaches {output}: standard errors were widened for that"
            notes.append(Reason(Code.SHARED_DISTURBANCE, text, output))
        if one.plan.demand.precision and not np.isfinite(one.plan.demand.limits).any():
            notes.append(Reason(Code.PILOT, "the first estimate answers no parameter of this output", output))
    return notes


def _refused(study: Study, experiments: list[TrackedExperiment], reasons: list[Reason], precision: float) -> Track:
    windows = tuple(
        Window(output, e.name, e.span[0], e.span[1], Status.REFUSED, s.refusal or reasons[0].message)
        for output in study.project.output_names
        for s, e in zip(study.screened, experiments, strict=True)
    )
    found = Track(
        status=Status.REFUSED,
        reasons=tuple(reasons),
        notes=study.notes,
        provenance=provenance(study, 100 * precision),
        time_unit=study.project.time_unit,
        experiments=tuple(experiments),
        windows=windows,
    )
    return _with_calendar(found, study)
