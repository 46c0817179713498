"""Declared first order, and what the plant really is: is the structure rejected, named, and the gain covered?

Simulated single loops under PI, set-point switching at random, AR(1) disturbance. Run with a number of seeds; with
`--kept` the first order is kept whatever the record says, as it is where a project asks for it. Time is how long the
plant takes to answer, its mean residence time: lag and dead time of the first order.

    python benchmarks/bench_structures.py 200 [--kept]
"""

from __future__ import annotations

import argparse
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from trueplant.identify import identify_matrix, specs_of
from trueplant.loop import PID, Controller, simulate
from trueplant.lti import TransferMatrix
from trueplant.record.types import Segment

SAMPLES, STEP, NOISE = 2000, 1.0, 0.1
CASES = {
    "first order": ("2 exp(-3 s)/(12 s + 1)", ("fopdt",)),
    "inverse response, lead -1.5": ("2 (-1.5 s + 1) exp(-3 s)/((12 s + 1)(5 s + 1))", ("sopdt+lead", "sopdt")),
    "inverse response, lead -4": ("2 (-4 s + 1) exp(-3 s)/((12 s + 1)(5 s + 1))", ("sopdt+lead",)),
    "second lag": ("2 exp(-3 s)/((12 s + 1)(8 s + 1))", ("sopdt",)),
    "complex pair": ("2 exp(-3 s)/(100 s^2 + 10 s + 1)", ("pair",)),
    "slow tail": ("2 (70 s + 1) exp(-2 s)/((10 s + 1)(100 s + 1))", ("sopdt+lead",)),
}
"""The plant, and the structures that count as right."""


@dataclass(frozen=True)
class Answer:
    structure: str
    covered: bool
    apart: float
    """Error of the gain in standard errors."""
    time: float
    """That of the time that the plant takes to answer."""


TIMES = {
    "first order": 15.0,
    "inverse response, lead -1.5": 21.5,
    "inverse response, lead -4": 24.0,
    "second lag": 23.0,
    "complex pair": 13.0,
    "slow tail": 42.0,
}
"""Lags and dead time less leads."""


def answer(case: str, seed: int, kept: bool) -> Answer:
    rng = np.random.default_rng([seed, sorted(CASES).index(case)])
    flips = rng.random((SAMPLES, 1)) < 1 / 40.0
    flips[:5] = False
    r = 1 - (-1.0) ** np.cumsum(flips, axis=0)
    v = lfilter([np.sqrt(1 - 0.8**2)], [1, -0.8], NOISE * rng.standard_normal((SAMPLES + 200, 1)), axis=0)[200:]
    plant = TransferMatrix.of([[CASES[case][0]]], "min")
    model = TransferMatrix.of([["2 exp(-5 s)/(15 s + 1)"]], "min")
    done = simulate(plant, Controller.diagonal([PID(Kc=0.3, Ti=12.0, sample_time=STEP)]), r, STEP, v=v)
    n, m = done.u.shape
    free = np.ones((n, m), dtype=bool)
    record = Segment(0, done.h, done.t, done.r, done.u, done.y, np.zeros((n, 0)), free, ("zoh",) * m)
    found = identify_matrix([record], model, specs_of(model), structures=not kept)[0]
    low, high = found.intervals[0]
    error = abs(found.theta[0] - 2) / np.sqrt(found.covariance[0, 0])
    structure = found.row.specs[0].structure
    by = np.where(structure.is_lag | structure.is_dead_time, 1.0, np.where(structure.is_lead, -1.0, 0.0))
    time = (by @ found.theta - TIMES[case]) / np.sqrt(by @ found.covariance @ by)
    return Answer(str(structure), bool(low <= 2 <= high), float(error), float(np.abs(time)))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("seeds", type=int, nargs="?", default=40)
    parser.add_argument("--kept", action="store_true")
    options = parser.parse_args()
    heads = ("rejected", "named", "gain covered", "beyond 4 s.e.", "time covered")
    print(f"{'plant':<30}" + "".join(f"{head:>15}" for head in heads) + "   structures")
    with ProcessPoolExecutor() as pool:
        for case, (_, right) in CASES.items():
            answers = list(
                pool.map(answer, [case] * options.seeds, range(options.seeds), [options.kept] * options.seeds)
            )
            names = [a.structure for a in answers]
            counts = {name: names.count(name) for name in sorted(set(names), key=lambda one: -names.count(one))}
            shares = (
                np.mean([name != "fopdt" for name in names]),
                np.mean([name in right for name in names]),
                np.mean([a.covered for a in answers]),
                np.mean([a.apart > 4 for a in answers]),
                # of a pair the frequency and the damping say it, which are no times
                np.mean([a.time < 1.96 for a in answers]) if options.kept else np.nan,
            )
            print(f"{case:<30}" + "".join(f"{share:>15.1%}" for share in shares) + f"   {counts}", flush=True)


if __name__ == "__main__":
    main()
