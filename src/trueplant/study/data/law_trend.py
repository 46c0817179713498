"""OP as it was recorded, and as the declared controller writes it: what one looks at beside the check in words."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from trueplant.arrays import Array, IntArray
from trueplant.errors import LoopError
from trueplant.loop import Controller, replay
from trueplant.project import Project
from trueplant.record import Segment
from trueplant.result import Calendar, ControllerCheck
from trueplant.study import levels
from trueplant.study.data.controller_check import check_controllers, held
from trueplant.study.data.prepare import prepare
from trueplant.study.study import Progress, Study, quiet
from trueplant.threads import one_thread


@dataclass(frozen=True, eq=False)
class LawTrend:
    """One OP over one experiment; NaN between stretches."""

    t: Array
    op: Array
    """As recorded."""
    law: Array
    """As the law writes it on the recorded set-points and PVs; its integral begins anew again and again."""


@dataclass(frozen=True, eq=False)
class Replayed:
    """What the record says of the controller of one OP in one experiment."""

    check: ControllerCheck
    trend: LawTrend | None
    """None where the law cannot be run on the record."""
    calendar: Calendar


@one_thread()
def replays_of(project: Project, say: Progress = quiet) -> tuple[Replayed, ...]:
    """Does each declared controller reproduce the OP that was recorded? Raises what `prepare` raises."""
    study = prepare(project, say)
    names = [plan.name for plan in project.experiments]
    found = []
    for check in check_controllers(study):
        k, i = names.index(check.experiment), project.input_names.index(check.input)
        try:
            trend = law_trend(study, k, i)
        except LoopError:
            trend = None
        found.append(Replayed(check, trend, study.screened[k].record.calendar))
    return tuple(found)


def law_trend(study: Study, k: int, i: int) -> LawTrend:
    """Of experiment k and input i. Raises LoopError for a law that cannot be run, or with no stretch to run it on."""
    controller = study.records.declared[k]
    segments = study.screened[k].segments
    if controller is None or not segments:
        return LawTrend(np.zeros(0), np.zeros(0), np.zeros(0))
    pieces = max(1, levels.LAW_TREND_PIECES // len(segments))
    columns: list[Array] = []
    for segment in segments:
        law = _at(controller, segment.h)
        for part in np.array_split(np.arange(len(segment)), min(pieces, max(1, len(segment) // levels.LAW_WINDOW))):
            columns += [_piece(segment, law, i, part), np.full((1, 3), np.nan)]
    table = np.vstack(columns)
    return LawTrend(table[:, 0], table[:, 1], table[:, 2])


def _piece(segment: Segment, law: Controller, i: int, part: IntArray) -> Array:
    """(n, 3) times, OP and the law's, whose integral begins where it lies on OP in the middle."""
    at = slice(int(part[0]), int(part[-1]) + 1)
    r, y, u = held(segment.r[at]), held(segment.y[at]), held(segment.u[at])
    written = replay(law, r, y, segment.h, first=u[0])
    op = segment.u[at, i]
    drawn = np.asarray(written[:, i] + float(np.median(op - written[:, i])), dtype=np.float64)
    drawn[: min(levels.LAW_WINDOW, drawn.size // 4)] = np.nan  # what its filter held before is not known
    return np.column_stack([segment.t[at], op, drawn])


def _at(controller: Controller, h: float) -> Controller:
    """The law at the samples that there are: a scan that is shorter cannot be followed."""
    entries = {
        place: replace(entry, sample_time=h) if entry.sample_time is not None and entry.sample_time < h else entry
        for place, entry in controller.entries.items()
    }
    return replace(controller, entries=entries)
