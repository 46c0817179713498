"""The stretches of a long history that are worth an analysis, ranked by what they tell.

The worth of a stretch is the Fisher information of its recorded inputs at a first estimate, as for the windows of
tracking. The first is the one that tells the gains best, each further one that which tells them best together with
those before it (greedy A-optimal design; Pukelsheim 2006), each gain relative to its size.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from trueplant.arrays import Array
from trueplant.identify import Held, Row, RowFit, Spec, choose_stride, estimate_row, pieces_of, samples_per_update
from trueplant.identify.linear_algebra import inverse
from trueplant.identify.strides import typical_lag
from trueplant.project import Project
from trueplant.record import Segment
from trueplant.result import Check, Code, ExpectedGain, Reason, Status, UsableStretch
from trueplant.study.check import checked
from trueplant.study.data.excitation import excited
from trueplant.study.data.prepare import prepare
from trueplant.study.data.reached import unreached_elements
from trueplant.study.data.timing import update_interval
from trueplant.study.study import Progress, Study, quiet
from trueplant.threads import one_thread
from trueplant.tracking import levels
from trueplant.tracking.rows import most_moves
from trueplant.tracking.usable import OutsideMoves, moves_by_experiment, stretches
from trueplant.tracking.windows import Blocks, blocks_of, part_of, settling


@one_thread()
def find(project: Project, say: Progress = quiet, frames: Sequence[Any] | None = None) -> Check:
    """What `check` says, and the stretches with usable moves; refused where there is none.

    `frames` stand in for the files of the experiments. Raises what `prepare` raises.
    """
    study = prepare(project, say, frames)
    found = checked(study)
    if not study.segments:
        return replace(found, usable=())
    say("looking for moves")
    lag = typical_lag(list(study.specs.values()))
    first = levels.FIRST_SETTLED * study.segments[0].h if lag is None else levels.SETTLED * lag
    moves = moves_by_experiment(study, first)
    usable: tuple[UsableStretch, ...] = ()
    tried: list[_Candidate] = []
    if any(m.times.size for m in moves.values()):
        say("a first estimate")
        rows = _first_estimate(study, {k: m.times for k, m in moves.items()}, first)
        settle = max((row.settle for row in rows), default=first)
        moves = moves_by_experiment(study, settle)
        say("weighing the stretches")
        tried = _candidates(study, rows, moves, settle)
        unreached = unreached_elements(study)
        usable = tuple(_told(study, rows, one, unreached) for one in _ranked(study, rows, tried))
    # what is said of the whole history together does not hold for parts of it
    others = tuple(r for r in found.reasons if r.code not in (Code.NO_EXCITATION, Code.TOO_LARGE))
    if usable:
        return replace(found, status=Status.OK, reasons=others, usable=usable)
    return replace(found, status=Status.REFUSED, reasons=(_why_none(study, found, moves, tried), *others), usable=())


@dataclass(frozen=True, eq=False)
class _EstimatedRow:
    """One output at its first estimate."""

    output: int
    fit: RowFit
    held: tuple[Held, ...]
    update: int

    @property
    def settle(self) -> float:
        """How long a move keeps showing, and what lies around it has to be to tell the noise."""
        row = self.fit.row
        return max(settling(self.fit), levels.FEWEST_AROUND * row.pieces[0].h * row.stride)

    @property
    def size(self) -> Array:
        """(p,) what the errors of the parameters are measured by."""
        row, theta = self.fit.row, self.fit.theta
        model = np.concatenate(
            [np.abs(s.initial) if s.initial else np.zeros(len(s.structure.names)) for s in row.specs]
        )
        return np.asarray(np.maximum(np.abs(theta), model) + row.lag_of_dead_times(theta) + np.finfo(float).tiny)


@dataclass(frozen=True, eq=False)
class _Candidate:
    """A stretch, and what it tells of each row: information (p, p) of the relative errors, its level eliminated."""

    experiment: int
    start: float
    end: float
    told: tuple[Array, ...]
    moves: OutsideMoves

    def errors(self, rows: Sequence[_EstimatedRow]) -> list[Array]:
        """(n_gains,) relative standard errors of the gains of each row from this stretch alone."""
        errors = [np.sqrt(np.diag(inverse(told, levels.NO_INFORMATION))) for told in self.told]
        return [levels.SHORTFALL * e[row.fit.row.is_gain] for e, row in zip(errors, rows, strict=True)]


def _first_estimate(study: Study, moves: Mapping[int, Array], settle: float) -> list[_EstimatedRow]:
    """Each output from the stretch with most moves, a longer one while no gain of it is told."""
    interval = update_interval(study)
    stride = choose_stride(study.segments, list(study.specs.values()), interval)
    update = samples_per_update(interval, study.segments[0].h)
    samples, wanted = sum(map(len, study.segments)), levels.PILOT * stride
    while True:
        segments = most_moves(study, moves, wanted)[1]
        rows = [row for i in range(study.model.shape[0]) if (row := _row(study, segments, i, stride, update, settle))]
        if wanted >= samples or (rows and all(_tells_a_gain(row) for row in rows)):
            return rows
        wanted *= levels.PILOT_GROWTH


def _row(
    study: Study, segments: Sequence[Segment], i: int, stride: int, update: int, settle: float
) -> _EstimatedRow | None:
    specs = tuple(spec for (output, _), spec in study.specs.items() if output == i)
    own = {spec.column for spec in specs}
    model = study.model
    held = tuple(Held(j, model[i, j]) for j in range(model.shape[1]) if j not in own and not model[i, j].is_zero)
    pieces = pieces_of(segments, i, held, update)
    if not specs or not pieces:
        return None
    fit = estimate_row(Row(specs, pieces, stride), settle / levels.SETTLED)
    power = max((piece.spread for piece in pieces), default=0.0) ** 2
    floor = np.finfo(float).eps * power + np.finfo(float).tiny  # a record free of noise
    return _EstimatedRow(i, replace(fit, variance=max(fit.variance, floor)), held, update)


def _tells_a_gain(row: _EstimatedRow) -> bool:
    relative = row.fit.standard_errors_by_data / row.size
    return bool(np.any(relative[row.fit.row.is_gain] <= levels.LARGEST_PRECISION))


def _candidates(
    study: Study, rows: Sequence[_EstimatedRow], moves: Mapping[int, OutsideMoves], settle: float
) -> list[_Candidate]:
    found = []
    for k, own in moves.items():
        segments = study.screened[k].segments
        spans = stretches(segments, own.times, settle)
        if len(spans) > levels.MOST_CANDIDATES:
            spans = sorted(spans, key=lambda span: -own.within(*span)[1])[: levels.MOST_CANDIDATES]
        blocks = [_blocks(row, segments, own.times) for row in rows]
        for span in spans:
            told = tuple(_information(row, one, span) for row, one in zip(rows, blocks, strict=True))
            found.append(_Candidate(k, *span, told, own))
    return found


def _blocks(row: _EstimatedRow, segments: Sequence[Segment], times: Array) -> Blocks | None:
    """The information of a row in an experiment; None where its output was not measured."""
    pieces = pieces_of(segments, row.output, row.held, row.update)
    return blocks_of(row.fit, replace(row.fit.row, pieces=pieces), times) if pieces else None


def _information(row: _EstimatedRow, blocks: Blocks | None, span: tuple[float, float]) -> Array:
    """(p, p) of the relative errors of a row in a stretch whose level is not known."""
    size = row.size
    if blocks is None:
        return np.zeros((size.size, size.size))
    inside = np.minimum(blocks.end, span[1]) - np.maximum(blocks.start, span[0])
    share = np.maximum(inside, 0.0) / (blocks.end - blocks.start)
    total = np.tensordot(share, blocks.information, axes=1)
    level = total[:-1, -1] / np.sqrt(max(total[-1, -1], np.finfo(float).tiny))
    told: Array = (total[:-1, :-1] - np.outer(level, level)) * np.outer(size, size)
    return told


def _ranked(study: Study, rows: Sequence[_EstimatedRow], tried: Sequence[_Candidate]) -> list[_Candidate]:
    """The stretches that tell a gain, the one that adds most first.

    To begin with, a parameter is known to its own size. What moves has to show in some PV, too.
    """
    left = [c for c in tried if any(np.any(e <= levels.LARGEST_PRECISION) for e in c.errors(rows))]
    known = [np.eye(row.fit.theta.size) for row in rows]
    ranked: list[_Candidate] = []
    while left and len(ranked) < levels.MOST_FOUND:
        best = min(left, key=lambda c: _uncertainty(rows, known, c))
        left.remove(best)
        if _shows(study, best):
            ranked.append(best)
            known = [k + told for k, told in zip(known, best.told, strict=True)]
    return ranked


def _uncertainty(rows: Sequence[_EstimatedRow], known: Sequence[Array], more: _Candidate) -> float:
    """Sum of the squared relative errors of all gains from what is known and one stretch more."""
    covariances = (inverse(k + told) for k, told in zip(known, more.told, strict=True))
    return float(sum(np.diag(c)[row.fit.row.is_gain].sum() for c, row in zip(covariances, rows, strict=True)))


def _shows(study: Study, one: _Candidate) -> bool:
    segments = part_of(study.screened[one.experiment].segments, one.start, one.end)
    return bool(segments) and excited(segments, [study.computed] * len(segments))


def _told(
    study: Study, rows: Sequence[_EstimatedRow], one: _Candidate, unreached: Collection[tuple[int, int]]
) -> UsableStretch:
    """A stretch as the result has it, from its first to its last sample; nothing is told of `unreached` elements."""
    screened, project = study.screened[one.experiment], study.project
    t = screened.record.t
    first, last = np.searchsorted(t, one.start), np.searchsorted(t, one.end, side="right") - 1
    span = float(t[first]), float(t[last])
    channels, moves = one.moves.within(*span)
    names = project.output_names if screened.record.closed else project.input_names
    expected = [
        _expected(study, row, spec, part, np.inf if (row.output, spec.column) in unreached else error)
        for row, errors in zip(rows, one.errors(rows), strict=True)
        for spec, part, error in _gains(row, errors)
    ]
    return UsableStretch(
        project.experiments[one.experiment].name,
        *span,
        tuple(names[c] for c in channels),
        moves,
        tuple(expected),
        screened.record.calendar.stamps(span),
    )


def _gains(row: _EstimatedRow, errors: Array) -> list[tuple[Spec, int, float]]:
    """Each gain of a row: its element, its place in theta, its relative error."""
    specs = [spec for spec in row.fit.row.specs for _ in spec.structure.names]
    return [(specs[p], int(p), float(e)) for p, e in zip(np.flatnonzero(row.fit.row.is_gain), errors, strict=True)]


def _expected(study: Study, row: _EstimatedRow, spec: Spec, place: int, error: float) -> ExpectedGain:
    project, unit = study.project, study.input_unit(spec.column)
    own = spec.structure.units(project.outputs[row.output].unit, unit, project.time_unit)
    first = next(part.start for s, part in zip(row.fit.row.specs, row.fit.row.slices, strict=True) if s is spec)
    value, std_error = float(row.fit.theta[place]), error * float(row.size[place])
    return ExpectedGain(
        output=project.output_names[row.output],
        input=study.columns[spec.column],
        parameter=row.fit.row.names[place],
        unit=own[place - first],
        value=value,
        std_error=std_error if std_error <= abs(value) else None,
    )


def _why_none(study: Study, found: Check, moves: Mapping[int, OutsideMoves], tried: Sequence[_Candidate]) -> Reason:
    """Why no stretch can be used, in the words of `check` where nothing moves from outside at all."""
    lost = sum(m.lost for m in moves.values())
    if tried:
        text = (
            "in no stretch of these data do the moves tell a gain to half of its size, beyond chance: they are too "
            "little against what disturbances do to PV. Make larger moves, or more of them close to each other"
        )
    elif lost:
        text = (
            f"set-points move {lost} times in these data, but only while the loop is in manual or OP is at a limit, "
            "where nothing follows them: find a history in which they move in automatic"
        )
    else:
        known = next((r for r in found.reasons if r.code == Code.NO_EXCITATION), None)
        if known is not None:
            return known
        text = "nothing moves from outside in these data: find a history in which someone moved the set-points"
    return Reason(Code.NO_EXCITATION, text)
