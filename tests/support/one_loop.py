"""One loop with dead time as a project, its record in a file."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from support.simulated import coloured, random_switching
from trueplant import Project, Result, run
from trueplant.loop import PID, Controller, Simulation, simulate
from trueplant.lti import TransferMatrix

LAG = TransferMatrix.of([["2 exp(-13.4 s)/(60 s + 1)"]])


def single(folder: Path, simulation: Simulation, tf: str = "2 exp(-13.4 s)/(60 s + 1)", **model: Any) -> Result:
    """The result of one loop whose controller is not declared."""
    return run(declared(folder, simulation, tf, **model))


def declared(
    folder: Path, simulation: Simulation, tf: str, controller: Mapping[str, Any] | None = None, **model: Any
) -> Project:
    """One loop, time in seconds; no controller is declared unless its settings are given."""
    columns = {"t": simulation.t, "sp": simulation.r[:, 0], "op": simulation.u[:, 0], "pv": simulation.y[:, 0]}
    pl.DataFrame(columns).write_csv(folder / "one.csv")
    made = Project(
        time_unit="s",
        data={"files": ["one.csv"], "time": "t"},
        output=[{"name": "y", "pv": "pv", "sp": "sp"}],
        input=[{"name": "u", "op": "op"}],
        model=[{"output": "y", "input": "u", "tf": tf, **model}],
        controller=[{"input": "u", "output": "y", **controller}] if controller else [],
    )
    return Project.from_toml(made.to_toml(), folder)


def one_loop(
    seed: int, plant: TransferMatrix = LAG, samples: int = 3000, std: float = 0.1, size: float = 1.0
) -> Simulation:
    rng = np.random.default_rng(seed)
    law = Controller.diagonal([PID(Kc=1.0, Ti=60.0, sample_time=1.0)])
    r = size * random_switching(rng, samples, 1, 150.0)
    return simulate(plant, law, r, 1.0, v=coloured(rng, samples, 1, [1, -0.8], [1], std))
