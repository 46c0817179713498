"""Samples in which nobody but a hand could have written OP: it stands still while the law would have moved it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from trueplant.loop import Controller, Sum, law_parts
from trueplant.record.runs import spread, true_runs
from trueplant.result import Code, ControllerCheck, Interval, Reason
from trueplant.study import levels
from trueplant.study.data.law_windows import Stretch
from trueplant.study.study import Study


def without_hand(
    stretches: Sequence[Stretch], controller: Controller, i: int
) -> tuple[tuple[Stretch, ...], tuple[Interval, ...]]:
    """The stretches without the samples in which OP i stands still by hand, and from when to when those are.

    OP stands still over a window and more, while the law as declared moves by many times what OP usually moves by:
    neither rounding nor a historian's exceptions explain that, nor a gain that is a few times smaller. Where it stands
    still for as long before or after, with a few samples between, these are of the same hand.
    """
    moves = np.concatenate([np.zeros(0), *(np.abs(np.diff(s.u))[s.good[1:]] for s in stretches)])
    usual = float(np.median(moves[moves > 0])) if moves.any() else 0.0
    left, found = [], []
    for s in stretches:
        law = np.sum([p.values for p in law_parts(controller, i, s.r, s.y, s.h, Sum.BACKWARD, Sum.BACKWARD, 1)], axis=0)
        begin, length = true_runs(np.append(False, np.diff(s.u) == 0) & s.good)
        begin, length = begin[length >= levels.LAW_WINDOW], length[length >= levels.LAW_WINDOW]
        end = begin + length
        against = [np.ptp(law[a - 1 : b]) > levels.STOOD_STILL * usual for a, b in zip(begin, end, strict=True)]
        apart = np.flatnonzero(begin[1:] - end[:-1] >= levels.LAW_WINDOW) + 1
        groups = [g for g in np.split(np.arange(begin.size), apart) if any(against[k] for k in g)]
        first, last = (np.array([x[g[k]] for g in groups], dtype=np.int64) for x, k in ((begin, 0), (end, -1)))
        left.append(replace(s, good=s.good & ~spread(first, last - first, s.u.size)))
        found += [(float(s.t[a]), float(s.t[b - 1])) for a, b in zip(first, last, strict=True)]
    return tuple(left), tuple(found)


def hand_notes(study: Study, checks: Sequence[ControllerCheck]) -> list[Reason]:
    """From when to when a loop looks to be in manual though no mode column says so."""
    names = [plan.name for plan in study.project.experiments]
    notes = []
    for check in checks:
        calendar = study.screened[names.index(check.experiment)].record.calendar
        times = [f"from {calendar.span(*one)}" for one in check.by_hand]
        if not times:
            continue
        shown, more = times[: levels.SHOWN_BY_HAND], len(times) - levels.SHOWN_BY_HAND
        said = f"{', '.join(shown)}{f' and {more} times more' if more > 0 else ''}"
        message = (
            f"{check.input} looks to be in manual {said}: OP stands still there, while its controller would have moved "
            "it. The controller was checked without that. Name the mode column of this input (mode = ...), or leave "
            "these hours out ([[data.exclude]]); if OP stood at a limit, declare the limit"
        )
        notes.append(Reason(Code.MANUAL, message, f"{check.experiment}, {check.input}"))
    return notes
