"""A record of the declared loop: what `trueplant simulate` writes."""

from __future__ import annotations

import io
import math
from pathlib import Path

import numpy as np
import polars as pl
from numpy.typing import NDArray

from trueplant import loop
from trueplant.errors import LoopError, OutputError, ProjectError
from trueplant.lti import TransferMatrix
from trueplant.project.controllers import check_signs
from trueplant.project.levels import DECIMALS, MOST_STEPS, STEPS_PER_TIME_CONSTANT, WHOLE_NUMBER
from trueplant.project.project import Project
from trueplant.project.tables import Simulate


def simulate_record(project: Project) -> pl.DataFrame:
    """Columns: time, then set-points, OPs and PVs under the project's own column names.

    Raises ProjectError without a [simulate] table or a controller, or with a pv_transform, LoopError for a loop that is
    unstable or cannot run.
    """
    plan = project.simulate
    if plan is None:
        raise ProjectError(f"{project.source}: has no [simulate] table: add one with duration and sample_time")
    controller = project.controller()
    if controller is None:
        raise ProjectError(f"{project.source}: has no [[controller]]: simulate runs the closed loop, so declare one")
    curved = [law.input for law in project.controllers if law.pv_transform is not None]
    if curved:
        raise ProjectError(
            f"{project.source}: the controller of {curved[0]} has a pv_transform, and such a controller can be checked "
            "against a record but not simulated: leave pv_transform out to simulate the loop about one PV"
        )
    plant = _plant(project, plan)
    laws = project.experiments[0].controllers if project.experiments else project.controllers
    check_signs(project, laws, plant, controller)
    every = steps_per_sample(project, plan, plant)
    h = plan.sample_time / every
    r, y0, u0 = _setpoints(project, plan, h)
    done = loop.simulate(
        plant,
        controller,
        r,
        h,
        noise=_per_output(project, plan.noise),
        quantisation=_per_output(project, plan.quantisation),
        u0=u0,
        y0=y0,
        record_every=every,
        seed=plan.seed,
    )
    columns = {project.data.time or "t": np.arange(len(done.t)) * plan.sample_time}
    for i, output in enumerate(project.outputs):
        columns[output.sp or f"{output.name}.sp"] = done.r[:, i]
    for j, entry in enumerate(project.inputs):
        columns[entry.op] = done.u[:, j]
    for i, output in enumerate(project.outputs):
        columns[output.pv] = done.y[:, i]
    return pl.DataFrame({name: np.round(column, DECIMALS) for name, column in columns.items()})


def checked_format(path: str | Path) -> str:
    """The ending of ``path``. Raises OutputError if it is not one that a record can be written with."""
    ending = Path(path).suffix.lower()
    if ending not in (".csv", ".parquet"):
        raise OutputError(f"{path}: a record is written as .csv or .parquet, so the name must end in one of them")
    return ending


def as_file(frame: pl.DataFrame, path: str | Path) -> bytes:
    """What to write to ``path``, in the format that its ending asks for."""
    buffer = io.BytesIO()
    if checked_format(path) == ".csv":
        frame.write_csv(buffer)
    else:
        frame.write_parquet(buffer)
    return buffer.getvalue()


def _plant(project: Project, plan: Simulate) -> TransferMatrix:
    if plan.plant == "model":
        return project.model_matrix()
    if isinstance(plan.plant, str):
        other = Project.load(project.folder / plan.plant)
        if (other.output_names, other.input_names) != (project.output_names, project.input_names):
            raise ProjectError(
                f"{project.source}: simulate.plant: {plan.plant} has other outputs or inputs than this project: "
                f"name them alike and in the same order"
            )
        return other.model_matrix()
    cells = {(e.output, e.input): e.tf for e in plan.plant}
    rows = [[cells.get((y, u), 0.0) for u in project.input_names] for y in project.output_names]
    return TransferMatrix.of(rows, project.time_unit)


def steps_per_sample(project: Project, plan: Simulate, plant: TransferMatrix) -> int:
    """Fine enough for continuous controllers, and such that every scan is a whole number of steps."""
    scans = [law.sample_time for law in project.controllers if law.sample_time is not None]
    wanted = 1
    if len(scans) < len(project.controllers):
        wanted = math.ceil(plan.sample_time / _shortest_time(project, plan, plant) * STEPS_PER_TIME_CONSTANT)
    for every in range(max(wanted, 1), MOST_STEPS + 1):
        h = plan.sample_time / every
        if all(scan >= h * (1 - 1e-9) and abs(scan / h - round(scan / h)) < WHOLE_NUMBER for scan in scans):
            return every
    raise LoopError(
        f"sample_time {plan.sample_time:g} in [simulate] does not go with the loop: choose one that is a multiple or a "
        f"simple fraction of each controller's sample_time, and not far above the shortest time constant"
    )


def _shortest_time(project: Project, plan: Simulate, plant: TransferMatrix) -> float:
    """The shortest time constant of plant and controllers; the sample time if there is none."""
    poles = np.concatenate([plant[i, j].poles for i in range(plant.shape[0]) for j in range(plant.shape[1])])
    times = [1 / abs(p) for p in poles if abs(p) > 0]
    for law in project.controllers:
        filters = [law.Tf, law.Ti, (law.Td or 0.0) * (loop.PID.alpha if law.alpha is None else law.alpha)]
        times += [time for time in filters if time]
    return min(times, default=plan.sample_time)


def _setpoints(
    project: Project, plan: Simulate, h: float
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    y0 = np.array([plan.start.get(name, 0.0) for name in project.output_names])
    u0 = np.array([plan.start.get(name, 0.0) for name in project.input_names])
    steps = round(plan.duration / h) + 1
    r = np.tile(y0, (steps, 1))
    for move in sorted(plan.setpoints, key=lambda move: move.time):
        r[math.ceil(move.time / h - 1e-9) :, project.output_names.index(move.output)] = move.value
    return r, y0, u0


def _per_output(project: Project, value: float | dict[str, float]) -> NDArray[np.float64]:
    if isinstance(value, dict):
        return np.array([value.get(name, 0.0) for name in project.output_names])
    return np.full(len(project.outputs), value)
