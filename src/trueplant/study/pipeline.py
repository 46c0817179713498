"""One analysis as one straight line: records, screening, estimates, verdicts, what it means, the result."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from trueplant.errors import ProjectError
from trueplant.identify import OutputEstimate, Spec, identify_matrix
from trueplant.identify.search import lag_of
from trueplant.lti import TransferFunction, TransferMatrix
from trueplant.lti.structure import Structure, structure_of
from trueplant.record import Record, Screened, Segment, read_record, screen
from trueplant.record.times import unit_seconds
from trueplant.study.believed import plant_matrix
from trueplant.study.computed import computed_setpoints
from trueplant.study.instants import timing_error, update_interval
from trueplant.study.result import Reason, Result
from trueplant.study.scans import hidden_dynamics, without_hidden_dynamics, written_between

if TYPE_CHECKING:
    from trueplant.disturbance import DisturbedFit
    from trueplant.study.project import Project

Array = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
Progress = Callable[[str], None]


def _quiet(_: str) -> None:
    return None


@dataclass(frozen=True, eq=False)
class Study:
    """What the analysis works on: the project, its records after screening, and what is asked of them."""

    project: Project
    screened: tuple[Screened, ...]
    model: TransferMatrix
    """(n_y, n_u + n_d): the inputs, then the measured disturbances."""
    specs: dict[tuple[int, int], Spec]
    """The elements to estimate."""
    notes: tuple[Reason, ...] = ()
    disturbed: Mapping[int, DisturbedFit] = field(default_factory=dict)
    """The outputs with a declared unmeasured disturbance, estimated along with it."""
    hidden: Mapping[int, str] = field(default_factory=dict)
    """The outputs of which the record cannot tell dynamics, and why (`scans`)."""
    between: bool = False
    """Is OP written between the recorded samples (`scans`)?"""

    @property
    def segments(self) -> tuple[Segment, ...]:
        return tuple(segment for s in self.screened if s.refusal is None for segment in s.segments)

    @cached_property
    def computed(self) -> BoolArray:
        """(n_y,) True for a set-point that the whole of the data shows to be computed from PV."""
        return computed_setpoints(self.segments)

    @cached_property
    def computed_alone(self) -> tuple[BoolArray, ...]:
        """The same by each segment alone."""
        return tuple(computed_setpoints([segment]) for segment in self.segments)

    @property
    def loop_experiment(self) -> int | None:
        """The experiment whose controller stands for today's loop: the last usable closed one that declares it."""
        usable = [
            k
            for k, (plan, s) in enumerate(zip(self.project.experiments, self.screened, strict=True))
            if plan.closed and s.refusal is None and self.project.controller(k) is not None
        ]
        return usable[-1] if usable else None

    @property
    def columns(self) -> tuple[str, ...]:
        return (*self.project.input_names, *self.project.disturbance_names)


def analyse(project: Project, progress: Progress | None = None) -> Result:
    """The main job: from a project to its result. Refusals are results; unusable input raises.

    `progress` is told what is being done, in a few words, as each step begins.
    """
    from trueplant.study.assemble import assemble, refused
    from trueplant.study.informative import why_not_informative
    from trueplant.study.methods import compare_methods
    from trueplant.study.replayed import check_controllers

    say = progress or _quiet
    say("reading the data")
    study = prepare(project, say)
    say("checking the declared controllers")
    consistency = check_controllers(study)
    reasons = [
        Reason("record", s.refusal, project.experiments[k].name) for k, s in enumerate(study.screened) if s.refusal
    ]
    reasons += why_not_informative(study)
    if not study.segments or any(reason.code == "no-excitation" for reason in reasons):
        return refused(study, reasons, consistency)
    estimates = estimate(study, say)
    if not estimates:
        reasons.append(Reason("nothing-to-estimate", "no output has both an element to estimate and usable data"))
        return refused(study, reasons, consistency)
    if project.unmeasured:
        study, estimates = _with_disturbances(study, estimates, say)
    study = _with_elements_of(study, estimates)
    say("comparing methods")
    others = compare_methods(study, estimates)
    say("putting the result together")
    return assemble(study, estimates, others, consistency, reasons)


def prepare(project: Project, say: Progress = _quiet) -> Study:
    """Read and screen every record, and lay down what is to be estimated."""
    if not project.experiments:
        raise ProjectError(f"{project.source}: names no data: set data.files or add [[experiment]]")
    layout = project.layout()
    screened = []
    for k, plan in enumerate(project.experiments):
        record = read_record(plan.path, layout, name=plan.name, closed=plan.closed)
        limits = {name: lim for name, lim in zip(project.input_names, plan.limits, strict=True) if lim is not None}
        spans = [(_moment(e.start, record, project), _moment(e.end, record, project)) for e in plan.exclude]
        say(f"screening {plan.name}")
        screened.append(screen(record, layout, experiment=k, exclude=spans, limits=limits))
    model = _full_model(project)
    specs = {
        (i, j): _spec(project, model[i, j], i, j)
        for i in range(model.shape[0])
        for j in range(model.shape[1])
        if project.estimate(i, j)
    }
    if not specs:
        raise ProjectError(f"{project.source}: no [[model]] element is to be estimated: declare at least one")
    notes = _check_loop(project, model, screened)
    study = Study(project, tuple(screened), model, specs, notes)
    return replace(study, hidden=hidden_dynamics(study), between=written_between(study))


def _check_loop(project: Project, model: TransferMatrix, screened: Sequence[Screened]) -> tuple[Reason, ...]:
    """A controller whose action fights the model's gain is a mistake in the project, and raises SignConflict.

    A loop that only the model says is unstable is remarkable, but the plant may well have drifted that far.
    """
    from trueplant.errors import UnstableLoop
    from trueplant.study.project_loop import check_signs

    notes = []
    plant = TransferMatrix(tuple(row[: len(project.inputs)] for row in model.elements), model.time_unit)
    for k, plan in enumerate(project.experiments):
        controller = project.controller(k) if plan.closed else None
        if controller is None:
            continue
        try:
            linear = controller.linearised(np.nanmean(screened[k].record.y, axis=0))
            check_signs(project, plan.controllers, plant, linear)
        except UnstableLoop as error:
            notes.append(Reason("unstable-model", str(error), plan.name))
    return tuple(notes[:1])


def _full_model(project: Project) -> TransferMatrix:
    model, disturbances = project.model_matrix(), project.disturbance_matrix()
    if disturbances is None:
        return model
    rows = zip(model.elements, disturbances.elements, strict=True)
    return TransferMatrix(tuple((*a, *b) for a, b in rows), model.time_unit)


def _moment(moment: float | datetime, record: Record, project: Project) -> float:
    """A point of time of an excluded stretch in the record's own time."""
    unit = unit_seconds(project.time_unit)
    if not isinstance(moment, datetime):
        return moment * unit_seconds(project.data.time_unit or project.time_unit) / unit
    if record.start is None:
        raise ProjectError(
            f"{project.source}: data.exclude names a timestamp, but {record.name} has numbers for its time"
        )
    start = record.start
    if start.tzinfo is None or moment.tzinfo is None:
        start, moment = start.replace(tzinfo=None), moment.replace(tzinfo=None)
    return (moment - start).total_seconds() / unit


def _spec(project: Project, system: TransferFunction, i: int, j: int) -> Spec:
    """What the plant's element may be, and where its parameters start: the model's own as far as they go."""
    declared = project.structure(i, j)
    own, values = (None, np.zeros(0)) if system.is_zero else structure_of(system)
    structure = own if declared is None else Structure.parse(declared)
    assert structure is not None  # the project has checked that a zero element names a structure
    if own is None:
        return Spec(j, structure, None)
    return Spec(j, structure, translated(own, values, structure))


def translated(own: Structure, values: Array, wanted: Structure) -> tuple[float, ...]:
    """Parameters of one structure as a start for another: shared names keep their values, new lags are short."""
    known = dict(zip(own.names, values, strict=True))
    first = {"gain": known.get("gain", known.get("gain1", known.get("slope", 1.0)))}
    lag = lag_of(own.names, values) or known.get("dead_time", 1.0) or 1.0
    start = []
    for name in wanted.names:
        if name in known:
            start.append(float(known[name]))
        elif name.startswith(("gain", "slope")):
            start.append(float(first["gain"]) if name in ("gain", "gain1", "slope") else 0.0)
        elif name.startswith("tau"):
            start.append(lag / (1 if own.lags == 0 and name == "tau1" else 10 * int(name[3:])))
        elif name.startswith("lead"):
            start.append(lag / 10)
        elif name.startswith("omega0"):
            start.append(1 / lag)
        elif name.startswith("zeta"):
            start.append(0.7)
        else:
            start.append(float(known.get("dead_time", known.get("dead_time1", 0.0))))
    return tuple(start)


def estimate(study: Study, say: Progress = _quiet) -> dict[int, OutputEstimate]:
    """The estimate of each output that has elements to estimate and data to do it from."""
    from trueplant.study.informative import unmoved_outputs

    found = identify_matrix(
        study.segments,
        study.model,
        study.specs,
        confidence=study.project.analysis.confidence,
        update_interval=update_interval(study),
        timing=timing_error(study),
        tell=lambda i: say(f"estimating {study.project.output_names[i]}"),
    )
    unmoved = unmoved_outputs(study)
    return {i: without_hidden_dynamics(study, i, one) for i, one in found.items() if i not in unmoved}


def _with_elements_of(study: Study, estimates: Mapping[int, OutputEstimate]) -> Study:
    """The study with the elements that the model lacks and the estimate had to take in."""
    taken = {(i, spec.column): spec for i, found in estimates.items() for spec in found.row.specs}
    notes = [
        Reason(
            "missing-element",
            f"{study.columns[j]} moves {study.project.output_names[i]}, which the model does not have: an element of "
            "first order with dead time was found in the record and estimated along",
            f"{study.columns[j]} -> {study.project.output_names[i]}",
        )
        for i, j in sorted(taken.keys() - study.specs.keys())
    ]
    return replace(study, specs=study.specs | taken, notes=(*study.notes, *notes))


def _with_disturbances(
    study: Study, estimates: dict[int, OutputEstimate], say: Progress
) -> tuple[Study, dict[int, OutputEstimate]]:
    """Study and estimates that know the declared unmeasured disturbances."""
    from trueplant.study.disturbed import disturbed_fits, resting_on, with_jumps

    say("estimating unmeasured disturbances")
    fits = disturbed_fits(study, estimates)
    plant = plant_matrix(study, estimates)
    told = with_jumps(replace(study, disturbed=fits), plant)
    if any(segment.jumps for segment in told.segments):
        estimates = estimate(told, say)
    timing = timing_error(study)
    confidence = study.project.analysis.confidence
    resting = {i: resting_on(found, fits.get(i), timing, confidence) for i, found in estimates.items()}
    return told, {i: without_hidden_dynamics(told, i, found) for i, found in resting.items()}
