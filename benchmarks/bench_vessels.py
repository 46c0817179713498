"""Levels drawn at random, all simulated: what is said of vessels under the loads that levels have.

A vessel integrates what flows in, so a random walk of its inflow reaches PV integrated twice. Scans, dead times, slopes
and controllers are drawn; set-points move seven times. Prints by kind of load: unchanged vessels that are called
changed, those without a verdict, coverage of the slope's 95 % interval and its largest error in standard errors.

    python benchmarks/bench_vessels.py [--first 0] [--records 100] [--load "random walk"]
"""

from __future__ import annotations

import argparse
import tempfile
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from trueplant import Project
from trueplant.project.simulation import as_file, simulate_record
from trueplant.study.pipeline import analyse

LOADS = ("none", "noise", "random walk")
SCANS = (0.05, 0.1, 0.25, 0.5)
MOST_SAMPLES = 6000


@dataclass(frozen=True)
class Vessel:
    """A level loop; times in min, levels and flows in %."""

    load: str
    model: float
    slope: float
    dead_time: float
    crossover: float
    reset: float
    scan: float
    moves: tuple[float, ...]
    seed: int

    @property
    def text(self) -> str:
        """The project file that simulates and analyses it."""
        between = 30 / self.crossover
        samples = min(int(8 * between / self.scan), MOST_SAMPLES)
        between = samples * self.scan / 8
        moves = ", ".join(
            f'{{time = {between * (k + 0.5):.3f}, output = "level", value = {value:g}}}'
            for k, value in enumerate(self.moves)
        )
        swing = self.crossover / abs(self.model)
        load = {
            "none": "",
            "noise": f'kind = "noise", std = {0.09 * swing:.4g}, time_constant = {0.5 / self.crossover:.4g}',
            "random walk": f'kind = "random walk", std = {0.15 * swing * np.sqrt(self.crossover):.4g}',
        }[self.load]
        loads = f'loads = [{{at = "outflow", {load}, seed = {self.seed}}}]' if load else ""
        return f"""
time_unit = "min"
data = {{files = ["record.csv"], time = "t"}}
output = [{{name = "level", pv = "pv", sp = "sp", unit = "%"}}]
input = [{{name = "outflow", op = "op", unit = "%"}}]
model = [{{output = "level", input = "outflow", tf = "{self.model:.6g} exp(-{self.dead_time:.4g} s)/s"}}]

[[controller]]
input = "outflow"
output = "level"
Kc = {self.crossover / self.model:.5g}
Ti = {self.reset:.5g}
sample_time = {self.scan}

[simulate]
plant = [{{output = "level", input = "outflow", tf = "{self.slope:.6g} exp(-{self.dead_time:.4g} s)/s"}}]
duration = {samples * self.scan}
sample_time = {self.scan}
noise = 0.1
seed = {self.seed}
setpoints = [{moves}]
{loads}
"""


def draw(number: int) -> Vessel:
    """The vessel of that number."""
    rng = np.random.default_rng([15, number])
    model = -(10 ** rng.uniform(-2, -0.5))
    dead_time = float(rng.choice([0.0, 0.0, 1.0, 3.0]) * rng.uniform(0.3, 1))
    crossover = 10 ** rng.uniform(-1.3, -0.5) / max(1.0, dead_time)
    slope = model * (rng.choice([0.7, 1.3, 1.5]) if rng.random() < 0.4 else 1.0)
    return Vessel(
        load=str(rng.choice(LOADS)),
        model=model,
        slope=float(slope),
        dead_time=dead_time,
        crossover=crossover,
        reset=rng.uniform(4, 12) / crossover,
        scan=float(rng.choice(SCANS)),
        moves=tuple(rng.choice([-2.0, -1.0, 1.0, 2.0], 7)),
        seed=number,
    )


def answer(vessel: Vessel) -> tuple[str, float | None]:
    """The verdict, and the error of the slope in standard errors where one is answered."""
    with tempfile.TemporaryDirectory() as folder:
        project = Project.from_toml(vessel.text, Path(folder))
        (Path(folder) / "record.csv").write_bytes(as_file(simulate_record(project), "record.csv"))
        result = analyse(project)
    if not result.elements:
        return "refused", None
    slope = result.elements[0].parameters[0]
    error = None if slope.plant is None else (slope.plant - vessel.slope) / slope.std_error
    return str(result.elements[0].verdict), error


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--records", type=int, default=100)
    parser.add_argument("--load", choices=LOADS)
    options = parser.parse_args()
    found = defaultdict(list)
    for number in range(options.first, options.first + options.records):
        vessel = draw(number)
        if options.load in (None, vessel.load):
            found[vessel.load].append((vessel.slope != vessel.model, *answer(vessel)))
    print(f"{'load':14}{'false alarms':>16}{'found':>10}{'no verdict':>13}{'covered %':>12}{'furthest':>10}")
    for load, lines in sorted(found.items()):
        unchanged = [verdict for changed, verdict, _ in lines if not changed]
        changed = [verdict for changed, verdict, _ in lines if changed]
        errors = np.abs([error for _, _, error in lines if error is not None])
        without = sum(verdict not in ("changed", "unchanged") for _, verdict, _ in lines)
        print(
            f"{load:14}{unchanged.count('changed'):10} of {len(unchanged):<3}{changed.count('changed'):4} of "
            f"{len(changed):<3}{without:7} of {len(lines):<4}{100 * np.mean(errors < 1.96):10.1f}{errors.max():9.1f}"
        )


if __name__ == "__main__":
    main()
