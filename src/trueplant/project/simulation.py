"""A record of the declared loop: what `trueplant simulate` writes."""

from __future__ import annotations

import io
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import polars as pl
from numpy.typing import NDArray

from trueplant import loop
from trueplant.errors import LoopError, OutputError, ProjectError
from trueplant.lti import TransferMatrix
from trueplant.project.controllers import check_signs, law_gains
from trueplant.project.levels import DECIMALS, MOST_STEPS, STEPS_PER_TIME_CONSTANT, WHOLE_NUMBER
from trueplant.project.project import Project
from trueplant.project.simulated import Simulate, SimulatedLoad
from trueplant.threads import one_thread


@one_thread()
def simulate_record(project: Project) -> pl.DataFrame:
    """Columns: time, then set-points, OPs, PVs and measured disturbances under the project's own column names.

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
    plant, Gd = _plant(project, plan)
    laws = project.experiments[0].controllers if project.experiments else project.controllers
    check_signs(project, laws, plant, controller)
    every = steps_per_sample(project, plan, plant)
    h = plan.sample_time / every
    r, y0, u0 = _setpoints(project, plan, h)
    disturbances = project.disturbance_names
    done = loop.simulate(
        plant,
        controller,
        r,
        h,
        v=_loads(plan, project.output_names, project.time_unit),
        input_disturbance=_loads(plan, project.input_names, project.time_unit),
        d=_loads(plan, disturbances, project.time_unit) if disturbances else None,
        Gd=Gd,
        d_hold=[entry.hold or "linear" for entry in project.disturbances],
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
    for k, name in enumerate(disturbances):
        columns[project.disturbances[k].column] = plan.start.get(name, 0.0) + done.d[:, k]
    return pl.DataFrame({name: np.round(column, DECIMALS) for name, column in columns.items()})


def checked_format(path: str | Path) -> str:
    """The ending of ``path``. Raises OutputError if it is not one that a table can be written with."""
    ending = Path(path).suffix.lower()
    if ending not in (".csv", ".parquet"):
        raise OutputError(f"{path}: a table is written as .csv or .parquet, so the name must end in one of them")
    return ending


def as_file(frame: pl.DataFrame, path: str | Path) -> bytes:
    """What to write to ``path``, in the format that its ending asks for."""
    buffer = io.BytesIO()
    if checked_format(path) == ".csv":
        frame.write_csv(buffer)
    else:
        frame.write_parquet(buffer)
    return buffer.getvalue()


def _plant(project: Project, plan: Simulate) -> tuple[TransferMatrix, TransferMatrix | None]:
    """From the inputs (n_y, n_u), and from the measured disturbances (n_y, n_d), if there are any."""
    if plan.plant == "model":
        return project.model_matrix(), project.disturbance_matrix()
    sources = (*project.input_names, *project.disturbance_names)
    if isinstance(plan.plant, str):
        other = Project.load(project.folder / plan.plant)
        if (other.output_names, *other.input_names, *other.disturbance_names) != (project.output_names, *sources):
            raise ProjectError(
                f"{project.source}: simulate.plant: {plan.plant} has other outputs, inputs or disturbances than this "
                f"project: name them alike and in the same order"
            )
        return other.model_matrix(), other.disturbance_matrix()
    found = project.read_models(("simulate", "plant"), plan.plant)
    cells = {place: one.system for place, one in found.items()}
    rows = [[cells.get((y, u), 0.0) for u in sources] for y in project.output_names]
    n_u, whole = len(project.inputs), TransferMatrix.of(rows, project.time_unit)
    return whole.columns(0, n_u), whole.columns(n_u) if project.disturbances else None


def _loads(plan: Simulate, names: Sequence[str], unit: str) -> list[loop.Load]:
    """Those of the loads that act at these signals."""
    return [_load(entry, names, unit) for entry in plan.loads if set(entry.places) <= set(names)]


def _load(entry: SimulatedLoad, names: Sequence[str], unit: str) -> loop.Load:
    """The load at the signals `names`; 0 at those that it does not name."""
    if entry.tf is None:
        return _source(entry, np.array([names.index(name) for name in entry.places]), len(names))
    formulas = entry.tf if isinstance(entry.tf, list) else [entry.tf] * len(entry.places)
    own = dict(zip(entry.places, formulas, strict=True))
    model = TransferMatrix.of([[own.get(name, 0.0)] for name in names], unit)
    return loop.Filtered(model, _source(entry, np.zeros(1, dtype=int), 1))


def _source(entry: SimulatedLoad, places: NDArray[np.int64], n: int) -> loop.Load:
    """A load of n channels that acts in some of them."""
    sizes = np.zeros(n)
    sizes[places] = entry.std if entry.size is None else entry.size
    size = tuple(map(float, sizes))
    if entry.kind == "step":
        return loop.Step(entry.time, size)
    if entry.until is not None:
        return loop.Ramp(entry.time, entry.until, size)
    together = np.eye(n)
    together[np.ix_(places, places)] += entry.correlation * (1 - np.eye(len(places)))
    correlation = tuple(tuple(map(float, row)) for row in together)
    if entry.kind == "random walk":
        return loop.RandomWalk(size, correlation, entry.seed)
    c, a = tuple(entry.c) or (1.0,), tuple(entry.a) or (1.0,)
    return loop.Coloured(size, entry.time_constant, c, a, correlation, entry.seed)


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
        said = law_gains(law, project.time_unit)
        filters = [said.get("Tf"), said.get("Ti"), said.get("Td", 0.0) * said.get("alpha", loop.PID.alpha)]
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
