"""Records that end before the plant has settled: is the gain at rest covered, is it answered?

Simulated single loops under PI, set-point switching at random, the model of first order. Two plants: one owes nine
tenths of its gain to a lag of 250 s, the other has two slow lags and a lead between them. Records are 1 to 8 times
250 s long. Noise is AR(1) with pole 0.8, or slow: pole 0.99, four times as large.

    python benchmarks/bench_short_records.py [--records 40] [--first 0] [--workers 2]
"""

from __future__ import annotations

import argparse
import os
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from itertools import product
from multiprocessing import get_context

os.environ["OPENBLAS_NUM_THREADS"] = "1"

import numpy as np
from scipy.signal import lfilter

from trueplant.identify import identify_matrix, specs_of, unanswered
from trueplant.loop import PID, Controller, simulate
from trueplant.lti import TransferMatrix
from trueplant.record.types import Segment

PLANTS = {
    "one slow lag": "0.65 (34 s + 1) exp(-0.5 s)/((250 s + 1)(10 s + 1))",
    "two slow lags": "0.65 (250 s + 1)(30 s + 1) exp(-0.5 s)/((400 s + 1)(150 s + 1)(8 s + 1))",
}
GAIN, MODEL = 0.65, "0.8 exp(-2 s)/(200 s + 1)"
LENGTHS = (250, 500, 1000, 2000)
NOISE = {"fast": (0.8, 0.005), "slow": (0.99, 0.02)}
"""Pole, and standard deviation."""


@dataclass(frozen=True)
class Answer:
    structure: str
    covered: bool
    given: bool
    width: float
    """Of the interval, relative to the gain."""


def answer(plant: str, noise: str, samples: int, seed: int) -> Answer:
    rng = np.random.default_rng(
        [seed, samples, *(sorted(of).index(one) for of, one in ((PLANTS, plant), (NOISE, noise)))]
    )
    flips = rng.random((samples, 1)) < 1 / 60
    flips[:5] = False
    pole, std = NOISE[noise]
    v = lfilter([np.sqrt(1 - pole**2)], [1, -pole], std * rng.standard_normal((samples + 2000, 1)), axis=0)[2000:]
    law = Controller.diagonal([PID(Kc=4.0, Ti=40.0, sample_time=1.0)])
    r = 1 - (-1.0) ** np.cumsum(flips, axis=0)
    done = simulate(TransferMatrix.of([[PLANTS[plant]]], "s"), law, r, 1.0, v=v)
    free, model = np.ones((samples, 1), dtype=bool), TransferMatrix.of([[MODEL]], "s")
    record = Segment(0, done.h, done.t, done.r, done.u, done.y, np.zeros((samples, 0)), free, ("zoh",))
    found = identify_matrix([record], model, specs_of(model), structures=True)[0]
    low, high = found.intervals[0]
    given = 0 not in unanswered(found)
    return Answer(str(found.row.specs[0].structure), bool(low <= GAIN <= high), given, float(high - low) / GAIN)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--records", type=int, default=40)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--workers", type=int, default=2)
    options = parser.parse_args()
    seeds = range(options.first, options.first + options.records)
    heads = ("covered", "given", "given, not covered", "width")
    print(f"{'plant':<16}{'noise':<8}{'samples':<8}" + "".join(f"{head:>20}" for head in heads) + "   structures")
    with ProcessPoolExecutor(options.workers, mp_context=get_context("spawn")) as pool:
        for plant, noise, samples in product(PLANTS, NOISE, LENGTHS):
            answers = list(pool.map(partial(answer, plant, noise, samples), seeds))
            names = [one.structure for one in answers]
            counts = (
                sum(one.covered for one in answers),
                sum(one.given for one in answers),
                sum(one.given and not one.covered for one in answers),
            )
            width = np.median([one.width for one in answers])
            kinds = {name: names.count(name) for name in sorted(set(names), key=lambda one: -names.count(one))}
            row = "".join(f"{count:>20}" for count in counts)
            print(f"{plant:<16}{noise:<8}{samples:<8}{row}{width:>20.0%}   {kinds}", flush=True)


if __name__ == "__main__":
    main()
