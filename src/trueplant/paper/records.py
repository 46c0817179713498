"""The splitter's record of Figure 10, simulated: the industrial record itself is not public.

The plant (40) under Table 2, with the sign that the top temperature's controller must have, scanned every 0.1 min
for 5 hours. The two set-points take turns every 50 min, each between -1 and +1: six steps. The noise is scaled so
that the true plant's own fit to the record is what Table 5 prints for G*.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from trueplant.arrays import Array
from trueplant.loop import Controller, Simulation, simulate
from trueplant.lti import Structure, TransferMatrix
from trueplant.lti.structure import structure_of
from trueplant.plants import splitter
from trueplant.record import Segment

H, SAMPLES = 0.1, 3000
STEP_TIMES = (25.0, 75.0, 125.0, 175.0, 225.0, 275.0)
LEVELS = (1.0, 1.0, -1.0, -1.0, 1.0, 1.0)
OWN_FIT = ((75.01 + 76.53) / 2, 87.63)
"""Fit (%) of the true plant to each output: Table 5's G*, the mean of its two numbers for the top temperature."""
KINDS = {
    "white": "white measurement noise",
    "slow": "half of the noise variance white, half a first-order disturbance with a time constant of 5 min",
}
SLOW_TIME = 5.0
POLE = float(np.exp(-H / SLOW_TIME))
ELEMENTS = ((0, 0), (0, 1), (1, 1))
FOPDT = Structure.parse("fopdt")
LONG = 200_000
"""Samples from which the share of the noise in the closed loop is computed."""


@dataclass(frozen=True)
class Case:
    """Model (41), plant (40) and the controller as it runs."""

    model: TransferMatrix
    plant: TransferMatrix
    controller: Controller


@cache
def case() -> Case:
    """The splitter with its controllers scanning at H."""
    found = splitter()
    assert found.plant is not None
    assert found.controller is not None
    scanned = Controller.diagonal([replace(entry, sample_time=H) for entry in found.controller.entries.values()])
    return Case(found.model, found.plant, scanned)


def parameters(matrix: TransferMatrix) -> Array:
    """Gain, time constant and dead time of the elements (1, 1), (1, 2) and (2, 2), in this order: (9,)."""
    return np.concatenate([structure_of(matrix[element])[1] for element in ELEMENTS])


def setpoints() -> Array:
    """(SAMPLES, 2)"""
    t = H * np.arange(SAMPLES)
    r = np.zeros((SAMPLES, 2))
    for k, (time, level) in enumerate(zip(STEP_TIMES, LEVELS, strict=True)):
        r[t >= time - H / 2, k % 2] = level
    return r


def unit_noise(kind: str, samples: int, rng: np.random.Generator) -> Array:
    """(samples, 2) of variance 1."""
    white = rng.standard_normal((samples, 2))
    if kind == "white":
        return white
    from scipy.signal import lfilter

    before = round(10 * SLOW_TIME / H)
    driven = rng.standard_normal((samples + before, 2)) * np.sqrt(1 - POLE**2)
    slow = lfilter([1.0], [1.0, -POLE], driven, axis=0)[before:]
    return np.asarray(np.sqrt(0.5) * (white + slow))


@cache
def noise_std(kind: str) -> tuple[float, float]:
    """Standard deviations of the noise at the two outputs that give the fits OWN_FIT on average.

    The fit is 100 (1 - |v|/|y - mean y|), and y holds what the loop makes of v: with P the variance of y without
    noise and A_ij the variance of y_i under unit noise at output j,
    var v_i = (1 - fit_i/100)^2 (P_i + sum_j A_ij var v_j).
    """
    loop = case()
    power = simulate(loop.plant, loop.controller, setpoints(), H).y.var(axis=0)
    noise = unit_noise(kind, LONG, np.random.default_rng(0))
    through = np.stack(
        [
            simulate(loop.plant, loop.controller, np.zeros((LONG, 2)), H, v=noise * np.eye(2)[j]).y.var(axis=0)
            for j in range(2)
        ],
        axis=1,
    )
    share = (1 - np.array(OWN_FIT) / 100) ** 2
    variance = np.linalg.solve(np.eye(2) - share[:, None] * through, share * power)
    return float(np.sqrt(variance[0])), float(np.sqrt(variance[1]))


def record(kind: str, seed: int) -> Simulation:
    """One simulated record; the same seed gives the same record."""
    loop = case()
    v = unit_noise(kind, SAMPLES, np.random.default_rng(seed)) * noise_std(kind)
    return simulate(loop.plant, loop.controller, setpoints(), H, v=v)


def quiet_record() -> Simulation:
    """The same record without noise."""
    loop = case()
    return simulate(loop.plant, loop.controller, setpoints(), H)


def segment_of(run: Simulation) -> Segment:
    """A simulated record as a segment, all of it usable."""
    n = run.t.size
    nothing, free = np.zeros((n, 0)), np.ones((n, 2), dtype=bool)
    return Segment(0, H, run.t, run.r, run.u, run.y, nothing, free, ("zoh", "zoh"))
