"""The paper's splitter column: errors against the Cramer-Rao bound, coverage, and the paper's own route beside ours.

Simulated from (40): h = 0.1 min, 5 h, six set-point steps 50 min apart that take turns between the loops, noise scaled
so that the true plant's own fit is that of Table 5. White noise, and half of its variance a slow disturbance (5 min).
Everything is found from the record: structure as in the model (41), dead times, order of the noise model.

    python benchmarks/bench_splitter.py [--seeds 100] [--kind white|slow]
"""

from __future__ import annotations

import argparse
import time
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context

import numpy as np

from trueplant.paper.montecarlo import NAMES, Estimates, bound_percent, estimate, percent, ratio_to_bound, together
from trueplant.paper.records import KINDS, case, noise_std, parameters


def table(runs: Estimates) -> None:
    off, route, ratio = percent(runs.ours), percent(runs.route), ratio_to_bound(runs)
    rms = np.sqrt(np.mean(off**2, axis=0))
    bound = bound_percent(runs)
    claimed = np.sqrt(np.mean((runs.std * percent_per_unit()) ** 2, axis=0))
    columns = ("median %", "rms %", "bound %", "rms/bound", "coverage", "s.e./rms", "route med %", "route rms %")
    print(f"{'':8}" + "".join(f"{c:>12}" for c in columns))
    for k, name in enumerate(NAMES):
        row = (
            np.median(off[:, k]),
            rms[k],
            bound[k],
            ratio[k],
            runs.inside[:, k].mean(),
            claimed[k] / max(rms[k], 1e-300),
            np.median(route[:, k]),
            np.sqrt(np.mean(route[:, k] ** 2)),
        )
        print(f"{name:8}" + "".join(f"{x:12.3f}" if x < 1e4 else f"{x:12.1e}" for x in row))
    for what, picks in (("gains", [0, 3, 6]), ("time constants", [1, 4, 7])):
        print(
            f"{what}: median error {np.median(off[:, picks]):.2f} %, route {np.median(route[:, picks[:2]]):.1f} % "
            f"(row 1)"
        )
    print(f"orders of the noise model, outputs 1 and 2: medians {np.median(runs.orders, axis=0)}")


def percent_per_unit() -> np.ndarray:
    """What one unit of each parameter is in per cent of the true value."""
    return percent(parameters(case().plant) + 1.0)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=100)
    parser.add_argument("--kind", choices=sorted(KINDS), action="append")
    options = parser.parse_args()
    for kind in options.kind or list(KINDS):
        begun = time.perf_counter()
        with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
            runs = together(pool.map(partial(estimate, kind), range(options.seeds), chunksize=5))
        seconds = time.perf_counter() - begun
        print(f"{options.seeds} simulated records, seeds 0 on: {KINDS[kind]}")
        print(
            f"noise of standard deviation {noise_std(kind)[0]:.4f} and {noise_std(kind)[1]:.4f}; steps between -1 and 1"
        )
        table(runs)
        print(f"{seconds:.0f} s on two cores\n")


if __name__ == "__main__":
    main()
