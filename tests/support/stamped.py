"""A simulated single loop whose set-point moves, as a frame with time stamps or numbers (seeded, called simulated)."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from zoneinfo import ZoneInfo

import numpy as np
import polars as pl

from support.simulated import Array, coloured
from trueplant.loop import PID, Controller, simulate
from trueplant.lti import TransferMatrix

PLANT = TransferMatrix.of([["2 exp(-3 s)/(20 s + 1)"]], "min")
LAW = Controller.diagonal([PID(Kc=1.0, Ti=20.0, sample_time=1.0)])
BEGIN = datetime(2024, 3, 30, 18, tzinfo=UTC)
"""Seven hours before Amsterdam's clock goes to summer time."""
AMSTERDAM = "Europe/Amsterdam"
PROJECT = """
time_unit = "min"

[data]
files = ["march.csv"]   # a month
{data}

[[output]]
name = "T"
pv = "pv"
sp = "sp"
unit = "degC"

[[input]]
name = "steam"
op = "op"
unit = "%"
limits = [0, 100]
{input}

[[model]]
output = "T"
input = "steam"
tf = "2 exp(-3 s)/(20 s + 1)"   # of May
"""


def square_wave(samples: int, every: int, size: float = 1.0) -> Array:
    """(samples, 1) between 0 and `size`, from rest."""
    return np.asarray(size * (np.arange(samples) // every % 2), dtype=float)[:, None]


def record(r: Array, seed: int = 1, std: float = 0.1) -> dict[str, Array]:
    """Columns t (min), sp, pv, op of the loop about 100 degC and 50 %, AR(1) disturbance; r (N, 1) in degC."""
    v = coloured(np.random.default_rng(seed), len(r), 1, [1, -0.8], [1], std)
    run = simulate(PLANT, LAW, r, 1.0, v=v)
    return {"t": run.t, "sp": r[:, 0] + 100, "pv": run.y[:, 0] + 100, "op": run.u[:, 0] + 50}


def stamped(columns: dict[str, Array], how: str) -> pl.DataFrame:
    """The same with its time as "numbers", as "local" clock without an offset, or with its "offset"."""
    t = columns["t"].tolist()
    moments = [(BEGIN + timedelta(minutes=x)).astimezone(ZoneInfo(AMSTERDAM)) for x in t]
    times = {
        "numbers": t,
        "local": [f"{m:%Y-%m-%d %H:%M:%S}" for m in moments],
        "offset": [m.isoformat() for m in moments],
    }[how]
    return pl.DataFrame({"time": times, **{name: x for name, x in columns.items() if name != "t"}})


def project_text(data: str = "", inputs: str = "") -> str:
    """The project file of this loop, with more lines under [data] and [[input]]."""
    return PROJECT.format(data=data, input=inputs)
