"""The commands of trueplant for a notebook: a project, or frames with their loops, in; typed results out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

from trueplant.errors import UsageError
from trueplant.notebook.analysis import Analysis
from trueplant.notebook.loops import Loop, Model, project_of
from trueplant.project import Project
from trueplant.result import Check, Track
from trueplant.study.study import Progress, quiet

if TYPE_CHECKING:
    import polars as pl

Frames = Sequence[Any] | None


def run(
    data: Any,
    *,
    loops: Sequence[Loop] = (),
    model: Model | None = None,
    time: str | None = None,
    time_unit: str = "min",
    progress: Progress = quiet,
    **tables: Any,
) -> Analysis:
    """Find what changed in the plant.

    data: the path of a project file, a `Project`, or a frame (polars, pandas, a dict of arrays; a list of them for
    several experiments). With a frame, `loops` name its columns, `model` the model by (output, input), `time` the
    column of the time (found by itself where it has a usual name), `time_unit` its unit where it is a number, and the
    unit of the results. `tables` are further tables of a project file, such as ``tuning={}``.

    Raises a `UsageError` for a project or data that cannot be used and a `SourceError` for data that cannot be fetched.
    Data that cannot answer are no error: the analysis then has the status "refused".
    """
    from trueplant.study.pipeline import analyse

    project, frames = _project(data, loops, model, time, time_unit, tables)
    return Analysis(analyse(project, progress, frames), project)


def check(
    data: Any,
    *,
    loops: Sequence[Loop] = (),
    model: Model | None = None,
    time: str | None = None,
    time_unit: str = "min",
    **tables: Any,
) -> Check:
    """Read and screen the data only: what can be used and why not, and whether it moves enough. As `run`."""
    from trueplant.study.check import check as checked

    project, frames = _project(data, loops, model, time, time_unit, tables)
    return checked(project, frames=frames)


def track(
    data: Any,
    *,
    precision: float = 0.1,
    loops: Sequence[Loop] = (),
    model: Model | None = None,
    time: str | None = None,
    time_unit: str = "min",
    progress: Progress = quiet,
    **tables: Any,
) -> Track:
    """Parameters over a long record, and since when they changed. `precision`: the relative standard error for which
    each window is made long enough; the rest as in `run`."""
    from trueplant.tracking.track import track as tracked

    project, frames = _project(data, loops, model, time, time_unit, tables)
    return tracked(project, precision, progress, frames)


def simulate(project: Project | str | PathLike[str]) -> pl.DataFrame:
    """A record of the declared loop, as the table [simulate] of the project asks for.

    Raises ProjectError without one, or without a controller.
    """
    from trueplant.project.simulation import simulate_record

    return simulate_record(project if isinstance(project, Project) else Project.load(project))


def _project(
    data: Any,
    loops: Sequence[Loop],
    model: Model | None,
    time: str | None,
    time_unit: str,
    tables: Mapping[str, Any],
) -> tuple[Project, Frames]:
    """The project, and the frames to read in place of its files."""
    is_project = isinstance(data, (Project, str, Path, PathLike))
    if is_project and (loops or model is not None or tables):
        raise UsageError("loops, model and tables go with a frame: a project says them itself")
    if isinstance(data, Project):
        return data, None
    if is_project:
        return Project.load(data), None
    frames = list(data) if isinstance(data, (list, tuple)) else [data]
    if not frames:
        raise UsageError("the list of frames is empty: give one frame for each experiment")
    names = ["frame"] if len(frames) == 1 else [f"frame {k + 1}" for k in range(len(frames))]
    return project_of(names, loops, model, time, time_unit, tables), frames
