"""How often retuned settings keep their limit on the true plant, over simulated records of one loop.

Simulated: gain 2, time constant 10 min, dead time 2 min, scan 0.5 min, 300 min with set-point steps of 2 every 60 min,
white noise 0.05 and a first-order disturbance of 0.2 (5 min); the model's gain is 1.5. Each record is identified, and
the settings found from it are judged by Ms and Mt <= 1.59 on the plant that made it.

    python benchmarks/bench_retuning.py [--runs 100]
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import numpy as np
import polars as pl

import trueplant as tp
from trueplant.loop import PID, Controller, alternating_steps, ar1, simulate
from trueplant.robust import margins
from trueplant.study.data.prepare import prepare
from trueplant.study.plant.identified import identify
from trueplant.study.plant.updated import updated_plant
from trueplant.tune import LoopTask, propose

H = 0.5
PLANT = tp.TransferMatrix.of([["2 exp(-2 s)/(10 s + 1)"]], "min")
TODAY = Controller.diagonal([PID(Kc=1.0, Ti=10.0, sample_time=H)])
PROJECT = """
time_unit = "min"
data = {files = ["record.csv"], time = "t"}
output = [{name = "y", pv = "pv", sp = "sp"}]
input = [{name = "u", op = "op"}]
model = [{output = "y", input = "u", tf = "1.5 exp(-2 s)/(10 s + 1)"}]
controller = [{input = "u", output = "y", Kc = 1.0, Ti = 10, sample_time = 0.5}]
"""
METHODS = ("certain-share", "max-ki", "simc")


def holds(law: Controller | None) -> bool:
    if law is None:
        return False
    found = margins(PLANT, law)
    return max(found.Ms, found.Mt) <= 1.59


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=100)
    runs = parser.parse_args().runs
    held: dict[str, list[bool]] = {name: [] for name in (*METHODS, "max-ki on the estimate")}
    prices = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for seed in range(runs):
            v = ar1(600, H, 5.0, [0.2], seed=5000 + seed)
            sim = simulate(PLANT, TODAY, alternating_steps(600, H, 60.0, [2.0]), H, v=v, noise=0.05, seed=seed)
            columns = {"t": sim.t, "sp": sim.r[:, 0], "op": sim.u[:, 0], "pv": sim.y[:, 0]}
            pl.DataFrame(columns).write_csv(folder / "record.csv")
            study = prepare(tp.Project.from_toml(PROJECT, folder))
            estimates = identify(study).estimates
            known = updated_plant(study.model, estimates).keeping_signs([(0, 0)])
            late = max(float(estimates[0].intervals[2, 1] - estimates[0].theta[2]), 0.0)
            like = PID(Kc=1.0, sample_time=H)
            careful, plain = (LoopTask(0, 0, 5.0, like, dead_time_error=x) for x in (late, 0.0))
            for found in propose(known, [careful], TODAY, METHODS, seed=seed):
                held[found.method].append(holds(found.controller))
                prices += [p for p in found.price if p is not None]
            held["max-ki on the estimate"].append(holds(propose(known, [plain], TODAY, ["max-ki"])[0].controller))
    for method, kept in held.items():
        print(f"{method:24} holds on the true plant after {100 * np.mean(kept):.0f} % of {runs} records")
    print(f"certain-share gives up {100 * np.mean(prices):.0f} % of the integral gain on average")


if __name__ == "__main__":
    main()
