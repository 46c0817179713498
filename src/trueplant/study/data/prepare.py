"""From a project to what the analysis works on: records read and screened, the elements to estimate laid down."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime
from typing import Any

import numpy as np

from trueplant.calendar import unit_seconds
from trueplant.connect import ensure
from trueplant.errors import DataError, ProjectError, UnstableLoop
from trueplant.identify import INTEGRATING, SELF_REGULATING, Spec
from trueplant.lti import TransferFunction, TransferMatrix
from trueplant.lti.structure import Structure, structure_of, translated
from trueplant.project import ExperimentPlan, Project
from trueplant.project.controllers import check_signs
from trueplant.record import Record, Screened, read_record, screen
from trueplant.record.twice import counted_once
from trueplant.result import Code, Reason
from trueplant.study.data.beyond_limits import as_it_acted
from trueplant.study.data.declared import conversion_notes
from trueplant.study.data.scan import hidden_dynamics, written_between
from trueplant.study.data.setpoints import computed_setpoints
from trueplant.study.data.swapped import swapped_columns
from trueplant.study.study import Progress, Records, Study, quiet


def prepare(project: Project, say: Progress = quiet, frames: Sequence[Any] | None = None) -> Study:
    """Read and screen every record, and lay down what is to be estimated.

    `frames` (polars, pandas, dicts of arrays), one an experiment, stand in for the files.

    Raises ProjectError for a project that names no data or nothing to estimate, and what the readers raise.
    """
    if not project.experiments:
        raise ProjectError(f"{project.source}: names no data: set data.files or add [[experiment]]")
    records = Records.of(project, _screened(project, say, frames))
    model = _full_model(project)
    specs = {
        (i, j): _spec(project, model[i, j], i, j)
        for i in range(model.shape[0])
        for j in range(model.shape[1])
        if project.estimate(i, j)
    }
    if not specs:
        raise ProjectError(f"{project.source}: no [[model]] element is to be estimated: declare at least one")
    return Study(
        records,
        model,
        specs,
        computed=computed_setpoints(records.segments),
        computed_alone=tuple(computed_setpoints([segment]) for segment in records.segments),
        hidden=hidden_dynamics(records),
        between=written_between(records),
        notes=(*swapped_columns(records), *conversion_notes(project), *_check_loop(records, model)),
    )


def _screened(project: Project, say: Progress, frames: Sequence[Any] | None) -> tuple[Screened, ...]:
    layout, plans = project.layout(), project.experiments
    if frames is None:
        ensure(project, say)
    records, excluded = [], []
    for k, plan in enumerate(plans):
        say(f"reading {plan.name}{_counted(k, len(plans))}")
        source = plan.path if frames is None else frames[k]
        record = read_record(source, layout, name=plan.name, closed=plan.closed, say=say)
        records.append(record)
        own = [(_time(e.start, record, project), _time(e.end, record, project, True)) for e in plan.exclude]
        excluded.append([*own, *_outside(plan, record, project)])
    found = []
    for k, (plan, record) in enumerate(zip(plans, counted_once(records, excluded), strict=True)):
        limits = {name: lim for name, lim in zip(project.input_names, plan.limits, strict=True) if lim is not None}
        say(f"screening {plan.name}{_counted(k, len(plans))}")
        screened = screen(record, layout, experiment=k, exclude=excluded[k], limits=limits)
        found.append(as_it_acted(screened, [limits.get(name) for name in project.input_names]))
    return tuple(found)


def _counted(k: int, count: int) -> str:
    return f", record {k + 1} of {count}" if count > 1 else ""


def _check_loop(records: Records, model: TransferMatrix) -> tuple[Reason, ...]:
    """A controller whose action fights the model's gain is a mistake in the project, and raises SignConflict.

    A loop that only the model says is unstable is remarkable, but the plant may well have drifted that far.
    """
    notes = []
    project = records.project
    plant = model.columns(0, len(project.inputs))
    whole = not any(project.wanted(*place) for place in np.ndindex(*plant.shape))
    for plan, law in zip(project.experiments, records.linear, strict=True):
        if law is None or not plan.closed or not whole:
            continue
        try:
            check_signs(project, plan.controllers, plant, law)
        except UnstableLoop as error:
            notes.append(Reason(Code.UNSTABLE_MODEL, str(error), plan.name))
    return tuple(notes)


def _full_model(project: Project) -> TransferMatrix:
    model, disturbances = project.model_matrix(), project.disturbance_matrix()
    if disturbances is None:
        return model
    rows = zip(model.elements, disturbances.elements, strict=True)
    return TransferMatrix(tuple((*a, *b) for a, b in rows), model.time_unit)


def _outside(plan: ExperimentPlan, record: Record, project: Project) -> list[tuple[float, float]]:
    """What of the record lies before and after the part that an experiment is."""
    found, ends = [], (float(record.t[0]), float(record.t[-1]))
    if plan.start is not None and (start := _time(plan.start, record, project)) > ends[0]:
        found.append((ends[0], float(np.nextafter(start, -np.inf))))
    if plan.end is not None and (end := _time(plan.end, record, project, True)) <= ends[1]:
        found.append((end, ends[1]))
    if any(one[0] <= ends[0] and one[1] >= ends[1] for one in found):
        spoken = " to ".join(record.calendar.text(moment) for moment in ends)
        raise ProjectError(
            f"{project.source}: experiment {plan.name}: its from and to leave nothing of the record, which lasts from "
            f"{spoken}"
        )
    return found


def _time(moment: float | datetime, record: Record, project: Project, late: bool = False) -> float:
    """A point of time of an excluded stretch in the record's own time; `late` as in `Calendar.time`."""
    if not isinstance(moment, datetime):
        own = unit_seconds(project.data.time_unit or project.time_unit)
        return moment * own / unit_seconds(project.time_unit)
    try:
        return record.calendar.time(moment, late)
    except DataError as error:
        raise ProjectError(f"{project.source}: data.exclude of {record.name}: {error}") from None


def _spec(project: Project, system: TransferFunction, i: int, j: int) -> Spec:
    """What the plant's element may be, and where its parameters start: the model's own as far as they go."""
    declared = project.structure(i, j)
    own, values = (None, np.zeros(0)) if system.is_zero else structure_of(system)
    structure = own if declared is None else Structure.parse(declared)
    if structure is None:
        structure = INTEGRATING if project.kind(i) == "level" else SELF_REGULATING
    if own is None:
        return Spec(j, structure, None)
    undeclared = tuple(k for k, name in enumerate(structure.names) if name not in own.names)
    return Spec(j, structure, translated(own, values, structure), undeclared)
