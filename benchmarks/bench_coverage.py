"""Coverage of the 95 % intervals where the assumptions of the fit do not hold.

Simulated Wood-Berry under BLT PI, both set-points switching at random, h = 1 min, dead times off the grid. Prints, for
each condition, the coverage of every parameter's interval and how many were left unanswered.

    python benchmarks/bench_coverage.py [--runs 1000] [--only CONDITION]
"""

from __future__ import annotations

import argparse
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))

from support.simulated import BLT, WOOD_BERRY, coloured, random_switching, segment_of
from trueplant import plants
from trueplant.identify import identify_matrix, specs_of, unanswered
from trueplant.loop import simulate
from trueplant.lti import TransferMatrix, tf
from trueplant.lti.sampled import sampled_response
from trueplant.lti.structure import Structure, structure_of
from trueplant.record.types import Segment

FOPDT = Structure.parse("fopdt")
STD = 0.3
STEP = 2.0
AR1 = ([1, -0.8], [1])
ARMA = ([1, -1.5, 0.6], [1, -0.4])
RESONANT = ([1, -1.8, 0.95], [1, 0.5, 0.2])
LONG_MEMORY = ([1.0], list(np.r_[1, 0.4 * np.arange(1, 60) ** -0.6]))
FEED = plants.wood_berry().disturbance
LIMITS = np.array([[-0.5, 0.5], [-0.2, 0.12]])
"""Of both OPs, so that each is at a limit for about a tenth of the samples."""


def segment(seed: int, condition: str, samples: int = 4000) -> Segment:
    """One simulated record under the condition."""
    rng = np.random.default_rng(seed)
    r = random_switching(rng, samples, 2, 20.0)
    colour = {"arma": ARMA, "resonant": RESONANT, "long memory": LONG_MEMORY}.get(condition, AR1)
    std = 0.06 if condition == "quantised, little noise" else STD
    v = coloured(rng, samples, 2, *colour, std)
    if condition == "crossed":
        feed = coloured(rng, samples, 1, [1, -0.9], [1], 0.3)[:, 0]
        v = np.column_stack([sampled_response(FEED[i, 0], feed, 1.0, "linear") for i in range(2)])
        v += coloured(rng, samples, 2, [1], [1], 0.05)
    if condition == "saturated":
        simulation = simulate(WOOD_BERRY, BLT, r, 1.0, v=v, limits=LIMITS)
        free = (simulation.u > LIMITS[:, 0]) & (simulation.u < LIMITS[:, 1])
        return replace(segment_of(simulation), free=free)
    simulation = simulate(WOOD_BERRY, BLT, r, 1.0, v=v)
    found = segment_of(simulation)
    if condition.startswith("quantised"):
        step = STEP / 10
        return replace(found, y=np.round(found.y / step) * step)
    return found


CONDITIONS = (
    "ar1",
    "arma",
    "resonant",
    "long memory",
    "quantised",
    "quantised, little noise",
    "saturated",
    "missing",
    "crossed",
    "gaps",
)


def pieces(record: Segment, condition: str) -> list[Segment]:
    """The record whole, or without 8 of every 60 samples."""
    if condition != "gaps":
        return [record]
    names = ("t", "r", "u", "y", "d", "free")
    spans = [slice(first, first + 52) for first in range(0, len(record.t), 60)]
    return [replace(record, **{name: getattr(record, name)[span] for name in names}) for span in spans]


def run(job: tuple[int, str]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Errors, hits of the intervals, and which parameters were answered."""
    seed, condition = job
    records = pieces(segment(seed, condition, 1000 if condition == "gaps" else 4000), condition)
    wrong = [[1.3, 0.7, 1.5], [1.3, 0.7, 1.5]]
    truth = [[structure_of(WOOD_BERRY[i, j])[1] for j in range(2)] for i in range(2)]
    lacks = [(0, 1), (1, 0)] if condition == "missing" else []
    model = TransferMatrix(
        tuple(
            tuple(tf(0.0) if (i, j) in lacks else FOPDT.transfer(truth[i][j] * wrong[j]) for j in range(2))
            for i in range(2)
        ),
        "min",
    )
    errors, hits, told = np.full((3, 12), np.nan)
    for i, estimate in identify_matrix(records, model, specs_of(model)).items():
        reasons = unanswered(estimate)
        for spec, part in zip(estimate.row.specs, estimate.row.slices, strict=True):
            true = truth[i][spec.column]
            place = slice(6 * i + 3 * spec.column, 6 * i + 3 * spec.column + 3)
            low, high = estimate.intervals[part].T
            errors[place] = estimate.theta[part] - true
            hits[place] = (low <= true) & (true <= high)
            told[place] = [k not in reasons for k in range(part.start, part.stop)]
    return errors, hits, np.nan_to_num(told)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=1000)
    parser.add_argument("--only", choices=CONDITIONS)
    options = parser.parse_args()
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        for condition in [options.only] if options.only else CONDITIONS:
            begun = time.perf_counter()
            jobs = [(30_000 + k, condition) for k in range(options.runs)]
            errors, hits, told = (np.array(x) for x in zip(*pool.map(run, jobs, chunksize=5), strict=True))
            covered = np.array([hits[told[:, k] > 0, k].mean() for k in range(hits.shape[1])])
            print(
                f"{condition:24} coverage {covered.min():.3f} to {covered.max():.3f}, answered {told.mean():.3f} "
                f"({options.runs} simulated runs, {time.perf_counter() - begun:.0f} s)"
            )
            print(" " * 25 + " ".join(f"{c:.3f}" for c in covered), flush=True)
            bias = np.nanmean(errors, axis=0) / np.nanstd(errors, axis=0)
            print(" " * 25 + "bias/std " + " ".join(f"{x:.2f}" for x in bias), flush=True)


if __name__ == "__main__":
    main()
