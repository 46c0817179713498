"""The identification of a study: the estimate of each output, and what else it found out on the way."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product

import numpy as np
from scipy.stats import norm

from trueplant.disturbance import DisturbedFit
from trueplant.identify import (
    FoundHold,
    FoundValve,
    Identification,
    Open,
    OutputEstimate,
    RowFit,
    Spec,
    Unanswered,
    WhyUnanswered,
    behind_valves,
    counting_halves,
    found_loads,
    identify_plant,
    over_open_holds,
    over_open_valves,
    sticking,
    try_valves,
    widened_for_bands,
    with_open_valves,
)
from trueplant.record import Segment
from trueplant.record.numbers import counted
from trueplant.result import Code, Reason
from trueplant.study.data.reached import unreached_elements
from trueplant.study.data.scan import without_hidden_dynamics
from trueplant.study.data.timing import timing_error, update_interval
from trueplant.study.plant.disturbance import declared_parts, disturbed_fits, resting_on, with_jumps
from trueplant.study.plant.drawn import drawn_outputs, held_between, widened_for_drawn
from trueplant.study.plant.meanwhile import Run, moved_instead
from trueplant.study.plant.on_grid import on_the_grid
from trueplant.study.plant.updated import updated_plant
from trueplant.study.study import Place, Progress, Study, quiet


@dataclass(frozen=True, eq=False)
class Identified:
    """What identification found. Everything after it starts from this and from the study."""

    estimates: Mapping[int, OutputEstimate]
    """By output; none for an output without elements to estimate or usable data."""
    specs: Mapping[Place, Spec]
    """The elements asked for, and those that the model lacks and the record shows."""
    segments: tuple[Segment, ...]
    """Those of the study without spikes of PV, with the loads that were found, or the samples at which a declared
    disturbance jumps."""
    disturbed: Mapping[int, DisturbedFit]
    """The outputs with a declared unmeasured disturbance, estimated along with it."""
    notes: tuple[Reason, ...] = ()
    valves: Mapping[int, FoundValve] = field(default_factory=dict)
    """By input: valves that do not follow OP; the segments then have the positions of their stems for it."""
    holds: Mapping[int, FoundHold] = field(default_factory=dict)
    """By column: measured disturbances of which the project does not say how they run between samples."""
    absence_p: Mapping[Place, float] = field(default_factory=dict)
    """Of the elements of which the project does not say whether they are there: that they are not."""
    unreached: frozenset[Place] = frozenset()
    """Elements that nothing moves from outside: of them these data cannot tell."""
    moved: frozenset[Run] = frozenset()
    """Where a plant that moved is likelier than loads would be."""

    def of_experiment(self, k: int) -> tuple[Segment, ...]:
        """The segments of one experiment."""
        return tuple(segment for segment in self.segments if segment.experiment == k)


def identify(study: Study, say: Progress = quiet) -> Identified:
    """Estimate all elements of all outputs, with the unmeasured disturbances that the project declares."""
    undeclared = study.holds_to_find
    study = on_the_grid(study, lambda one: _identified(one, one.segments, (), say, plain=True).estimates)
    found, moved = _with_loads_or_without(study, undeclared, say)
    estimates, holds, segments = found.estimates, found.holds, found.segments
    say("looking for valves that do not follow OP")
    columns = [j for j, one in enumerate(study.project.inputs) if one.actuator == "valve"]
    tried = try_valves(estimates, columns)
    valves: dict[int, FoundValve] = {}
    # one after the other: a valve that does not follow OP may hide another, or be taken for it
    while more := sticking(tried):
        behind = behind_valves(segments, more)
        if not behind:  # in no stretch is it known where the stem stands: its bands stay open
            break
        valves = {**valves, **more}
        found = _identified(study, behind, (), say, loads=not moved)
        estimates, segments = found.estimates, found.segments
        tried = try_valves(estimates, [j for j in columns if j not in valves])
    fits: dict[int, DisturbedFit] = {}
    if estimates and study.project.unmeasured:
        say("estimating unmeasured disturbances")
        fits = disturbed_fits(study, estimates)
        segments = with_jumps(study, fits, updated_plant(study.model, estimates).nominal, segments)
        if any(segment.jumps for segment in segments):
            found = _identified(study, segments, (), say, loads=not moved)
            estimates, segments = found.estimates, found.segments
        estimates = _resting_on_disturbances(study, estimates, fits)
    confidence = study.project.analysis.confidence
    estimates = over_open_valves(over_open_holds(estimates, holds, confidence), tried, confidence)
    estimates = with_open_valves(widened_for_bands(estimates, valves, confidence), tried, valves)
    if drawn := drawn_outputs(study):
        say("estimating what a historian left out")
        held = _identified(study, held_between(segments, drawn), (), loads=not moved)
        estimates = widened_for_drawn(estimates, held.estimates, drawn, confidence)
    unreached = unreached_elements(study)
    estimates = {i: counting_halves(one, confidence) for i, one in _without(unreached, estimates).items()}
    taken = {(i, spec.column): spec for i, one in estimates.items() for spec in one.row.specs}
    asked = {place: spec for place, spec in study.specs.items() if place not in found.absence_p}
    notes = (
        *_missing(study, taken),
        *_doubtful(study, found.doubtful),
        *_loads(study, estimates),
        *_spikes(study, segments),
    )
    return Identified(
        estimates, {**asked, **taken}, segments, fits, notes, valves, holds, found.absence_p, unreached, moved
    )


def _with_loads_or_without(
    study: Study, undeclared: Sequence[int], say: Progress
) -> tuple[Identification, frozenset[Run]]:
    """What identification finds; without loads where plants that moved are likelier, and which they are."""
    found = _identified(study, study.segments, undeclared, say)
    if not found_loads(_fits(found.estimates)):
        return found, frozenset()
    without = _identified(study, study.segments, undeclared, say, loads=False)
    moved = moved_instead(_fits(found.estimates), _fits(without.estimates))
    return without if moved else found, moved


def _identified(
    study: Study,
    segments: tuple[Segment, ...],
    undeclared: Sequence[int],
    say: Progress = quiet,
    *,
    plain: bool = False,
    loads: bool = True,
) -> Identification:
    """All that identification finds; the measured disturbances in the `undeclared` columns may run either way.

    `plain`: by the structures asked for. `loads`: beside those that nobody recorded, but not where it is plain.
    """
    found = identify_plant(
        segments,
        study.model,
        study.specs,
        Open(
            undeclared,
            [place for place in study.specs if plain or study.project.structure(*place) is not None],
            loads=loads and not plain and not study.project.unmeasured,
            wanted=study.wanted,
            passed_on=study.passed_on,
            drawn=drawn_outputs(study),
            certain=study.spikes_kept,
        ),
        study.project.analysis.confidence,
        (update_interval(study), timing_error(study)),
        tell=lambda i, doing: say(f"{doing} {_counted(study.project.output_names, i)}"),
    )
    estimates = {i: without_hidden_dynamics(study.hidden, i, one) for i, one in found.estimates.items()}
    return replace(found, estimates=estimates)


def _without(unreached: frozenset[Place], found: Mapping[int, OutputEstimate]) -> dict[int, OutputEstimate]:
    """The estimates, with nothing given of the elements that nothing moves from outside."""
    estimates = dict(found)
    for i, one in found.items():
        hidden = [
            range(part.start, part.stop)
            for spec, part in zip(one.row.specs, one.row.slices, strict=True)
            if (i, spec.column) in unreached
        ]
        more = {k: Unanswered.because(WhyUnanswered.NOTHING_FROM_OUTSIDE) for part in hidden for k in part}
        estimates[i] = replace(one, withheld={**one.withheld, **more})
    return estimates


def _counted(names: Sequence[str], i: int) -> str:
    return names[i] if len(names) == 1 else f"{names[i]}, output {i + 1} of {len(names)}"


def _resting_on_disturbances(
    study: Study, estimates: Mapping[int, OutputEstimate], fits: Mapping[int, DisturbedFit]
) -> dict[int, OutputEstimate]:
    confidence, parts = study.project.analysis.confidence, declared_parts(study)
    stationary = {i: all(part.kind == "ar1" for part in parts.get(i, ())) for i in estimates}
    return {i: resting_on(found, fits.get(i), confidence, stationary[i]) for i, found in estimates.items()}


def _missing(study: Study, taken: Mapping[Place, Spec]) -> tuple[Reason, ...]:
    """What is said of the elements that the model lacks and the estimate had to take in."""
    return tuple(
        Reason(
            Code.MISSING_ELEMENT,
            f"{study.columns[j]} moves {study.project.output_names[i]}, which the model does not have: an element was "
            "found in the record and estimated along",
            f"{study.columns[j]} -> {study.project.output_names[i]}",
        )
        for i, j in sorted(taken.keys() - study.specs.keys())
    )


def _doubtful(study: Study, places: Sequence[Place]) -> Iterator[Reason]:
    """What is said of the elements that the model lacks, and that a disturbance as slow could be just as well."""
    for i, j in places:
        output, name = study.project.output_names[i], study.columns[j]
        yield Reason(
            Code.UNDERMODELLED,
            f"{name} seems to move {output}, which the model does not have, but a disturbance as slow could look the "
            "same: the other elements of this output are given no surer than they would be beside it. To have it "
            'estimated, declare it with tf = "0" and a structure',
            f"{name} -> {output}",
        )


def _loads(study: Study, estimates: Mapping[int, OutputEstimate]) -> tuple[Reason, ...]:
    """What is said of steps that nobody recorded: a note for each experiment.

    Nothing of those that the structures taken since explain as well: they stay in the estimate, where they do no harm.
    """
    told: dict[int, list[str]] = {}
    quantile = norm.isf((1 - study.project.analysis.confidence) / 2)
    for found in found_loads(_fits(estimates)):
        if abs(found.size) < quantile * found.error:
            continue
        column = found.load.column
        size = f"{found.size:.3g} ± {quantile * found.error:.2g} {study.input_unit(column)}".rstrip()
        when = study.screened[found.experiment].record.calendar.text(found.load.time)
        step = f"at {when} like {study.columns[column]} by {size}"
        told.setdefault(found.experiment, []).append(step)
    return tuple(
        Reason(
            Code.LOAD,
            f"something that was not recorded stepped as an input would have, {'; '.join(steps)}: taken along in the "
            "estimate",
            study.project.experiments[k].name,
        )
        for k, steps in told.items()
    )


def _spikes(study: Study, segments: Sequence[Segment]) -> Iterator[Reason]:
    """What is said of PVs that were off for a moment: a note for each in each experiment."""
    for (i, output), k in product(enumerate(study.project.outputs), range(len(study.screened))):
        own = [segment for segment in segments if segment.experiment == k]
        times = np.concatenate([np.zeros(0), *(segment.t[segment.taken_off[:, i] != 0] for segment in own)])
        if not times.size:
            continue
        first = study.screened[k].record.calendar.text(float(times[0]))
        yield Reason(
            Code.SPIKES,
            f"{output.name} was off for a moment in {counted(times.size, 'sample')}, {'first ' * (times.size > 1)}at "
            f"{first}, and back at once, as no disturbance would be: taken for faults of its measurement, and "
            f'estimated without them. If they are real, say keep = ["spike"] for {output.name}',
            f"{output.name}, {study.project.experiments[k].name}",
        )


def _fits(estimates: Mapping[int, OutputEstimate]) -> dict[int, RowFit]:
    return {i: estimate.fit for i, estimate in estimates.items()}
