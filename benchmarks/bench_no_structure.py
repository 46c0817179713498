"""Plants that no structure describes: does the interval of the gain reach them, is it given?

Simulated single loops under PI, set-point switching at random, the model of first order, no structure declared. A bar
that conducts heat has lags without end. A heater's power goes with the square of OP, and an oven cools more slowly than
it warms: these have no one gain or lag, and an interval is right that reaches gains of OP's range (5 to 95 %). Counted
apart are records whose prediction errors follow OP whatever structure is taken, without and with what their halves say.

    python benchmarks/bench_no_structure.py [--records 40] [--first 0] [--samples 1000] [--workers 2]
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from itertools import product
from multiprocessing import get_context

os.environ["OPENBLAS_NUM_THREADS"] = "1"

import numpy as np
from numba import njit
from scipy.signal import lfilter

from trueplant.identify import OutputEstimate, counting_halves, identify_matrix, specs_of, unanswered
from trueplant.identify.levels import UNDERMODELLED
from trueplant.lti import TransferMatrix
from trueplant.record.types import Segment

PLANTS = ("bar", "square of OP", "cools slowly")
NOISE = {"quiet": 0.01, "loud": 0.05}
"""Standard deviation of the innovations, where PV moves by 2; AR(1) with pole 0.8."""
LAG, DELAY, MODES = 60.0, 3, 40
KC, TI = 2.0, 50.0
MODEL = "1 exp(-10 s)/(50 s + 1)"


@njit
def simulated(r, v, shares, decays, square, slowness):
    """OP and PV of the loop: modes in parallel, what OP drives them by, PI; gain at rest 1, samples of 1 s."""
    n, x = r.size, np.zeros(shares.size)
    u, y, drives, total = np.zeros(n), np.zeros(n), np.zeros(n), 0.0
    for k in range(n):
        y[k] = (shares * x).sum() + v[k]
        e = r[k] - y[k]
        total += KC / TI * e
        u[k] = KC * e + total
        drives[k] = u[k] + square * u[k] ** 2
        drive = drives[k - DELAY] if k >= DELAY else 0.0
        x = x + (1 - decays ** (1 / slowness if drive < x[0] else 1.0)) * (drive - x)
    return u, y


@dataclass(frozen=True)
class Said:
    reached: bool
    given: bool
    width: float

    @classmethod
    def of(cls, estimate: OutputEstimate, gains: np.ndarray) -> Said:
        low, high = estimate.intervals[0]
        return cls(bool(low <= gains[1] and high >= gains[0]), 0 not in unanswered(estimate), float(high - low))


def answer(plant: str, noise: str, samples: int, seed: int) -> tuple[bool, Said, Said]:
    """Do the prediction errors follow OP, and what is said without and with the halves."""
    rng = np.random.default_rng([seed, samples, PLANTS.index(plant), sorted(NOISE).index(noise)])
    flips = rng.random(samples) < 1 / 80
    flips[:5] = False
    r = 1 - (-1.0) ** np.cumsum(flips)
    v = lfilter([0.6], [1, -0.8], NOISE[noise] * rng.standard_normal(samples + 200))[200:]
    shares, lags = np.array([1.0]), np.array([LAG])
    if plant == "bar":
        k = np.arange(MODES)
        roots = ((k + 0.5) * np.pi) ** 2
        shares, lags = (-1.0) ** k * np.pi * (2 * k + 1) / roots, 3 * LAG / roots
        shares[-1] /= 2  # the series goes up and down by less and less: it ends at its mean
    square, slowness = 0.15 * (plant == "square of OP"), 1.0 + 0.7 * (plant == "cools slowly")
    u, y = simulated(r, v, shares, np.exp(-1 / lags), square, slowness)
    free, model = np.ones((samples, 1), dtype=bool), TransferMatrix.of([[MODEL]], "s")
    columns = (x[:, None] for x in (r, u, y))
    record = Segment(0, 1.0, np.arange(samples) * 1.0, *columns, np.zeros((samples, 0)), free, ("zoh",))
    plain = identify_matrix([record], model, specs_of(model), structures=True)[0]
    gains = 1 + 2 * square * np.quantile(u, [0.05, 0.95])
    follows = bool(np.min(plain.cross_p) < UNDERMODELLED)
    return follows, Said.of(plain, gains), Said.of(counting_halves(plain, 0.95), gains)


def line(some: Sequence[Said]) -> str:
    width = np.median([one.width for one in some]) if some else np.nan
    return f"{len(some):8}{sum(one.reached for one in some):9}{sum(one.given for one in some):7}{width:8.3f}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--records", type=int, default=40)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--samples", type=int, default=1000)
    parser.add_argument("--workers", type=int, default=2)
    options = parser.parse_args()
    seeds = range(options.first, options.first + options.records)
    print(f"{options.records} simulated records of {options.samples} samples a line, seeds {options.first} on")
    print(f"{'':22}" + "".join(f"{head:>32}" for head in ("suffices", "follow, without halves", "with halves")))
    print(f"{'plant':14}{'noise':8}" + 3 * f"{'records':>8}{'reached':>9}{'given':>7}{'width':>8}")
    with ProcessPoolExecutor(options.workers, mp_context=get_context("spawn")) as pool:
        for plant, noise in product(PLANTS, NOISE):
            every = list(pool.map(partial(answer, plant, noise, options.samples), seeds))
            groups = [without for follows, without, _ in every if not follows]
            followed = [one for one in every if one[0]]
            parts = groups, [one[1] for one in followed], [one[2] for one in followed]
            print(f"{plant:14}{noise:8}" + "".join(map(line, parts)), flush=True)


if __name__ == "__main__":
    main()
