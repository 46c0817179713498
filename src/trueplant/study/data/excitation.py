"""Can these data answer at all? Closed-loop records without a set-point change cannot."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np
from scipy.stats import f as f_distribution

from trueplant.arrays import Array, BoolArray
from trueplant.record import Kind, Segment
from trueplant.result import Code, Reason
from trueplant.study import levels
from trueplant.study.data.bank import Asked, bounded_weights, weighed
from trueplant.study.data.setpoints import unexplained
from trueplant.study.study import Study


def doubts(study: Study) -> tuple[Reason, ...]:
    """Why nothing, or not everything, can be answered, as far as that shows before any estimate."""
    names = [plan.name for plan in study.project.experiments]
    refusals = [Reason(Code.RECORD, s.refusal, names[k]) for k, s in enumerate(study.screened) if s.refusal]
    return (*refusals, *why_not_informative(study), *_too_much(study))


def blocked(reasons: Sequence[Reason]) -> bool:
    """Do these reasons leave nothing to be answered?"""
    return any(reason.code in (Code.NO_EXCITATION, Code.TOO_LARGE) for reason in reasons)


def _too_much(study: Study) -> list[Reason]:
    """Said where the estimate would take hours: it grows with the samples and the square of an output's elements."""
    elements = Counter(i for i, _ in study.specs)
    samples = sum(map(len, study.segments))
    if samples * sum(n**2 for n in elements.values()) <= levels.MOST_WORK:
        return []
    return [
        Reason(
            Code.TOO_LARGE,
            f"to estimate {len(study.specs)} elements, up to {max(elements.values())} of one output, from {samples:,} "
            "samples would take hours: set estimate = false for elements that are trusted or small, split the plant "
            "into projects of loops that act on each other, or export fewer samples",
        )
    ]


def why_not_informative(study: Study) -> list[Reason]:
    """Reasons with the code "no-excitation" if no experiment excites the plant; else what limits the answer."""
    segments = study.segments
    if not segments:
        return []
    if excited(segments, [study.computed | alone for alone in study.computed_alone]):
        return []
    closed = [segment for segment in segments if segment.closed]
    if not closed:
        return [Reason(Code.NO_EXCITATION, _open_loop(segments))]
    if all(not np.isfinite(segment.r).any() for segment in closed):
        return [
            Reason(
                Code.NO_EXCITATION,
                "no set-point was recorded. Without it nothing tells the plant from the controller's inverse, however "
                "well a model fits: add the set-point columns (sp = ...), or an experiment in open loop",
            )
        ]
    moved = np.any([_moving(segment) for segment in closed], axis=0)
    computed = computed_somewhere(study)
    if moved.any() and not (moved & ~computed).any():
        return [
            Reason(
                Code.NO_EXCITATION,
                f"{_follow(study, computed)}, so that nothing moves the loop from outside. What PV then does shows the "
                "controllers as much as the plant: use a record in which someone moved the set-points, the master's in "
                "a cascade",
            )
        ]
    if moved.any():
        return [
            Reason(
                Code.NO_EXCITATION,
                "the set-points move too little: what PV does after their changes cannot be told from what "
                "disturbances do to it anyway, and in closed loop these show the controller (-1/Q) as much as the "
                f"plant{_kept_from_acting(study)}. Use a record with larger or more set-point changes",
            )
        ]
    return [
        Reason(
            Code.NO_EXCITATION,
            "no set-point changes in these data. In closed loop a model that fits them may be the inverse of the "
            "controller (-1/Q) instead of the plant: use a record in which the set-points were moved",
        )
    ]


def excited(segments: Sequence[Segment], computed: Sequence[BoolArray]) -> bool:
    """Does something moved from outside (set-points, in open loop OP) show in some PV beyond chance?

    `computed`, one an element (n_y,) for each segment, is True for a set-point that does not move from outside. The
    segments of an experiment are asked together, so that a record in pieces tells what the pieces tell.
    """
    sources = [sources_of(segment, known) for segment, known in zip(segments, computed, strict=True)]
    experiments = sorted({segment.experiment for segment in segments})
    p = []
    for k in experiments:
        own = [m for m, segment in enumerate(segments) if segment.experiment == k]
        moving = np.any([np.ptp(sources[m], axis=0) > 0 for m in own], axis=0)
        if moving.any():
            x = [sources[m][:, moving] for m in own]
            d = [segments[m].d for m in own]
            d = [one[:, np.any([np.ptp(each, axis=0) > 0 for each in d], axis=0)] for one in d]
            p += [_answer_p([segments[m].y[:, i] for m in own], x, d) for i in range(segments[own[0]].y.shape[1])]
    return bool(p) and min(p) * len(p) < levels.EXCITED


def sources_of(segment: Segment, computed: BoolArray) -> Array:
    """What may move the plant from outside (N, n_y), in open loop (N, n_u); 0 for what is not known or computed."""
    source, outside = segment.u, np.ones(segment.u.shape[1], dtype=bool)
    if segment.closed:
        source, outside = segment.setpoints, np.isfinite(segment.r).all(axis=0) & ~computed
    moved: Array = np.where(outside, source, 0.0)
    return moved


def _answer_p(outputs: Sequence[Array], sources: Sequence[Array], beside: Sequence[Array]) -> float:
    """p-value that an output, given its own past and that of others, does not answer to the sources through any of a
    bank of lags.

    outputs (N,), sources (N, n) and the others beside (N, m), one an element for each stretch; only samples whose past
    was measured are asked. Asked twice: all samples alike, and those that the past tells badly by less, so that a trip
    or another single upset does not hide what the rest of a record shows.
    """
    asked = Asked.of(outputs, sources, beside)
    if asked is None:
        return 1.0
    joined, order = asked.columns, asked.order + asked.beside
    if len(joined) <= joined.shape[1]:
        return 1.0
    bounded = bounded_weights(joined[:, : order + 1])
    return min(1.0, 2 * min(_added_p(joined, order, weights) for weights in (np.ones(len(joined)), bounded)))


def _added_p(joined: Array, order: int, weights: Array) -> float:
    """p-value that the first column (n,) owes nothing to those after the first 1 + order (F-test)."""
    joined = weighed(joined, weights)
    now, past, both = joined[:, 0], joined[:, 1 : order + 1], joined[:, 1:]
    count, left = both.shape[1] - order, len(now) - 1 - both.shape[1]
    own, rest = (float(np.sum(unexplained(now, x, rcond=1e-10) ** 2)) for x in (past, both))
    if own <= 1e-20 * float(np.sum(now**2)):
        return 0.0  # free of noise
    return float(f_distribution.sf((own - rest) / count / max(rest / left, 1e-300), count, left))


def _open_loop(segments: Sequence[Segment]) -> str:
    """Why open-loop records do not tell."""
    if not any(np.any(np.ptp(segment.u, axis=0) > 0) for segment in segments):
        return "no input moves in these data: record a stretch in which OP is moved"
    return (
        "the inputs move too little: what PV does after their changes cannot be told from what disturbances do to it "
        "anyway. Record a stretch with larger or more changes of OP"
    )


def _kept_from_acting(study: Study) -> str:
    """Says for how long limits or hands kept the OPs from following the set-points, where that was most of the time."""
    stuck = np.vstack([~segment.free for segment in study.segments if segment.closed]).mean(axis=0)
    j = int(np.argmax(stuck))
    if stuck[j] <= 0.5:
        return ""
    name = study.project.input_names[j]
    return f". OP of {name} was at a limit or in manual for {100 * stuck[j]:.3g} % of the record, and followed nothing"


def _moving(segment: Segment) -> BoolArray:
    """(n_y,) True for a set-point that was recorded throughout and changes."""
    moving: BoolArray = np.isfinite(segment.r).all(axis=0) & (np.ptp(segment.setpoints, axis=0) > 0)
    return moving


def computed_somewhere(study: Study) -> BoolArray:
    """(n_y,) True for a set-point that is computed from PV in all segments together or in one of them."""
    found: BoolArray = np.any([study.computed, *study.computed_alone], axis=0)
    return found


def _follow(study: Study, computed: BoolArray) -> str:
    """Says which set-points are computed from PV."""
    names = [name for name, one in zip(study.project.output_names, computed, strict=True) if one]
    one = len(names) == 1
    return (
        f"the set-point{'' if one else 's'} of {', '.join(names)} follow{'s' if one else ''} PV: "
        f"{'it is' if one else 'they are'} computed from it (by a master controller, or SP tracks PV)"
    )


def setpoint_moves(segment: Segment) -> Array:
    """(m, n_y) changes of the set-points from one sample to the next, where any changes."""
    r = segment.setpoints[:, np.isfinite(segment.r).all(axis=0)]
    if r.size == 0:
        return np.zeros((0, 0))
    steps = np.diff(r, axis=0)
    moves: Array = steps[np.any(steps != 0, axis=1)]
    return moves


def setpoint_rank_note(study: Study) -> list[Reason]:
    """Said where a set-point does not move from outside, or the set-points cannot be told from each other."""
    computed = computed_somewhere(study)
    if computed.any():
        return [
            Reason(
                Code.SETPOINT_COMPUTED,
                f"{_follow(study, computed)}, at least in a part of the data. That moves nothing from outside: the "
                "answer rests on what else does",
            )
        ]
    closed = [segment for segment in study.segments if segment.closed]
    if not closed or len(closed) < len(study.segments):
        return []
    moves = [m for m in map(setpoint_moves, closed) if m.size]
    n_y = closed[0].r.shape[1]
    if not moves or n_y < 2 or len({m.shape[1] for m in moves}) > 1:
        return []
    stacked = np.vstack(moves)
    size = np.linalg.norm(stacked, axis=0)
    still = [study.project.output_names[k] for k in range(stacked.shape[1]) if size[k] == 0]
    if still:
        return [
            Reason(
                Code.SETPOINT_STILL,
                f"the set-point of {', '.join(still)} never moves: the inputs move only as the loops let them, and "
                "the intervals are as wide as that makes them; move every set-point for a sharper answer",
            )
        ]
    values = np.linalg.svd(stacked / size, compute_uv=False)
    if values[-1] < levels.SAME_PROPORTION * values[0]:
        return [
            Reason(
                Code.SETPOINT_RANK,
                "the set-points always move in the same proportion, so the closed form (17)-(20) cannot be used: "
                "one direction of the plant is seen only through the dynamics of the loops",
            )
        ]
    return []


def manual_notes(study: Study) -> list[Reason]:
    """Said where a loop that counts as closed was in manual for most of a record, as its mode column has it."""
    notes = []
    for s in study.screened:
        if not s.record.closed or s.refusal is not None:
            continue
        for name, share in zip(s.record.inputs, 1 - s.record.automatic.mean(axis=0), strict=True):
            if share > levels.MOSTLY_MANUAL:
                notes.append(
                    Reason(
                        Code.MANUAL,
                        f"{name} was in manual for {100 * share:.3g} % of {s.record.name}, as its mode column has it: "
                        "its moves there are taken as made by hand. If the loop was closed, name the values that mean "
                        "automatic in automatic_values",
                        name,
                    )
                )
    return notes


def mostly_filled_in(study: Study, k: int) -> dict[str, float]:
    """Signals of experiment k of which a historian left little, with the share that it filled in on straight lines."""
    compressed = [f for f in study.screened[k].findings if f.kind == "compressed" and f.value is not None]
    return {f.signal: 1 - f.value for f in compressed if f.value is not None and 1 - f.value > levels.FILLED_IN}


def repeated_time_notes(study: Study) -> list[Reason]:
    """Said where so many rows repeat a time that they may have been recorded oftener than the times tell."""
    return [
        Reason(Code.REPEATED_TIMES, f"{found.message} Until then no time constant can be trusted", s.record.name)
        for s in study.screened
        for found in s.findings
        if s.refusal is None and found.kind is Kind.DUPLICATE and found.value is not None
    ]


def compression_notes(study: Study) -> list[Reason]:
    """Said where a historian left little of a signal that is used all the same."""
    notes = []
    for k, s in enumerate(study.screened):
        if s.refusal is None and (told := mostly_filled_in(study, k)):
            named = ", ".join(f"{name} ({100 * part:.2g} %)" for name, part in told.items())
            notes.append(
                Reason(
                    Code.COMPRESSED,
                    f"a historian stored only part of {named} and filled in the share in brackets on straight lines: "
                    "what happened in between is not known. For a PV intervals count how far held values would move "
                    "them; for an OP gains, time constants and above all dead times may be off by more than their "
                    "intervals say. Export the record without compression",
                    s.record.name,
                )
            )
    return notes
