"""Coverage of the 95 % intervals of a whole analysis where disturbances are measured, or estimated along.

Simulated Wood-Berry under BLT PI with one gain 30 % higher than the model's, h = 1 min, set-points switching at random.
"step": unmeasured load steps of four times the set-points' moves, declared as steps; "drift": slopes that wander,
declared as drifts; "measured": the feed is recorded and its gain to the top is 3.8 where its model says 3.0. Prints for
each method how many of its intervals miss the true value, beside the 5 % that they promise.

    python benchmarks/bench_disturbance.py [--runs 15] [--only step|drift|measured]
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))

from support.disturbed import FEED, WITH_CLOSED_FORM, WITH_FIT, analysed, outside, parameters
from support.simulated import coloured, random_switching
from trueplant import Result
from trueplant.loop import step_disturbance
from trueplant.lti import sampled_response

OUTPUTS = ("top", "bottom")


def step(seed: int, folder: Path) -> Result:
    rng = np.random.default_rng(seed)
    r = random_switching(rng, 2000, 2, 20.0)
    v = coloured(rng, 2000, 2, [1, -0.8], [1], 0.1) + step_disturbance(2000, 1.0, 700.0, [8.0, -8.0])
    return analysed(folder, v, r, unmeasured=[{"output": name, "kind": "step", "std": 0.3} for name in OUTPUTS])


def drift(seed: int, folder: Path) -> Result:
    rng = np.random.default_rng(seed)
    v = coloured(rng, 900, 2, [1, -0.8], [1], 0.1)
    v += np.cumsum(np.cumsum(2e-3 * rng.standard_normal((900, 2)), axis=0), axis=0)
    declared = [{"output": name, "kind": "drift", "std": 2e-3} for name in OUTPUTS]
    return analysed(folder, v, random_switching(rng, 900, 2, 20.0), unmeasured=declared)


def measured(seed: int, folder: Path) -> Result:
    rng = np.random.default_rng(seed)
    d = 0.3 * random_switching(rng, 4000, 1, 40.0)
    v = coloured(rng, 4000, 2, [1, -0.8], [1], 0.2) + sampled_response(FEED, d, 1.0, "linear")
    elements = [
        {"output": "top", "input": "feed", "tf": "3.0 exp(-8.1 s)/(14.9 s + 1)"},
        {"output": "bottom", "input": "feed", "tf": "4.9 exp(-3.4 s)/(13.2 s + 1)", "estimate": False},
    ]
    r = random_switching(rng, 4000, 2, 20.0)
    return analysed(folder, v, r, d, disturbance=[{"name": "feed", "column": "feed"}], more=elements)


CASES: dict[str, tuple[Callable[[int, Path], Result], tuple[str, ...]]] = {
    "step": (step, ("direct", WITH_FIT, WITH_CLOSED_FORM)),
    "drift": (drift, ("direct",)),
    "measured": (measured, ("direct", "closed-form")),
}


def run(job: tuple[str, int]) -> list[tuple[str, int, int]]:
    """Methods with the intervals that miss, and all of them."""
    case, seed = job
    simulated, methods = CASES[case]
    with tempfile.TemporaryDirectory() as folder:
        result = simulated(seed, Path(folder))
    found = [name for name in methods if name in result.to_dict()["methods"]]
    return [(name, outside(result, name), sum(map(len, parameters(result, name).values()))) for name in found]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=15)
    parser.add_argument("--only", choices=tuple(CASES))
    options = parser.parse_args()
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        for case in [options.only] if options.only else CASES:
            begun = time.perf_counter()
            missed, count = Counter[str](), Counter[str]()
            for rows in pool.map(run, [(case, 100 + k) for k in range(options.runs)]):
                for name, outer, all_ in rows:
                    missed[name] += outer
                    count[name] += all_
            for name in count:
                share = 100 * missed[name] / count[name]
                print(f"{case:9} {name:38} {missed[name]:5} of {count[name]:5} miss: {share:4.1f} % (5 % promised)")
            print(f"          {options.runs} simulated runs, {time.perf_counter() - begun:.0f} s", flush=True)


if __name__ == "__main__":
    main()
