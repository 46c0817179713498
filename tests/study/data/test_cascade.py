"""The slave of a cascade: a fast one, a slow one, one at its limit, one that cannot be judged (all simulated)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

from support.simulated import random_switching
from trueplant import Project, Result, run
from trueplant.loop import PID, Controller, simulate
from trueplant.lti import TransferMatrix, sampled_response

OUTER = TransferMatrix.of([["2 exp(-4 s)/(30 s + 1)"]])
"""From the slave's measurement to the master's PV."""
MASTER = Controller.diagonal([PID(Kc=1.5, Ti=30.0, sample_time=1.0)])
SAMPLES = 2500


def cascade(folder: Path, lag: float, high: float = np.inf, gain: float = 1.0, **tables: Any) -> Result:
    """Master and slave run sample by sample; the slave is of first order, and its measurement ends at `high`."""
    rng = np.random.default_rng(3)
    r = random_switching(rng, SAMPLES, 1, 120.0)[:, 0]
    noise = 0.02 * rng.standard_normal(SAMPLES)
    a, b, delay = np.exp(-1 / 30.0), 2 * (1 - np.exp(-1 / 30.0)), 4
    x, pv, op, slave = 0.0, np.zeros(SAMPLES), np.zeros(SAMPLES), np.zeros(SAMPLES)
    integral, c = 0.0, np.exp(-1 / lag)
    for k in range(SAMPLES):
        if k:
            slave[k] = min(c * slave[k - 1] + (1 - c) * gain * op[k - 1], high)
            x = a * x + b * (slave[k - 1 - delay] if k > delay else 0.0)
        pv[k] = x + noise[k]
        error = r[k] - pv[k]
        integral += 1.5 / 30.0 * error
        op[k] = 1.5 * error + integral
    measured = slave + 0.005 * rng.standard_normal(SAMPLES)
    columns = {"t": np.arange(SAMPLES, dtype=float), "sp": r, "op": op, "pv": pv, "fsp": op, "fpv": measured}
    pl.DataFrame(columns).write_csv(folder / "record.csv")
    tables.setdefault(
        "controller", [{"input": "flow", "output": "temperature", "Kc": 1.5, "Ti": 30.0, "sample_time": 1.0}]
    )
    return analysed(folder, **tables)


def analysed(folder: Path, **tables: Any) -> Result:
    made = Project(
        time_unit="s",
        data={"files": ["record.csv"], "time": "t"},
        output=[{"name": "temperature", "pv": "pv", "sp": "sp"}],
        input=[{"name": "flow", "op": "op", "slave_sp": "fsp", "slave_pv": "fpv"}],
        model=[{"output": "temperature", "input": "flow", "tf": "2 exp(-4 s)/(30 s + 1)"}],
        **tables,
    )
    return run(Project.from_toml(made.to_toml(), folder))


def slave_of(result: Result) -> dict[str, Any]:
    (entry,) = result.to_dict()["methods"]["cascade"]
    assert any(note.code == "cascade" and note.message == entry["message"] for note in result.notes)
    return entry


def test_the_loop_written_here_is_that_of_the_simulator(tmp_path):
    """A slave without lag: then the record is that of the master alone, by the simulator of the package."""
    cascade(tmp_path, lag=1e-3)
    record = pl.read_csv(tmp_path / "record.csv")
    slave = TransferMatrix.of([["2 exp(-5 s)/(30 s + 1)"]])  # the measurement is a sample late
    noise = record["pv"].to_numpy() - sampled_response(slave, record["op"].to_numpy()[:, None], 1.0)[:, 0]
    again = simulate(slave, MASTER, record["sp"].to_numpy()[:, None], 1.0, noise=noise[:, None])
    assert np.allclose(again.y[:, 0], record["pv"].to_numpy(), atol=1e-9)
    assert np.std(noise) == pytest.approx(0.02, rel=0.1)


def test_fast_slave_follows(tmp_path):
    entry = slave_of(cascade(tmp_path, lag=1.0))
    assert entry["follows"] is True
    assert entry["deviation"] < 0.15
    assert entry["gain"] == pytest.approx(1.0, abs=0.03)
    assert entry["basis"] == "where the master's loop gain is 1"
    assert entry["stuck_share"] < 0.01
    # |L| = 1 for L = 1.5 (1 + 1/(30 s)) 2 exp(-4 s)/(30 s + 1) = 3 exp(-4 s)/(30 s): at 0.1 rad/s; the slave slows it
    assert entry["band"][1] == pytest.approx(0.1, rel=0.1)


def test_slow_slave_is_said(tmp_path):
    entry = slave_of(cascade(tmp_path, lag=8.0))
    assert entry["follows"] is False
    assert "too slow" in entry["message"]
    # a first-order lag of 8 s and half a sample; its phase delay at the band's end is a little less
    assert entry["lag"] == pytest.approx(8.0, rel=0.25)
    w = entry["at"]
    assert entry["deviation"] == pytest.approx(abs(1 / (1 + 8j * w) - 1), rel=0.2)


def test_saturated_slave_is_said(tmp_path):
    entry = slave_of(cascade(tmp_path, lag=1.0, high=0.85))
    assert entry["follows"] is False
    assert "upper end" in entry["message"]
    assert entry["held_share"] > 0.02


def test_slave_that_does_half_is_said(tmp_path):
    entry = slave_of(cascade(tmp_path, lag=1.0, gain=0.5))
    assert entry["follows"] is False
    assert entry["gain"] == pytest.approx(0.5, abs=0.03)
    assert "0.5 of what is asked" in entry["message"]


def test_without_a_controller_the_band_is_where_op_moves(tmp_path):
    entry = slave_of(cascade(tmp_path, lag=1.0, controller=[]))
    assert entry["basis"] == "where OP moves"
    assert entry["follows"] is True


def replaced(folder: Path, **columns: np.ndarray) -> dict[str, Any]:
    """The result with some columns of the record replaced, no controller declared."""
    cascade(folder, lag=1.0)
    record = pl.read_csv(folder / "record.csv")
    record.with_columns(pl.Series(name, values) for name, values in columns.items()).write_csv(folder / "record.csv")
    return slave_of(analysed(folder))


def test_slave_that_is_not_in_cascade_is_said(tmp_path):
    own = random_switching(np.random.default_rng(8), SAMPLES, 1, 50.0)[:, 0]
    answer = sampled_response(TransferMatrix.of([["1/(s + 1)"]]), own[:, None], 1.0)[:, 0]
    assert "was the slave in cascade mode" in replaced(tmp_path, fsp=own, fpv=answer)["message"]


def test_slave_that_stands_still_cannot_be_judged(tmp_path):
    entry = replaced(tmp_path, fsp=np.ones(SAMPLES))
    assert entry["follows"] is None
    assert "cannot be told" in entry["message"]


def test_sticking_slave_is_said(tmp_path):
    """A valve that stays until its set-point is 0.4 away, then jumps to it."""
    cascade(tmp_path, lag=1.0)
    op = pl.read_csv(tmp_path / "record.csv")["op"].to_numpy()
    stem = np.zeros(SAMPLES)
    for k in range(1, SAMPLES):
        stem[k] = op[k - 1] if abs(op[k - 1] - stem[k - 1]) > 0.4 else stem[k - 1]
    entry = replaced(tmp_path, fpv=stem)
    assert entry["follows"] is False
    assert "sticks" in entry["message"]
