"""The Wood-Berry column as a project of two loops: its record in a file, and what a result says has changed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from support.simulated import WOOD_BERRY
from trueplant import Project, Result
from trueplant.loop import Simulation
from trueplant.lti import TransferMatrix, to_formula

CONTROLLERS = [
    {"input": "reflux", "output": "top", "Kc": 0.375, "Ti": 8.29, "sample_time": 1.0},
    {"input": "steam", "output": "bottom", "Kc": -0.0754, "Ti": 23.6, "sample_time": 1.0},
]


def written(folder: Path, name: str, simulation: Simulation, **more: np.ndarray) -> str:
    columns = {"t": simulation.t, "sp1": simulation.r[:, 0], "sp2": simulation.r[:, 1]}
    columns |= {"op1": simulation.u[:, 0], "op2": simulation.u[:, 1]}
    columns |= {"pv1": simulation.y[:, 0], "pv2": simulation.y[:, 1], **more}
    pl.DataFrame(columns).write_csv(folder / name)
    return name


def project(folder: Path, model: TransferMatrix = WOOD_BERRY, **tables: Any) -> Project:
    elements = [
        {"output": y, "input": u, "tf": to_formula(model[i, j], digits=12)}
        for i, y in enumerate(["top", "bottom"])
        for j, u in enumerate(["reflux", "steam"])
    ]
    tables.setdefault("data", {"files": ["record.csv"], "time": "t"})
    if "experiment" in tables:
        tables["data"] = {"time": "t"}
    made = Project(
        time_unit="min",
        output=[{"name": "top", "pv": "pv1", "sp": "sp1"}, {"name": "bottom", "pv": "pv2", "sp": "sp2"}],
        input=[{"name": "reflux", "op": "op1"}, {"name": "steam", "op": "op2"}],
        model=elements + tables.pop("more_elements", []),
        **tables,
    )
    return Project.from_toml(made.to_toml(), folder)


def changed(result: Result) -> set[tuple[str, str]]:
    return {(e.input, e.output) for e in result.elements if e.verdict == "changed"}


def scaled(i: int, j: int, factor: float) -> TransferMatrix:
    """Wood-Berry with the gain of one element multiplied."""
    rows = [list(row) for row in WOOD_BERRY.elements]
    rows[i][j] = rows[i][j] * factor
    return TransferMatrix(tuple(tuple(row) for row in rows))
