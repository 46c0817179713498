"""One output followed over time: its pilot estimate, its windows, and the estimate of each."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from trueplant import detect
from trueplant.arrays import Array
from trueplant.identify import (
    Held,
    OutputEstimate,
    Row,
    Sampling,
    Spec,
    as_if_sampled_on_the_grid,
    choose_stride,
    find_holds,
    identify_matrix,
    identify_output,
    pieces_of,
    samples_per_update,
    unanswered,
    with_holds,
)
from trueplant.identify.pieces import Piece
from trueplant.identify.shared_disturbance import widened_for_shared_disturbance
from trueplant.record import Segment
from trueplant.study.data.declared import declared_covariances
from trueplant.study.data.excitation import excited
from trueplant.study.data.scan import without_hidden_dynamics
from trueplant.study.data.setpoints import computed_setpoints
from trueplant.study.data.timing import timing_error, update_interval
from trueplant.study.plant.updated import updated_plant
from trueplant.study.study import Progress, Study
from trueplant.tracking import levels
from trueplant.tracking.windows import (
    Blocks,
    Demand,
    Stretch,
    blocks_of,
    cut,
    demand_of,
    moves_of,
    part_of,
    planned,
    settling,
)

UNMOVED = (
    "what PV does after the moves of this stretch cannot be told from what disturbances do to it anyway: "
    "the moves are too small"
)


@dataclass(frozen=True, eq=False)
class Fitted:
    """A window and what was found in it. Times are on the common axis."""

    stretch: Stretch
    start: float
    end: float
    estimate: OutputEstimate
    found: Mapping[int, detect.Found]
    """By column."""
    verdicts: Mapping[int, detect.Verdict]


@dataclass(frozen=True, eq=False)
class Plan:
    """What windows of one output have to be like, as predicted from an estimate of it."""

    demand: Demand
    settle: float
    """Time that a move keeps showing."""
    blocks: Blocks
    """The information in each part of the record, in common time."""


@dataclass(frozen=True, eq=False)
class FollowedRow:
    """One output: everything that does not depend on where its windows lie."""

    study: Study
    output: int
    pilot: OutputEstimate
    held: tuple[Held, ...]
    update: int
    timing: float
    precision: float
    offsets: Mapping[int, float]
    """By experiment: added to its own time."""
    moves: Mapping[int, Array]
    """By experiment: when something moved."""
    pieces: Mapping[int, tuple[Piece, ...]]
    """By experiment: the whole record."""
    pilot_stretch: tuple[float, float]
    """Common time."""
    fits: dict[Stretch, Fitted | Stretch] = field(default_factory=dict)
    """A memory of the windows that were tried, fitted or refused after all: laying windows anew meets most of them
    again, and a fit is what tracking takes its time for."""

    @property
    def specs(self) -> tuple[Spec, ...]:
        return self.pilot.row.specs

    def planned_across(self, instant: float) -> bool:
        """Does the pilot estimate use data from both sides of an instant?"""
        return self.pilot_stretch[0] < instant < self.pilot_stretch[1]

    def plan_from(self, estimate: OutputEstimate) -> Plan:
        """What windows have to be like if this estimate is right."""
        reasons = unanswered(estimate)
        answered = [k for k in range(estimate.theta.size) if k not in reasons]
        demand = demand_of(estimate.fit, answered, self.study.columns, self.precision, self.study.project.time_unit)
        order = sorted(self.pieces, key=lambda k: self.offsets[k])
        own = [blocks_of(estimate.fit, replace(estimate.row, pieces=self.pieces[k]), self.moves[k]) for k in order]
        return Plan(demand, settling(estimate.fit), Blocks.joined(own, [self.offsets[k] for k in order]))

    def windows(self, plan: Plan, gaps: Sequence[tuple[float, float]], say: Progress) -> list[Fitted | Stretch]:
        """All windows in order of time; none reaches into one of the gaps (common time), where changes lie."""
        out: list[Fitted | Stretch] = []
        edges = [-np.inf, *(t for gap in gaps for t in gap), np.inf]
        for start, end in zip(edges[::2], edges[1::2], strict=True):
            part = cut(plan.blocks, start, end) if end > start else None
            if part is not None:
                out += self._section(plan, part, bool(gaps), say)
        return out

    def _section(self, plan: Plan, part: Blocks, beside_change: bool, say: Progress) -> list[Fitted | Stretch]:
        """The windows between two gaps."""
        closed = self.study.screened[int(part.experiment[0])].segments[0].closed
        laid = planned(part, plan.demand, plan.settle, "no set-point moves" if closed else "no OP moves")
        if (
            beside_change
            and all(w.refusal for w in laid)
            and part.errors[part.active].sum() >= levels.BESIDE_CHANGE * levels.FEWEST_ERRORS
        ):
            # little is left beside a change near the end: it is used all the same, to tell what the change was
            laid = [Stretch(float(part.start[0]), float(part.end[-1]))]
        out: list[Fitted | Stretch] = []
        for k, window in enumerate(laid, start=1):
            say(f"{self.study.project.output_names[self.output]}: window {k} of {len(laid)}")
            out.append(self._fit(window, plan.settle))
        return out

    def units(self, column: int) -> tuple[str, ...]:
        """Of the parameters of an element."""
        project = self.study.project
        inputs = [*(entry.unit for entry in project.inputs), *(entry.unit for entry in project.disturbances)]
        structure = next(spec.structure for spec in self.specs if spec.column == column)
        return structure.units(project.outputs[self.output].unit, inputs[column], project.time_unit)

    def stretch_segments(self, window: Stretch) -> list[Segment]:
        """What of all experiments lies in a window, in order of time."""
        found: list[Segment] = []
        for k in sorted(self.pieces, key=lambda k: self.offsets[k]):
            offset = self.offsets[k]
            found += part_of(self.study.screened[k].segments, window.start - offset, window.end - offset)
        return found

    def _fit(self, window: Stretch, settle: float) -> Fitted | Stretch:
        if window.refusal:
            return window
        if window not in self.fits:
            self.fits[window] = self._fitted(window, settle)
        return self.fits[window]

    def _fitted(self, window: Stretch, settle: float) -> Fitted | Stretch:
        segments = self.stretch_segments(window)
        computed = self.study.computed | computed_setpoints(segments)
        own = [replace(s, y=s.y[:, [self.output]]) for s in segments]
        if not excited(own, [computed] * len(own)):
            return replace(window, refusal=UNMOVED)
        estimate = self.estimate(segments, settle)
        if estimate is None:
            return replace(window, refusal="no PV can be used in this stretch")
        estimates = {self.output: estimate}
        found = detect.elements_found(self.study.model, estimates, declared_covariances(self.study))
        settings = self.study.project.analysis
        # A history rests on all windows together, but what is said of one alone has to show in it.
        worth_knowing = settings.worth_knowing_percent / 100
        verdicts = detect.judge_elements(
            found, estimates, settings.confidence, settings.tolerance_percent, worth_knowing
        )
        return Fitted(
            window,
            window.start,
            window.end,
            estimate,
            {j: f for (_, j), f in found.items()},
            {j: v for (_, j), v in verdicts.items()},
        )

    def estimate(self, segments: Sequence[Segment], settle: float) -> OutputEstimate | None:
        """The output from some segments, with all that widens its errors."""
        confidence = self.study.project.analysis.confidence
        estimate = identify_output(
            segments,
            self.output,
            self.specs,
            self.held,
            confidence=confidence,
            sampling=Sampling(self.pilot.row.stride, self.update, timing=self.timing),
            time_scale=settle / levels.SETTLED,
        )
        if estimate is None:
            return None
        if self.pilot.predicted_by:
            estimate = widened_for_shared_disturbance(estimate, self.pilot.predicted_by, confidence)
        return without_hidden_dynamics(self.study.hidden, self.output, estimate)

    def row_of(self, windows: Sequence[Fitted]) -> tuple[Row, Array]:
        """The raw record from the first to the last of some neighbouring windows, and the clock of its pieces."""
        whole = Stretch(windows[0].start, windows[-1].end)
        pieces = pieces_of(self.stretch_segments(whole), self.output, self.held, self.update)
        clock = np.array([self.offsets[piece.experiment] for piece in pieces])
        return Row(self.specs, pieces, self.pilot.row.stride), clock


def follow_rows(study: Study, offsets: Mapping[int, float], precision: float, say: Progress) -> list[FollowedRow]:
    """The outputs that can be followed, each with its pilot estimate and the information in all of its record."""
    usable = [k for k, s in enumerate(study.screened) if s.refusal is None and s.segments]
    interval = update_interval(study)
    timing = timing_error(study)
    update = samples_per_update(interval, study.segments[0].h)
    moves = {k: moves_of(study.screened[k].segments) for k in usable}
    say("a first estimate")
    pilots, (where, segments) = _pilots(study, moves, interval, timing)
    holds = find_holds(pilots, study.model, study.holds_to_find)
    study = study.with_segments(partial(with_holds, holds=holds))
    plant = updated_plant(study.model, pilots).nominal
    study = study.with_segments(partial(as_if_sampled_on_the_grid, plant=plant))
    stretch = (float(segments[0].t[0]) + offsets[where], float(segments[-1].t[-1]) + offsets[where])
    rows = []
    for i, pilot in pilots.items():
        own = {spec.column for spec in pilot.row.specs}
        model = study.model
        held = tuple(Held(j, model[i, j]) for j in range(model.shape[1]) if j not in own and not model[i, j].is_zero)
        pieces = {k: pieces_of(study.screened[k].segments, i, held, update) for k in usable}
        pieces = {k: found for k, found in pieces.items() if found}
        rows.append(FollowedRow(study, i, pilot, held, update, timing, precision, offsets, moves, pieces, stretch))
    return rows


def _pilots(
    study: Study, moves: Mapping[int, Array], interval: float, timing: float
) -> tuple[dict[int, OutputEstimate], tuple[int, list[Segment]]]:
    """Estimates of all outputs from the stretch with most moves; from a longer one while a gain is not identifiable."""
    stride = choose_stride(study.segments, list(study.specs.values()), interval)
    samples = sum(len(s) for s in study.segments)
    wanted = levels.PILOT * stride
    while True:
        stretch = most_moves(study, moves, wanted)
        found = identify_matrix(
            stretch[1],
            study.model,
            study.specs,
            confidence=study.project.analysis.confidence,
            update_interval=interval,
            timing=timing,
        )
        found = {i: without_hidden_dynamics(study.hidden, i, one) for i, one in found.items()}
        if wanted >= samples or (found and not any(_gain_unknown(e) for e in found.values())):
            return found, stretch
        wanted *= levels.PILOT_GROWTH


def _gain_unknown(estimate: OutputEstimate) -> bool:
    return bool(np.any(estimate.row.is_gain[list(unanswered(estimate))]))


def most_moves(study: Study, moves: Mapping[int, Array], samples: int) -> tuple[int, list[Segment]]:
    """The experiment, and its stretch of so many samples, in which most moves are made."""
    best, most = (0, list(study.segments[:1])), -1
    for k, moved in moves.items():
        segments = study.screened[k].segments
        h, first, last = segments[0].h, float(segments[0].t[0]), float(segments[-1].t[-1]) + segments[0].h
        length = samples * h
        for a in np.arange(first, max(last - length / 2, first + h), length):
            end = last if a + levels.LAST_STRETCH * length > last else a + length
            count = int(np.sum((moved >= a) & (moved < end)))
            if count > most:
                most, best = count, (k, part_of(segments, float(a), float(end)))
    return best
