"""Simulated records of the benchmarks of continuous-time identification, for tests and benchmarks; seeded."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter, max_len_seq

from trueplant import plants
from trueplant.loop import PID, Controller, simulate
from trueplant.lti import TransferMatrix, sampled_response, tf
from trueplant.record.types import Segment

Array = NDArray[np.float64]

REST = 30
"""Samples at rest before the input moves, so that the start is known to be steady."""
RAO_GARNIER = np.array([5.0, 408.0, 416.0, 1600.0, -6400.0, 1600.0])
"""a1..a4, b0, b1."""
CLOSED_LOOP = np.array([0.5, 1.0, 1.0, 1.0])
"""a1, a2, b0, b1."""
DELAYED = np.array([1.0, 4.0, -4.0, 0.5, 8.0])
"""a1, a2, b0, b1, dead time."""
CLOSED_PLANT = TransferMatrix.of([["(s + 1)/(s^2 + 0.5 s + 1)"]], "s")
CLOSED_H = 0.005
DELAYED_PLANT = tf("(-4 s + 0.5) exp(-8 s)/(s^2 + s + 4)")


def prbs(stages: int, hold: int) -> Array:
    """+-1, one period of a maximum length sequence, each value held."""
    return np.repeat(2.0 * max_len_seq(stages)[0] - 1, hold)


def _open(u: Array, y: Array, h: float) -> Segment:
    n = u.size
    t = h * np.arange(n)
    unknown, free = np.full((n, 1), np.nan), np.ones((n, 1), dtype=bool)
    return Segment(0, h, t, unknown, u[:, None], y[:, None], np.zeros((n, 0)), free, ("zoh",), False)


def rao_garnier_record(seed: int, noise: float = 1.0638) -> Segment:
    """PRBS of 10 stages, hold 7, h = 0.01 s, white noise (10 dB): 7,161 samples after rest."""
    u = np.r_[np.zeros(REST), prbs(10, 7)]
    y = sampled_response(plants.rao_garnier().model[0, 0], u, 0.01)
    return _open(u, y + noise * np.random.default_rng(seed).standard_normal(u.size), 0.01)


def delayed_record(seed: int, decibel: float = 15.0) -> Segment:
    """(-4 s + 0.5) e^(-8 s)/(s^2 + s + 4), PRBS of 8 stages, hold 5, h = 0.1 s, white noise: several minima."""
    u = np.r_[np.zeros(REST), prbs(8, 5)]
    y = sampled_response(DELAYED_PLANT, u, 0.1)
    std = y[REST:].std() * 10 ** (-decibel / 20)
    return _open(u, y + std * np.random.default_rng(seed).standard_normal(u.size), 0.1)


def tustin(kp: float = 10.0, ki: float = 15.0) -> Controller:
    """(kp s + ki)/s by Tustin's rule, which is the backward difference with another proportional gain."""
    gain = kp - ki * CLOSED_H / 2
    return Controller.diagonal([PID(form="parallel", Kp=gain, Ki=ki, sample_time=CLOSED_H)])


def closed_loop_record(seed: int, noise: str, rest: int = REST) -> Segment:
    """The benchmark of Gilson, Garnier, Young and Van den Hof: u = r - C y, PRBS of 4 stages, hold 500.

    noise: "white" (20 dB), "coloured" (10 dB, (1 + 0.5/q)/(1 - 0.85/q)) or "none". The set-point of the record is the
    one whose controller adds r to OP: C^-1 r.
    """
    sequence = prbs(4, 500)
    r = np.r_[np.zeros(rest), sequence, sequence[:1]]
    first, second = 10 + 15 * CLOSED_H / 2, 10 - 15 * CLOSED_H / 2
    setpoint = lfilter([1, -1], [first, -second], r)[:, None]
    rng = np.random.default_rng(seed)
    v = np.zeros(r.size)
    if noise == "white":
        v = 0.00498 * rng.standard_normal(r.size)
    elif noise == "coloured":
        v = lfilter([1, 0.5], [1, -0.85], rng.standard_normal(r.size + 500))[500:]
        power = np.sum(lfilter([1, 0.5], [1, -0.85], np.eye(1, 500)[0]) ** 2)
        clean = simulate(CLOSED_PLANT, tustin(), setpoint, CLOSED_H).y[rest:]
        v = v * clean.std() / np.sqrt(10 * power)
    s = simulate(CLOSED_PLANT, tustin(), setpoint, CLOSED_H, noise=v[:, None])
    n = r.size
    free = np.ones((n, 1), dtype=bool)
    return Segment(0, CLOSED_H, s.t, s.r, s.u, s.y, np.zeros((n, 0)), free, ("zoh",))
