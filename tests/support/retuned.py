"""Analyses with a [tuning] table for the tests on retuning: the demos' records and one loop (all simulated)."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path
from typing import Any

import polars as pl

import trueplant as tp
from trueplant import Project, Result
from trueplant.loop import PID, Controller, alternating_steps, simulate
from trueplant.lti import TransferMatrix
from trueplant.project.simulation import simulate_record


def demo(name: str, folder: Path, tuning: str) -> tuple[Result, TransferMatrix]:
    """Result of a demo's record (simulated) with a [tuning] table, and the plant that made it."""
    text = files("trueplant.cli.demos").joinpath(f"{name}.toml").read_text("utf-8")
    simulate_record(Project.from_toml(text, folder)).write_csv(folder / "record.csv")
    project = Project.from_toml(text.replace("\n[simulate]", f"\n{tuning}\n[simulate]", 1), folder)
    assert project.simulate is not None
    elements = {(e.output, e.input): str(e.tf) for e in project.simulate.plant}  # type: ignore[union-attr]
    rows = [[elements.get((y, u), "0") for u in project.input_names] for y in project.output_names]
    return tp.run(project), TransferMatrix.of(rows, "min")


def small(folder: Path, extra: str, controller: str, *, plant: str = "2 exp(-2 s)/(10 s + 1)", law: PID, seed: int = 1):
    system = tp.TransferMatrix.of([[plant]], "min")
    r = 50 + alternating_steps(600, 1.0, 60.0, [4.0])
    sim = simulate(system, Controller.diagonal([law]), r, 1.0, noise=0.05, seed=seed, u0=40.0, y0=50.0)
    columns = {"t": sim.t, "sp": sim.r[:, 0], "op": sim.u[:, 0], "pv": sim.y[:, 0]}
    pl.DataFrame(columns).write_csv(folder / "record.csv")
    return Project.from_toml(
        f"""
        time_unit = "min"
        data = {{files = ["record.csv"]}}
        output = [{{name = "y", pv = "pv", sp = "sp", limits = [0, 200], span = [0, 200]}}]
        input = [{{name = "u", op = "op", limits = [0, 100], span = [0, 100]}}]
        model = [{{output = "y", input = "u", tf = "1.5 exp(-2 s)/(10 s + 1)"}}]
        {controller}
        {extra}
        """,
        folder,
    )


PI_LAW = PID(Kc=1.0, Ti=10.0, sample_time=1.0)
DECLARED = '[[controller]]\ninput = "u"\noutput = "y"\nKc = 1.0\nTi = 10\nsample_time = 1\n'


def proposal(loop: Any, method: str) -> Any:
    return next(p for p in loop["proposals"] if p["method"] == method)
