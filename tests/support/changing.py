"""Simulated records whose plant changes on the way: seeded, and called simulated.

The changing element is ``tau(t) x' = K(t) u(t - theta) - x``: the process itself changes, its state runs on. The loop
around it is simulated by `trueplant.loop.simulate` with the other elements, and what the change adds to the output is
found by iteration: it acts on the loop as an output disturbance does, and depends on OP causally.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from support.simulated import BLT, WOOD_BERRY, coloured, random_switching
from trueplant.loop import Controller, Simulation, simulate
from trueplant.lti import TransferMatrix
from trueplant.lti.sampled import sampled_response, split_dead_time

Array = NDArray[np.float64]
PARAMETERS = {
    (0, 0): (12.8, 16.7, 1.4),
    (0, 1): (-18.9, 21.0, 3.4),
    (1, 0): (6.6, 10.9, 7.4),
    (1, 1): (-19.4, 14.4, 3.4),
}
"""Gain, time constant and dead time of the elements of Wood and Berry as `simulated.WOOD_BERRY` has them."""


def varying_lag(gain: Array, tau: Array, dead_time: float, u: Array, h: float) -> Array:
    """x of ``tau x' = K u(t - dead_time) - x`` from rest, u held, K and tau (N,) constant over each sample."""
    q, phi = split_dead_time(dead_time, h)
    late = np.concatenate([np.zeros(q + 1), u])[: u.size + 1]  # late[k + 1] acts in the last part of sample k
    first, second = np.exp(-phi * h / tau), np.exp(-(1 - phi) * h / tau)
    x = np.zeros(u.size)
    for k in range(u.size - 1):
        middle = first[k] * x[k] + (1 - first[k]) * gain[k] * late[k]
        x[k + 1] = second[k] * middle + (1 - second[k]) * gain[k] * late[k + 1]
    return x


def changing_loop(
    plant: TransferMatrix,
    controller: Controller,
    r: Array,
    v: Array,
    place: tuple[int, int],
    gain: ArrayLike,
    tau: ArrayLike,
    dead_time: float,
    h: float = 1.0,
) -> Simulation:
    """The loop with element `place` replaced by one whose gain and time constant (N,) vary."""
    i, j = place
    gain, tau = (np.broadcast_to(np.asarray(x, dtype=float), len(r)) for x in (gain, tau))
    added = v.copy()
    for _ in range(200):
        sim = simulate(plant, controller, r, h, v=added)
        own = sampled_response(plant[i, j], sim.u[:, j], h)
        change = varying_lag(gain, tau, dead_time, sim.u[:, j], h) - own
        new = v.copy()
        new[:, i] += change
        if np.max(np.abs(new - added)) < 1e-9:
            return sim
        added = new
    raise AssertionError("the iteration did not settle: the change is too large for it")


def changing_wood_berry(
    seed: int,
    samples: int = 6000,
    place: tuple[int, int] = (0, 0),
    gain: ArrayLike = 1.0,
    tau: ArrayLike = 1.0,
    std: float = 0.3,
    quiet: tuple[int, int] = (0, 0),
    level: ArrayLike = 1.0,
) -> Simulation:
    """Wood-Berry under BLT PI, set-points switching at random; `gain` and `tau` are factors, (N,) or numbers.

    No set-point moves from sample quiet[0] to quiet[1]; `level` (N,) multiplies the AR(1) disturbance.
    """
    rng = np.random.default_rng(seed)
    r = random_switching(rng, samples, 2, 20.0)
    r[quiet[0] : quiet[1]] = r[quiet[0]]
    v = coloured(rng, samples, 2, [1, -0.8], [1], std) * np.broadcast_to(np.asarray(level, float), samples)[:, None]
    k, lag, dead = PARAMETERS[place]
    return changing_loop(WOOD_BERRY, BLT, r, v, place, k * np.asarray(gain), lag * np.asarray(tau), dead)


PROJECT = """
time_unit = "min"
data = {files = ["record.csv"]}
output = [{name = "top", pv = "pv1", sp = "sp1", unit = "%"}, {name = "bottom", pv = "pv2", sp = "sp2", unit = "%"}]
input = [{name = "reflux", op = "op1", unit = "lb/min"}, {name = "steam", op = "op2", unit = "lb/min"}]
model = [
    {output = "top", input = "reflux", tf = "12.8 exp(-1.4 s)/(16.7 s + 1)"},
    {output = "top", input = "steam", tf = "-18.9 exp(-3.4 s)/(21 s + 1)"},
    {output = "bottom", input = "reflux", tf = "6.6 exp(-7.4 s)/(10.9 s + 1)"},
    {output = "bottom", input = "steam", tf = "-19.4 exp(-3.4 s)/(14.4 s + 1)"},
]
"""


def write_project(simulation: Simulation, folder: Path, project: str = PROJECT) -> Path:
    """The record as record.csv and the project file beside it, whose path is returned."""
    import polars as pl

    columns = {"t": simulation.t}
    for k in range(2):
        columns |= {
            f"sp{k + 1}": simulation.r[:, k],
            f"op{k + 1}": simulation.u[:, k],
            f"pv{k + 1}": simulation.y[:, k],
        }
    pl.DataFrame(columns).write_csv(folder / "record.csv")
    path = folder / "project.toml"
    path.write_text(project, encoding="utf-8")
    return path
