"""Plans for loops that disturb each other, and for levels in manual (simulated)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from support.short_record import CONTROLLER, loop_project
from trueplant import Project, run
from trueplant.loop import PID, Controller, Simulation, alternating_steps, simulate
from trueplant.lti import TransferMatrix
from trueplant.study.experiment.moves import Moves


def two_loops(folder: Path, interaction: float, noise: float, samples: int) -> Path:
    """Two loops of which the second disturbs the first by so much; both set-points move (simulated)."""
    elements = [["2 exp(-3 s)/(12 s + 1)", f"{interaction} exp(-3 s)/(12 s + 1)"], ["0", "2 exp(-3 s)/(12 s + 1)"]]
    law = Controller.diagonal([PID(Kc=0.8, Ti=12.0, sample_time=1.0)] * 2)
    moves = alternating_steps(samples, 1.0, 60.0, [3.0, 3.0])
    sim = simulate(TransferMatrix.of(elements, "min"), law, moves, 1.0, noise=noise, seed=4)
    columns = {"t": sim.t} | {
        f"{n}{k}": x[:, k] for n, x in (("sp", sim.r), ("op", sim.u), ("pv", sim.y)) for k in (0, 1)
    }
    pl.DataFrame(columns).write_csv(folder / "record.csv")
    text = 'time_unit = "min"\n[data]\nfiles = ["record.csv"]\n'
    for k in (0, 1):
        text += f'[[output]]\nname = "y{k}"\npv = "pv{k}"\nsp = "sp{k}"\n[[input]]\nname = "u{k}"\nop = "op{k}"\n'
        text += f'[[controller]]\noutput = "y{k}"\ninput = "u{k}"\nKc = 0.8\nTi = 12.0\nsample_time = 1.0\n'
    for i, j in ((0, 0), (0, 1), (1, 1)):
        text += f'[[model]]\noutput = "y{i}"\ninput = "u{j}"\ntf = "{elements[i][j]}"\n'
    path = folder / "project.toml"
    path.write_text(text)
    return path


def test_an_interaction_that_matters_little_is_not_tested(tmp_path: Path) -> None:
    """Its gain is open, and so small that the loops hardly notice; the elements of the loops are known well."""
    result = run(Project.load(two_loops(tmp_path, 0.02, 0.03, 3000))).to_dict()
    wide = [p for e in result["elements"] for p in e["parameters"] if (e["output"], e["input"]) == ("y0", "u1")]
    assert (wide[0]["ci"][1] - wide[0]["ci"][0]) / 2 > 0.1 * abs(wide[0]["plant"])
    assert [e["not_worth"] for e in result["more_data"]] == ["matters-little"]
    assert result["more_data"][0]["moves"] == []


def test_where_little_is_known_the_first_of_two_tests_is_planned(tmp_path: Path) -> None:
    """A small test, no further than the record went, after which a second can be planned."""
    path = loop_project(tmp_path, CONTROLLER, noise=0.6)
    result = run(Project.load(path)).to_dict()
    first = result["more_data"][0]
    assert first["first_of_two"] and not first["suffices"]
    assert "It is the first of two tests" in first["sentence"]
    assert first["moves"][0]["size"] <= 0.5  # half of the set-point's range in the record
    lag = next(s for s in first["settles"] if s["parameter"] == "tau1")
    assert lag["then"] < 0.75 * lag["now"]


LEVEL = TransferMatrix.of([["0.05 exp(-4 s)/s"]], "min")


def planned_for(folder: Path, record: Simulation, limits: tuple[list[float], list[float]], tf: str) -> dict[str, Any]:
    """What is planned after a record of a level in manual, within limits of PV and of OP."""
    columns = {"t": record.t, "op": record.u[:, 0], "pv": record.y[:, 0]}
    pl.DataFrame(columns).write_csv(folder / "record.csv")
    text = f"""
time_unit = "min"
[[experiment]]
file = "record.csv"
loop = "open"
[[output]]
name = "level"
pv = "pv"
unit = "%"
limits = {limits[0]}
[[input]]
name = "feed"
op = "op"
unit = "%"
limits = {limits[1]}
[[model]]
output = "level"
input = "feed"
tf = "{tf}"
"""
    entry: dict[str, Any] = run(Project.from_toml(text, folder)).to_dict()["more_data"][0]
    return entry


def test_a_level_in_manual_is_tested_within_its_limits(tmp_path: Path) -> None:
    """The plan on the true level, 100 times with noise of its own: within limits, and back at the end (simulated)."""
    moved = np.zeros((160, 1))
    moved[20:60], moved[60:100] = 2.0, -2.0
    sim = simulate(LEVEL, None, np.zeros((160, 1)), 1.0, u=30 + moved, u0=30.0, y0=50.0, noise=0.8, seed=2)
    entry = planned_for(tmp_path, sim, ([40, 60], [10, 60]), "0.05 exp(-4 s)/s")
    (move,) = entry["moves"]
    course = Moves({0: move["size"]}, {0: move["every"]}).course(entry["length"], 1.0, 1, rest=60)
    assert abs(course.sum()) < 1e-9
    for seed in range(100):
        y = simulate(LEVEL, None, np.zeros_like(course), 1.0, u=course, noise=0.8, seed=seed, y0=50.0).y[:, 0]
        assert y.min() > 40 and y.max() < 60
        assert abs(y[-30:].mean() - 50.0) < 0.6


def test_a_level_that_drifts_in_manual_gets_no_long_test(tmp_path: Path) -> None:
    """OP was left 1 % off balance: PV would be out of its limits by itself, and no plan says otherwise (simulated)."""
    moved = np.ones((160, 1))
    moved[20:60], moved[60:100] = 3.0, -1.0
    sim = simulate(LEVEL, None, np.zeros((160, 1)), 1.0, u=moved, noise=0.5, seed=2)
    high = float(sim.y[-1, 0]) + 3.0  # an hour away
    entry = planned_for(tmp_path, sim, ([-20, high], [-20, 20]), "0.06 exp(-3 s)/s")
    assert entry["moves"] == []
    assert entry["not_worth"] in ("limits-too-near", "too-long")
