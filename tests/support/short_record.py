"""A single loop whose record says little (simulated), as a project."""

from __future__ import annotations

from pathlib import Path

import polars as pl

from trueplant.loop import PID, Controller, alternating_steps, simulate
from trueplant.lti import TransferMatrix


def loop_project(folder: Path, extra: str = "", op_limits: str = "", loop: str = "closed", noise: float = 0.3) -> Path:
    """A single loop whose record of 200 min says little (simulated)."""
    plant = TransferMatrix.of([["2 exp(-3 s)/(12 s + 1)"]], "min")
    law = Controller.diagonal([PID(Kc=0.8, Ti=12.0, sample_time=1.0)])
    setpoint = 60 + alternating_steps(200, 1.0, 80.0, [1.0])
    sim = simulate(plant, law, setpoint, 1.0, noise=noise, seed=3, u0=50.0, y0=60.0)
    columns = {"t": sim.t, "sp": sim.r[:, 0], "op": sim.u[:, 0], "pv": sim.y[:, 0]}
    pl.DataFrame(columns).write_csv(folder / "record.csv")
    path = folder / "project.toml"
    path.write_text(f"""
time_unit = "min"
[[experiment]]
file = "record.csv"
loop = "{loop}"
[[output]]
name = "y"
pv = "pv"
sp = "sp"
unit = "degC"
[[input]]
name = "u"
op = "op"
unit = "%"
{op_limits}
[[model]]
output = "y"
input = "u"
tf = "2 exp(-3 s)/(12 s + 1)"
{extra}
""")
    return path


CONTROLLER = '[[controller]]\noutput = "y"\ninput = "u"\nKc = 0.8\nTi = 12.0\nsample_time = 1.0\n'
