"""Wood-Berry with one gain higher than the model's, under disturbances, in a whole analysis."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from support.simulated import BLT, WOOD_BERRY
from trueplant import Project, Result, run
from trueplant.loop import simulate
from trueplant.lti import TransferMatrix, to_formula
from trueplant.lti.structure import structure_of

FEED = TransferMatrix.of([["3.8 exp(-8.1 s)/(14.9 s + 1)"], ["4.9 exp(-3.4 s)/(13.2 s + 1)"]])
"""Wood and Berry (1973): feed flow to both compositions."""
LAWS = [
    {"input": "reflux", "output": "top", "Kc": 0.375, "Ti": 8.29, "sample_time": 1.0},
    {"input": "steam", "output": "bottom", "Kc": -0.0754, "Ti": 23.6, "sample_time": 1.0},
]
PLANT = TransferMatrix(
    ((WOOD_BERRY[0, 0], WOOD_BERRY[0, 1]), (WOOD_BERRY[1, 0] * 1.3, WOOD_BERRY[1, 1])), WOOD_BERRY.time_unit
)
"""One gain 30 % higher than the model's."""
WITH_FIT, WITH_CLOSED_FORM = "fit with disturbance estimate", "closed-form with disturbance estimate"


def analysed(folder: Path, v: np.ndarray, r: np.ndarray, d: np.ndarray | None = None, **tables: Any) -> Result:
    """Wood-Berry with PLANT under the disturbance v, analysed with the old model."""
    simulation = simulate(PLANT, BLT, r, 1.0, v=v)
    columns = {"t": simulation.t}
    for k in range(2):
        columns |= {f"sp{k}": simulation.r[:, k], f"op{k}": simulation.u[:, k], f"pv{k}": simulation.y[:, k]}
    if d is not None:
        columns["feed"] = d[:, 0]
    pl.DataFrame(columns).write_csv(folder / "record.csv")
    elements = [
        {"output": y, "input": u, "tf": to_formula(WOOD_BERRY[i, j], digits=12)}
        for i, y in enumerate(["top", "bottom"])
        for j, u in enumerate(["reflux", "steam"])
    ]
    made = Project(
        time_unit="min",
        data={"files": ["record.csv"], "time": "t"},
        output=[{"name": "top", "pv": "pv0", "sp": "sp0"}, {"name": "bottom", "pv": "pv1", "sp": "sp1"}],
        input=[{"name": "reflux", "op": "op0"}, {"name": "steam", "op": "op1"}],
        model=elements + tables.pop("more", []),
        controller=tables.pop("controller", LAWS),
        **tables,
    )
    return run(Project.from_toml(made.to_toml(), folder))


def parameters(result: Result, method: str) -> dict[tuple[str, str], list[dict[str, Any]]]:
    return {(e["output"], e["input"]): e["parameters"] for e in result.to_dict()["methods"][method]}


def true_value(output: str, column: str, k: int) -> float:
    matrix = FEED if column == "feed" else PLANT
    j = 0 if column == "feed" else ["reflux", "steam"].index(column)
    return float(structure_of(matrix[["top", "bottom"].index(output), j])[1][k])


def outside(result: Result, method: str) -> int:
    """Intervals that miss the true value."""
    return sum(
        not p["ci"][0] < true_value(*place, k) < p["ci"][1]
        for place, row in parameters(result, method).items()
        for k, p in enumerate(row)
    )
