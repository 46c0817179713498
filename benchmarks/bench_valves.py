"""Valves with backlash, stick-slip or an end that OP goes beyond: how often they are named, how wide a band is found,
what is known of the plant.

Simulated: one loop, K = 2, lag 10 min, dead time 3.3 min, h = 1 min, PI by SIMC, its set-point switching at random
by 2 about every 40 min, AR(1) disturbance with a pole of 0.8. Bands are relative to the span of OP; an end lies where
OP would be beyond it in a share of the samples if it were not there (as the controller goes on it is in more), and OP
has limits a little wider than it would need. Prints, for each valve and size of the disturbance, how often a valve of
that kind is named, how often its band, or the part of OP's range beyond its end, is within 20 %, and how often the
intervals of gain, lag and dead time cover, with the valve where it is named.

    python benchmarks/bench_valves.py [--runs 200] [--samples 2000]
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))

from support.simulated import coloured, random_switching, segment_of
from trueplant.identify import (
    behind_valves,
    identify_matrix,
    over_open_valves,
    specs_of,
    sticking,
    try_valves,
    widened_for_bands,
)
from trueplant.loop import PID, Controller, Valve, simulate
from trueplant.lti import TransferMatrix

PLANT = TransferMatrix.of([["2 exp(-3.3 s)/(10 s + 1)"]], "min")
TRUTH = np.array([2.0, 10.0, 3.3])
LAW = Controller.diagonal([PID(Kc=0.66, Ti=10.0, sample_time=1.0)])
CASES = {
    "none": {},
    "backlash of 1 %": {"backlash": 0.01},
    "backlash of 2 %": {"backlash": 0.02},
    "backlash of 5 %": {"backlash": 0.05},
    "stick-slip of 2 %": {"stick": 0.02},
    "stick-slip of 5 %": {"stick": 0.05},
    "upper end, 3 %": {"high": 0.03},
    "upper end, 10 %": {"high": 0.1},
    "upper end, 25 %": {"high": 0.25},
    "lower end, 10 %": {"low": 0.1},
}


def run(job: tuple[int, int, str, float]) -> tuple[bool, float, np.ndarray]:
    """Is a valve of the right kind named (any, where there is none), its band over the true one, what is covered."""
    seed, samples, case, std = job
    rng = np.random.default_rng(seed)
    r, v = random_switching(rng, samples, 1, 40.0), coloured(rng, samples, 1, [1, -0.8], [1], std)
    still = simulate(PLANT, LAW, r, 1.0, v=v)
    span, limits = (float(still.u.min()), float(still.u.max())), None
    given = {name: share * (span[1] - span[0]) for name, share in CASES[case].items()}
    if ends := given.keys() & {"low", "high"}:
        (side,), (share,) = ends, CASES[case].values()
        given = {side: float(np.quantile(still.u, share if side == "low" else 1 - share))}
        limits = (span[0] - 1.0, span[1] + 1.0)
    segments = (segment_of(simulate(PLANT, LAW, r, 1.0, v=v, valves=[Valve(**given)], limits=limits)),)
    estimates = identify_matrix(segments, PLANT, specs_of(PLANT))
    tried = try_valves(estimates, [0])
    if found := sticking(tried):
        estimates = identify_matrix(behind_valves(segments, found), PLANT, specs_of(PLANT))
        estimates = widened_for_bands(estimates, found, 0.95)
    else:
        estimates = over_open_valves(estimates, tried, 0.95)
    low, high = estimates[0].intervals.T
    covered = (low <= TRUTH) & (high >= TRUTH)
    if not given or not found:
        return bool(found), np.nan, covered
    name, (valve,) = next(iter(given)), found.values()
    own, true = (_width(one, name, segments[0].u) for one in (valve.valve, Valve(**given)))
    return own > 0, own / true, covered


def _width(valve: Valve, name: str, op: np.ndarray) -> float:
    """Of a band, or of the part of OP's range beyond an end; 0 of another kind of valve."""
    if name in ("low", "high"):
        return float(max(op.max() - valve.high, valve.low - op.min(), 0.0))
    return float(getattr(valve, name))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=200)
    parser.add_argument("--samples", type=int, default=2000)
    options = parser.parse_args()
    for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
        os.environ[name] = "1"
    begun = time.perf_counter()
    print(f"{options.runs} simulated records of {options.samples} samples each, seeds 0 on")
    print(f"{'valve':20}{'disturbance':>12}{'named %':>9}{'band %':>8}{'gain %':>8}{'lag %':>8}{'dead %':>8}")
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        for case in CASES:
            for std in (0.02, 0.1):
                jobs = [(seed, options.samples, case, std) for seed in range(options.runs)]
                named, band, covered = (np.array(x) for x in zip(*pool.map(run, jobs, chunksize=10), strict=True))
                right = 100 * np.mean(np.abs(band[named] - 1) < 0.2) if CASES[case] and named.any() else np.nan
                shares = "".join(f"{100 * share:8.1f}" for share in covered.mean(axis=0))
                print(f"{case:20}{std:12.2f}{100 * named.mean():9.1f}{right:8.1f}{shares}", flush=True)
    print(f"{time.perf_counter() - begun:.0f} s")


if __name__ == "__main__":
    main()
