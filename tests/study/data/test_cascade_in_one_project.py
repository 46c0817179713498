"""Master and slave as two loops of one project, the slave's valve at its limits for half of the record (simulated)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import polars as pl
import pytest

from support.simulated import random_switching
from trueplant import Project, Result, run

SAMPLES = 2500
OUTER = "2 exp(-5 s)/(30 s + 1)"
INNER = "exp(-s)/(3 s + 1)"


def cascade(folder: Path, limit: float) -> Result:
    """Temperature over flow: PIs sample by sample; the flow moves the temperature, and the valve the flow."""
    rng = np.random.default_rng(3)
    r = 50 + random_switching(rng, SAMPLES, 1, 150.0)[:, 0]
    noise = rng.standard_normal((SAMPLES, 2)) * (0.05, 0.02)
    slow, fast = np.exp(-1 / 30), np.exp(-1 / 3)
    T, F, op, valve = np.full(SAMPLES, 50.0), np.zeros(SAMPLES), np.zeros(SAMPLES), np.zeros(SAMPLES)
    x = last = below = 0.0
    for k in range(SAMPLES):
        if k:
            x = slow * x + 2 * (1 - slow) * (F[k - 5] if k >= 5 else 0.0)
            F[k] = fast * (F[k - 1] - noise[k - 1, 1]) + (1 - fast) * (valve[k - 2] if k >= 2 else 0.0) + noise[k, 1]
        T[k] += x + noise[k, 0]
        error = r[k] - T[k]
        op[k] = op[k - 1] + 0.5 * (error - last) + 0.5 / 30 * error if k else 0.0
        inner = op[k] - F[k]
        valve[k] = np.clip(valve[k - 1] + 0.9 * (inner - below) + 0.3 * inner, -limit, limit) if k else 0.0
        last, below = error, inner
    columns = {"t": np.arange(SAMPLES, dtype=float), "tsp": r, "tpv": T, "fsp": op, "fpv": F, "valve": valve}
    pl.DataFrame(columns).write_csv(folder / "record.csv")
    project = Project(
        time_unit="s",
        data={"files": ["record.csv"], "time": "t"},
        output=[{"name": "temperature", "pv": "tpv", "sp": "tsp"}, {"name": "flow", "pv": "fpv", "sp": "fsp"}],
        input=[
            {"name": "asked", "op": "fsp"},
            {"name": "valve", "op": "valve", **({"limits": [-limit, limit]} if np.isfinite(limit) else {})},
        ],
        model=[
            {"output": "temperature", "input": "asked", "tf": OUTER, "structure": "auto"},
            {"output": "flow", "input": "valve", "tf": INNER},
        ],
        controller=[
            {"input": "asked", "output": "temperature", "Kc": 0.5, "Ti": 30.0, "sample_time": 1.0},
            {"input": "valve", "output": "flow", "Kc": 0.9, "Ti": 3.0, "sample_time": 1.0},
        ],
    )
    return run(Project.from_toml(project.to_toml(), folder))


def test_the_valve_of_a_slave_at_its_limit_is_no_element_of_the_master(tmp_path):
    """Its OP tells more of the flow than the flow's set-point does; before, the master's gain fell by 101 %."""
    result = cascade(tmp_path, limit=0.4)
    assert ("temperature", "valve") not in {(e.output, e.input) for e in result.elements}
    assert "missing-element" not in {note.code for note in result.notes}
    (entry,) = result.to_dict()["methods"]["cascade"]
    assert entry["input"] == "asked"
    assert entry["follows"] is False
    assert "OP did not reach the plant then" in entry["message"]
    assert any(note.code == "cascade" and note.message == entry["message"] for note in result.notes)


def test_a_slave_that_follows_is_said_without_being_declared(tmp_path):
    result = cascade(tmp_path, limit=np.inf)
    (entry,) = result.to_dict()["methods"]["cascade"]
    assert entry["follows"] is True, entry["message"]
    gain = {(e.output, e.input): e for e in result.elements}["temperature", "asked"].parameters[0]
    assert gain.ci[0] < 2 < gain.ci[1]
    assert gain.plant == pytest.approx(2.0, rel=0.05)
