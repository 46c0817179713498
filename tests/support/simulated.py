"""Simulated records for the tests: seeded, and called simulated."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.signal import lfilter

from trueplant.loop import PID, Controller, Simulation, simulate
from trueplant.lti import TransferMatrix
from trueplant.record.types import Segment

Array = NDArray[np.float64]

WOOD_BERRY = TransferMatrix.of(
    [
        ["12.8 exp(-1.4 s)/(16.7 s + 1)", "-18.9 exp(-3.4 s)/(21 s + 1)"],
        ["6.6 exp(-7.4 s)/(10.9 s + 1)", "-19.4 exp(-3.4 s)/(14.4 s + 1)"],
    ],
    "min",
)
"""Wood and Berry (1973), dead times moved off a sampling grid of 1 min."""
BLT = Controller.diagonal([PID(Kc=0.375, Ti=8.29, sample_time=1.0), PID(Kc=-0.0754, Ti=23.6, sample_time=1.0)])
"""Luyben (1986)."""


def random_switching(rng: np.random.Generator, samples: int, n_y: int, mean: float) -> Array:
    """Set-points (samples, n_y) that switch between 0 and 2 at random instants, on average every `mean` samples."""
    flips = rng.random((samples, n_y)) < 1 / mean
    flips[:5] = False
    return 1 - (-1.0) ** np.cumsum(flips, axis=0)


def coloured(rng: np.random.Generator, samples: int, n_y: int, a: ArrayLike, c: ArrayLike, std: float) -> Array:
    """C(q)/A(q) e of standard deviation std, started long before."""
    c, a = np.asarray(c, dtype=float), np.asarray(a, dtype=float)
    power = np.sum(lfilter(c, a, np.eye(1, 5000)[0]) ** 2)
    e = rng.standard_normal((samples + 500, n_y)) * std / np.sqrt(power)
    filtered: Array = lfilter(c, a, e, axis=0)[500:]
    return filtered


def wood_berry(seed: int, samples: int = 4000, std: float = 0.3, plant: TransferMatrix = WOOD_BERRY) -> Simulation:
    """Wood-Berry under BLT PI, both set-points switching at random, AR(1) disturbance with pole 0.8 (simulated)."""
    rng = np.random.default_rng(seed)
    r = random_switching(rng, samples, 2, 20.0)
    v = coloured(rng, samples, 2, [1, -0.8], [1], std)
    return simulate(plant, BLT, r, 1.0, v=v)


def segment_of(simulation: Simulation, experiment: int = 0) -> Segment:
    """A simulated record as a segment, all of it usable."""
    n, n_u = simulation.u.shape
    return Segment(
        experiment,
        simulation.h,
        simulation.t,
        simulation.r,
        simulation.u,
        simulation.y,
        np.zeros((n, 0)),
        np.ones((n, n_u), dtype=bool),
        ("zoh",) * n_u,
    )
