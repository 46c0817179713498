"""Several experiments of one simulated rig whose plant differs from run to run: is the common answer the better one?

One loop (2 exp(-4.6 s)/(10 s + 1) under a PI, h = 1 min, 600 samples a run, set-point switching at random, AR(1)
disturbance with a pole of 0.9). Gains of the runs differ from the rig's mean by one relative spread and lags and dead
times by another, both drawn from the prior of the method (half-normal, 10 %) or, with --spread, as large as said.
Prints for 2 to 6 runs the rms error of the common answer about the rig's mean plant, relative to that of the best of
its single runs (the place in the order of runs whose answers are closest over all records), and how often its 95 %
intervals cover.

    python benchmarks/bench_repeats.py [--records 200] [--first 0] [--spread 0.1] [--workers 2]
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial
from multiprocessing import get_context
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))

from support.simulated import coloured, random_switching, segment_of
from trueplant.identify import OutputEstimate, identify_matrix, levels, specs_of
from trueplant.loop import PID, Controller, simulate
from trueplant.lti import Structure, TransferMatrix
from trueplant.record import Segment

SAMPLES = 600
FOPDT = Structure.parse("fopdt")
RIG = np.array([2.0, 10.0, 4.6])
"""Mean gain, lag and dead time of the runs."""
IS_GAIN = np.array([True, False, False])
LAW = Controller.diagonal([PID(Kc=0.3, Ti=15.0, sample_time=1.0)])
MODEL = TransferMatrix(((FOPDT.transfer(RIG * np.array([1.2, 0.8, 1.3])),),), "min")
RUNS = range(2, 7)


def experiments(rng: np.random.Generator, runs: int, spread: float | None) -> list[Segment]:
    """The records of so many runs of one rig."""
    spreads = np.abs(rng.normal(0, levels.BETWEEN_RUNS, 2)) if spread is None else np.full(2, spread)
    found = []
    for k in range(runs):
        own = RIG * np.exp(np.where(IS_GAIN, *spreads) * rng.standard_normal(3))
        plant = TransferMatrix(((FOPDT.transfer(own),),), "min")
        r = random_switching(rng, SAMPLES, 1, 60.0)
        record = simulate(plant, LAW, r, 1.0, v=coloured(rng, SAMPLES, 1, [1, -0.9], [1], 0.15))
        found.append(replace(segment_of(record), experiment=k))
    return found


def estimated(segments: Sequence[Segment]) -> OutputEstimate:
    return identify_matrix(segments, MODEL, specs_of(MODEL))[0]


def answer(runs: int, spread: float | None, seed: int) -> np.ndarray:
    """(runs + 2, 3) relative errors of the single runs, then of the common answer, and does it cover?"""
    segments = experiments(np.random.default_rng([seed, runs]), runs, spread)
    common = estimated(segments)
    singles = [estimated([segment]).theta / RIG - 1 for segment in segments]
    covers = (common.intervals[:, 0] <= RIG) & (common.intervals[:, 1] >= RIG)
    return np.array([*singles, common.theta / RIG - 1, covers])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--records", type=int, default=200)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--spread", type=float)
    parser.add_argument("--workers", type=int, default=2)
    options = parser.parse_args()
    seeds = range(options.first, options.first + options.records)
    print(f"{options.records} simulated records a line, seeds {options.first} on: gain, lag, dead time")
    with ProcessPoolExecutor(options.workers, mp_context=get_context("spawn")) as pool:
        for runs in RUNS:
            found = np.array(list(pool.map(partial(answer, runs, options.spread), seeds, chunksize=4)))
            rms = np.sqrt(np.mean(found[:, : runs + 1] ** 2, axis=0))
            ratio, covered = rms[runs] / rms[:runs].min(axis=0), found[:, runs + 1].mean(axis=0)
            shares = "  ".join(f"{100 * share:5.1f}" for share in covered)
            print(f"{runs} runs: rms over the best single run's {ratio.round(2)}, covered {shares} %", flush=True)


if __name__ == "__main__":
    main()
