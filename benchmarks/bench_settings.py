"""Settings that pay: what is recommended for the changed mill, the splitter, a real rig, and loops that need none.

Loops that need nothing: gain, lag and dead time of one loop drawn at random (dead time 0.1 to 1.5 lags), tuned by SIMC
with a closed-loop time of 1 to 2 dead times, simulated on its own model with white noise of 1 % of the set-point
steps and a slow disturbance of 5 %; 600 samples, ten steps. Printed: how often "keep" is said, and what else. The real
rig is the Temperature Control Lab (`examples/tclab_pid_short.toml`); without its records it is left out.

    python benchmarks/bench_settings.py [--loops 200] [--first 0] [--loops-only]
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections import Counter
from importlib.resources import files
from pathlib import Path

import numpy as np
import polars as pl

sys.path.insert(0, str(Path(__file__).parent))

from bench_mill import FORMULAS, record

import trueplant as tp
from trueplant.errors import TrueplantError
from trueplant.loop import PID, Controller, alternating_steps, ar1, simulate
from trueplant.project.simulation import simulate_record

TCLAB = Path(__file__).parent.parent / "examples" / "tclab_pid_short.toml"
WEIGHTS = '[robustness]\nwI = {gain_percent = 10, dead_time = 0.2}\nwP = "(0.45 s + 0.05)/s"\n'


def mill(folder: Path) -> tp.Project:
    """The perturbed mill (factor 1.0137) with the paper's weights."""
    frame, _ = record(0, undeclared=True)
    pl.DataFrame(frame).write_csv(folder / "mill.csv")
    text = 'time_unit = "min"\ndata = {files = ["mill.csv"], time = "time"}\n'
    for k, (Kc, Ti) in enumerate(((-2.0, 3.3), (0.42, 5.2))):
        text += f'[[output]]\nname = "y{k}"\npv = "pv{k}"\nsp = "sp{k}"\n[[input]]\nname = "u{k}"\nop = "op{k}"\n'
        text += f'[[controller]]\ninput = "u{k}"\noutput = "y{k}"\nKc = {Kc}\nTi = {Ti}\n'
    for (i, j), formula in FORMULAS.items():
        text += f'[[model]]\noutput = "y{i}"\ninput = "u{j}"\ntf = "{formula}"\n'
    return tp.Project.from_toml(f"{text}{WEIGHTS}[tuning]\n", folder)


def splitter(folder: Path) -> tp.Project:
    text = files("trueplant.cli.demos").joinpath("splitter.toml").read_text("utf-8")
    simulate_record(tp.Project.from_toml(text, folder)).write_csv(folder / "record.csv")
    if "[tuning]" not in text:
        text = text.replace("\n[simulate]", "\n[tuning]\n[simulate]", 1)
    return tp.Project.from_toml(text, folder)


def tclab(folder: Path) -> tp.Project:
    text = TCLAB.read_text("utf-8")
    return tp.Project.from_toml(text if "[tuning]" in text else f"{text}\n[tuning]\n", TCLAB.parent)


def needs_nothing(seed: int, folder: Path) -> tp.Project:
    rng = np.random.default_rng(seed)
    gain, lag = float(np.exp(rng.uniform(-1, 1))), float(rng.uniform(5, 20))
    theta = lag * float(np.exp(rng.uniform(np.log(0.1), np.log(1.5))))
    wanted, scan = theta * float(rng.uniform(1, 2)), min(lag, theta) / 4
    # half of the scan counts as dead time
    late = theta + scan / 2
    Kc, Ti = lag / (gain * (wanted + late)), min(lag, 4 * (wanted + late))
    formula = f"{gain} exp(-{theta} s)/({lag} s + 1)"
    law = Controller.diagonal([PID(Kc=Kc, Ti=Ti, sample_time=scan)])
    r = alternating_steps(600, scan, 60 * scan, [1.0])
    v = ar1(600, scan, lag, [0.05], seed=seed + 1000)
    done = simulate(tp.TransferMatrix.of([[formula]], "min"), law, r, scan, v=v, noise=0.01, seed=seed)
    columns = {"t": done.t, "sp": done.r[:, 0], "op": done.u[:, 0], "pv": done.y[:, 0]}
    pl.DataFrame(columns).write_csv(folder / "loop.csv")
    return tp.Project.from_toml(
        f"""
        time_unit = "min"
        data = {{files = ["loop.csv"], time = "t"}}
        output = [{{name = "y", pv = "pv", sp = "sp"}}]
        input = [{{name = "u", op = "op"}}]
        model = [{{output = "y", input = "u", tf = "{formula}"}}]
        controller = [{{input = "u", output = "y", Kc = {Kc}, Ti = {Ti}, sample_time = {scan}}}]
        [tuning]
        """,
        folder,
    )


def case(name: str, project: tp.Project) -> None:
    controllers = tp.run(project).controllers
    for loop in controllers:
        print(f"{name}, {loop.input}: {loop.recommended}")
    print(f"  {controllers[0].reason}" if controllers else f"{name}: nothing proposed")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--loops", type=int, default=200)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--loops-only", action="store_true")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for make in () if options.loops_only else (mill, splitter, tclab):
            try:
                case(make.__name__, make(folder))
            except TrueplantError as error:
                print(f"{make.__name__}: left out: {error}")
        said: Counter[str] = Counter()
        for seed in range(options.first, options.first + options.loops):
            found = tp.run(needs_nothing(seed, folder)).controllers
            answer = str(found[0].recommended) if found else "not proposed"
            said[answer] += 1
            if answer != "keep":
                print(f"loop {seed}: {answer}: {found[0].reason if found else ''}", flush=True)
    print(f"{options.loops} loops that need nothing: {dict(said)}")


if __name__ == "__main__":
    main()
