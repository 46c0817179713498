"""What an estimate costs, as a multiple of one pass of real FFTs, and how time and memory grow with the record.

Simulated: Wood-Berry under BLT PI, both set-points switching at random, AR(1) disturbance. There are two ways to have
more samples: "longer" records at h = 1 min, or "finer" ones of the same 10,000 min. Estimated are both rows with their
covariance (`identify_matrix` on the segment, the model a third off); beside it one `scipy.fft.rfft` over each of the
six channels, in the same process. Times are CPU times on one thread, which other work on the machine disturbs less than
it does the clock. Each size has a process of its own; "more memory" is by how much its largest resident memory exceeds
that before the estimate. Sizes that take longer than the limit are given up, and said.

    python benchmarks/bench_scaling.py [--sizes 10000 ... 1000000] [--limit 300] [--way longer|finer]
"""

from __future__ import annotations

import argparse
import os
import resource
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))

from support.simulated import WOOD_BERRY, coloured, random_switching, segment_of
from trueplant.identify import identify_matrix, specs_of
from trueplant.loop import PID, Controller, simulate
from trueplant.lti import TransferMatrix
from trueplant.lti.structure import Structure, structure_of
from trueplant.record.types import Segment

SIZES = (10_000, 30_000, 100_000, 300_000, 1_000_000)
SPAN = 10_000.0
"""Of the finer records, in min."""
FOPDT = Structure.parse("fopdt")


def record(samples: int, way: str, seed: int = 1) -> Segment:
    """A record of so many samples: longer at 1 min, or finer over the same time."""
    h = 1.0 if way == "longer" else SPAN / samples
    rng = np.random.default_rng(seed)
    law = [PID(Kc=0.375, Ti=8.29, sample_time=h), PID(Kc=-0.0754, Ti=23.6, sample_time=h)]
    r = random_switching(rng, samples, 2, 20.0 / h)
    v = coloured(rng, samples, 2, [1, -(0.8**h)], [1], 0.3)
    return segment_of(simulate(WOOD_BERRY, Controller.diagonal(law), r, h, v=v))


def estimate(segment: Segment) -> float:
    """The largest error of the twelve parameters in its standard errors."""
    wrong = np.array([1.3, 0.7, 1.5])
    truth = [[structure_of(WOOD_BERRY[i, j])[1] for j in range(2)] for i in range(2)]
    model = TransferMatrix(tuple(tuple(FOPDT.transfer(p * wrong) for p in row) for row in truth), "min")
    found = identify_matrix([segment], model, specs_of(model))
    errors = [found[i].theta[:6] - np.concatenate(truth[i]) for i in range(2)]
    sizes = [np.sqrt(np.diag(found[i].covariance)[:6]) for i in range(2)]
    return float(np.max(np.abs(np.divide(errors, sizes))))


def transforms(segment: Segment) -> float:
    """Median CPU time in s of one real FFT over each channel."""
    from scipy.fft import rfft

    channels = [np.ascontiguousarray(x) for x in np.hstack([segment.r, segment.u, segment.y]).T]
    times = []
    for _ in range(5):
        begun = time.process_time()
        for x in channels:
            rfft(x)
        times.append(time.process_time() - begun)
    return float(np.median(times))


def megabytes() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def one(samples: int, way: str) -> None:
    """CPU time and memory of one size, in this process."""
    estimate(record(3000, way))  # compiled code is read, pools are filled
    segment = record(samples, way)
    segment = replace(segment, **{name: np.ascontiguousarray(getattr(segment, name)) for name in "ruy"})
    channels = sum(getattr(segment, name).nbytes for name in "ruy") / 2**20
    fft = transforms(segment)
    before = megabytes()
    times = []
    for _ in range(3 if samples <= 30_000 else 1):
        begun = time.process_time()
        worst = estimate(segment)
        times.append(time.process_time() - begun)
    seconds = float(np.median(times))
    print(
        f"{way:8}{samples:>11,}{seconds:>10.2f}{1e6 * seconds / samples:>10.2f}{1000 * fft:>10.2f}"
        f"{seconds / fft:>9.0f}{channels:>10.1f}{megabytes() - before:>12.0f}{worst:>9.1f}{os.getloadavg()[0]:>7.1f}",
        flush=True,
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sizes", type=int, nargs="+", default=SIZES)
    parser.add_argument("--way", choices=["longer", "finer"])
    parser.add_argument("--limit", type=float, default=300.0, help="s a size")
    parser.add_argument("--one", action="store_true", help="the first size only, in this process")
    options = parser.parse_args()
    if options.one:
        one(options.sizes[0], options.way)
        return
    heads = {"samples": 11, "time": 10, "a sample": 10, "FFTs": 10, "ratio": 9, "data": 10, "more memory": 12}
    heads |= {"worst": 9, "load": 7}
    print(" " * 8 + "".join(f"{name:>{wide}}" for name, wide in heads.items()))
    print(f"{'':19}{'s':>10}{'us':>10}{'ms':>10}{'':>9}{'MB':>10}{'MB':>12}{'s.e.':>9}")
    alone = os.environ | {name: "1" for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")}
    for way in [options.way] if options.way else ["longer", "finer"]:
        for samples in options.sizes:
            command = [sys.executable, __file__, "--one", "--way", way, "--sizes", str(samples)]
            try:
                done = subprocess.run(command, timeout=options.limit, capture_output=True, text=True, env=alone)
            except subprocess.TimeoutExpired:
                print(f"{way:8}{samples:>11,}  not within {options.limit:g} s; larger sizes not tried", flush=True)
                break
            if done.returncode:
                print(f"{way:8}{samples:>11,}  {done.stderr.splitlines()[-1]}", flush=True)
                break
            print(done.stdout, end="", flush=True)


if __name__ == "__main__":
    main()
