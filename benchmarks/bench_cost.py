"""CPU time of the analysis of a week at a sample a minute (10,080 simulated samples), one loop and a 2x2, no report.

Warm: one record of each kind is analysed before and does not count. Beside the whole analysis, in the same process: the
plain estimate with its intervals, and what its rivals (richer structures, valves) take on top. Other methods are not
asked for (`method = "direct"`). Nothing has changed in these records; what is called changed all the same is counted.

    python benchmarks/bench_cost.py [--records 5] [--samples 10080] [--declared] [--profile 1|2]
"""

from __future__ import annotations

import argparse
import cProfile
import pstats
import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))

import trueplant as tp
from support.simulated import BLT, WOOD_BERRY, coloured, random_switching
from trueplant.identify import specs_of
from trueplant.identify.output import identify_output
from trueplant.loop import Controller, simulate
from trueplant.lti import TransferMatrix
from trueplant.notebook.loops import project_of
from trueplant.project import Project
from trueplant.result import ElementVerdict
from trueplant.study.data.prepare import prepare
from trueplant.study.pipeline import analyse
from trueplant.study.plant.identified import identify
from trueplant.study.study import quiet

Frame = dict[str, np.ndarray]


def record(size: int, samples: int, seed: int, declared: bool) -> tuple[Frame, Project]:
    """One loop of Wood-Berry (its first), or the whole column, under BLT settings and an AR(1) disturbance."""
    rng = np.random.default_rng(seed)
    plant = TransferMatrix(tuple(row[:size] for row in WOOD_BERRY.elements[:size]), "min")
    laws = [BLT.entries[k, k] for k in range(size)]
    r = random_switching(rng, samples, size, 20.0)
    v = coloured(rng, samples, size, [1, -0.8], [1], 0.3)
    found = simulate(plant, Controller.diagonal(laws), r, 1.0, v=v)
    frame = {"time": found.t}
    for k in range(size):
        frame |= {f"sp{k}": found.r[:, k], f"op{k}": found.u[:, k], f"pv{k}": found.y[:, k]}
    loops = [
        tp.Loop(f"L{k}", pv=f"pv{k}", sp=f"sp{k}", op=f"op{k}", controller=laws[k] if declared else None)
        for k in range(size)
    ]
    model = {(f"L{i}", f"L{j}"): plant[i, j] for i in range(size) for j in range(size)}
    return frame, project_of(["record"], loops, model, None, "min", {"analysis": {"method": "direct"}})


def estimates(frame: Frame, project: Project) -> tuple[float, float]:
    """CPU time in s of the plain estimate of all outputs with its intervals, and of what its rivals take beside it.

    Rivals are richer structures and valves.
    """
    study = prepare(project, quiet, [frame])
    begun = time.process_time()
    specs = specs_of(study.model)
    for i in range(study.model.shape[0]):
        identify_output(study.segments, i, [spec for (k, _), spec in sorted(specs.items()) if k == i])
    between = time.process_time()
    identify(study)
    plain = between - begun
    return plain, time.process_time() - between - plain


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--records", type=int, default=5)
    parser.add_argument("--samples", type=int, default=10_080)
    parser.add_argument("--declared", action="store_true", help="controllers are declared")
    parser.add_argument("--profile", type=int, choices=[1, 2], help="where the time of one record goes, by size")
    given = parser.parse_args()
    for size in (1, 2) if given.profile is None else (given.profile,):
        times, parts, changed = [], [], 0
        for seed in range(given.records + 1):
            frame, project = record(size, given.samples, seed, given.declared)
            begun = time.process_time()
            result = analyse(project, frames=[frame])
            times.append(time.process_time() - begun)
            changed += any(element.verdict is ElementVerdict.CHANGED for element in result.elements)
            parts.append(estimates(frame, project))
        plain, rivals = np.median(parts[1:], axis=0)
        print(
            f"{size} x {size}: {np.median(times[1:]):.2f} s CPU (median of {given.records}; "
            f"largest {max(times[1:]):.2f}), "
            f"of it plain estimate {plain:.2f} s, rivals {rivals:.2f} s ({rivals / plain:.1f} times); "
            f"first of the process {times[0]:.2f} s; called changed {changed} of {given.records + 1}",
            flush=True,
        )
        if given.profile is not None:
            with cProfile.Profile() as profile:
                analyse(project, frames=[frame])
            pstats.Stats(profile).sort_stats("cumulative").print_stats(60)


if __name__ == "__main__":
    main()
