"""Loops whose controllers are summed up, limited and started in the ways that control systems have (simulated).

Written apart from the package's own simulator: a law here is the few lines that a controller's program would be.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import polars as pl
from numba import njit
from numpy.typing import NDArray

from trueplant import Project

Array = NDArray[np.float64]
SUMS = ("backward", "forward", "trapezoidal")
WINDUPS = ("none", "clamp", "conditional", "back-calculation", "velocity")
STARTS = ("at rest", "from zero")


@dataclass(frozen=True)
class Law:
    """A PI(D) law at steps of 1, signs of u = Q (r - y)."""

    Kc: float
    Ti: float = 0.0
    Td: float = 0.0
    alpha: float = 0.1
    sum: str = "backward"
    windup: str = "clamp"
    derivative_on: str = "error"
    start: str = "at rest"

    def declared(self, gain: float = 1.0, ti: float = 1.0, td: float = 1.0) -> dict[str, Any]:
        """As a [[controller]], its gain and times multiplied."""
        table = {"input": "u", "output": "y", "Kc": gain * self.Kc, "sample_time": 1.0}
        table |= {"Ti": ti * self.Ti} if self.Ti else {}
        if self.Td:
            table |= {"Td": td * self.Td, "alpha": self.alpha, "derivative_on": self.derivative_on}
        return table


@dataclass(frozen=True)
class Loop:
    """A first-order plant with dead time under a law, and what a historian keeps of it."""

    law: Law
    gain: float = 1.0
    lag: float = 40.0
    dead_time: int = 5
    samples: int = 3000
    limits: tuple[float, float] = (0.0, 100.0)
    size: float = 5.0
    """Of set-point moves."""
    every: float = 150.0
    """Samples from one to the next, on average."""
    noise: float = 0.3
    pole: float = 0.0
    """Of the disturbance's autoregression."""
    op_digits: float = 0.01
    pv_digits: float = 0.01
    manual: tuple[tuple[int, int], ...] = ()
    bad: float = 0.0
    """Share of PV samples that the historian lost or got wrong, each half of them."""
    offset: float = 0.0
    """Control error at the start."""
    seed: int = 0

    def record(self) -> pl.DataFrame:
        """Columns t, sp, op, pv, mode (1 in automatic)."""
        rng = np.random.default_rng(self.seed)
        n, law = self.samples, self.law
        flips = rng.random(n) < 1 / self.every
        flips[:10] = False
        r = 50 + self.size * (np.cumsum(flips) % 2)
        e = rng.standard_normal(n) * self.noise * np.sqrt(1 - self.pole**2)
        automatic = np.ones(n, dtype=bool)
        for a, b in self.manual:
            automatic[a:b] = False
        hand = np.repeat(rng.normal(0, 0.05 * (self.limits[1] - self.limits[0]), n // 25 + 1), 25)[:n]
        settings = (law.Kc, law.Ti, law.Td, law.alpha * law.Td)
        kinds = (SUMS.index(law.sum), WINDUPS.index(law.windup), law.derivative_on == "error", STARTS.index(law.start))
        plant = (self.gain, np.exp(-1 / self.lag), self.dead_time, self.offset)
        u, y = _run(r, e, self.pole, automatic, hand, settings, kinds, plant, self.limits)
        pv = np.round(y / self.pv_digits) * self.pv_digits
        hit = np.flatnonzero(rng.random(n) < self.bad)
        wrong = rng.random(hit.size) < 0.5
        pv[hit[~wrong]] = np.nan
        pv[hit[wrong]] += rng.choice([-1.0, 1.0], wrong.sum()) * rng.uniform(1, 20, wrong.sum()) * self.noise
        op = np.round(u / self.op_digits) * self.op_digits
        return pl.DataFrame(
            {"t": np.arange(n, dtype=float), "sp": r, "op": op, "pv": pv, "mode": automatic.astype(np.int64)}
        )

    def project(self, **declared: Any) -> Project:
        """With the law declared as `Law.declared` says."""
        return Project(
            time_unit="s",
            data={"files": ["loop.csv"], "time": "t"},
            output=[{"name": "y", "pv": "pv", "sp": "sp"}],
            input=[{"name": "u", "op": "op", "limits": list(self.limits), "mode": "mode"}],
            model=[{"output": "y", "input": "u", "tf": f"{self.gain} exp(-{self.dead_time} s)/({self.lag} s + 1)"}],
            controller=[self.law.declared(**declared)],
        )


@njit(cache=True)
def _run(r, e, pole, automatic, hand, settings, kinds, plant, limits):  # type: ignore[no-untyped-def]
    """OP and PV as they were, before a historian rounds them."""
    kc, ti, td, tf = settings
    how, windup, on_error, kick = kinds
    gain, decay, dead, offset = plant
    low, high = limits
    n = r.size
    u, y = np.empty(n), np.empty(n)
    ki, kd = (kc / ti if ti > 0 else 0.0), kc * td
    middle = 0.5 * (low + high)
    x, v = 0.0, 0.0
    before = r[0] + offset
    integral, derivative, last_e = middle, 0.0, 0.0
    tracking = max(np.sqrt(ti * td), 1.0) if td > 0 else max(ti, 1.0)
    for k in range(n):
        held = u[k - 1 - dead] if k > dead else middle
        x = decay * x + (1 - decay) * gain * (held - middle)
        v = pole * v + e[k]
        y[k] = r[0] - offset * decay**k + x + v
        error = r[k] - y[k]
        acted = error if on_error else -y[k]
        if k == 0:
            last_e = error
            before = 0.0 if kick else acted
        change = acted - before
        before = acted
        if kd != 0.0:
            derivative = (tf * derivative + kd * change) / (tf + 1.0)
        step = ki * (error if how == 0 else last_e if how == 1 else 0.5 * (error + last_e))
        if not automatic[k]:
            u[k] = min(max((u[k - 1] if hand[k] == hand[k - 1] else middle + hand[k]), low), high)
            integral = u[k] - kc * error - derivative
            last_e = error
            continue
        if windup == 2:
            tried = kc * error + integral + step + derivative
            if not ((tried > high and step > 0) or (tried < low and step < 0)):
                integral += step
        else:
            integral += step
        if windup == 1 and ki != 0.0:
            integral = min(max(integral, low), high)
        raw = kc * error + integral + derivative
        u[k] = min(max(raw, low), high)
        if windup == 3 and ki != 0.0:
            integral += (u[k] - raw) / tracking
        if windup == 4 and ki != 0.0:
            integral += u[k] - raw
        last_e = error
    return u, y


def drawn(seed: int) -> Loop:
    """A loop drawn at random: kind of law, sum, wind-up, derivative, start, plant, noise, rounding, hand and limits."""
    rng = np.random.default_rng(seed)
    lag, dead = rng.uniform(30, 90), int(rng.integers(3, 12))
    gain = rng.choice([-1, 1]) * rng.uniform(0.4, 2.0)
    speed = rng.uniform(0.6, 2.5) * dead + 2
    kind = ("P", "PI", "PID")[seed % 3]
    law = Law(
        Kc=float(lag / gain / (speed + dead)) * (0.8 if kind == "PID" else 1.0),
        Ti=0.0 if kind == "P" else float(min(lag, 4 * (speed + dead))),
        Td=float(max(dead / 2, 1.0)) if kind == "PID" else 0.0,
        alpha=float(rng.uniform(0.1, 0.4)),
        sum=SUMS[(seed // 3) % 3],
        windup=WINDUPS[(seed // 9) % 5],
        derivative_on=("error", "pv")[seed // 45 % 2],
        start=STARTS[seed // 90 % 2],
    )
    size = rng.uniform(3, 10)
    noise = size * rng.uniform(0.02, 0.15)
    loud = abs(law.Kc) * noise * (1 + law.Td / (law.alpha * law.Td + 1))
    reach = size / abs(gain) * rng.uniform(1.2, 3.0) + 3 * loud
    samples = int(rng.integers(2000, 5000))
    begins = np.sort(rng.choice(np.arange(1, 8), 2, replace=False)) * samples // 8
    return Loop(
        law,
        gain=float(gain),
        lag=float(lag),
        dead_time=dead,
        samples=samples,
        limits=(50 - float(reach), 50 + float(reach)),
        size=float(size),
        every=float(rng.uniform(80, 300)),
        noise=float(noise),
        pole=float(rng.choice([0.0, 0.5, 0.9])),
        op_digits=float(rng.choice([0.1, 0.01, 0.001])),
        pv_digits=float(noise * rng.choice([0.02, 0.2, 1.0])),
        manual=tuple((int(b), int(b + rng.integers(50, 200))) for b in begins),
        bad=0.0025,
        offset=float(rng.choice([0.0, 1.0, 3.0]) * size),
        seed=seed,
    )
