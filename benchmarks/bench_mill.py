"""The paper's grinding mill, simulated: what is said of an element whose net gain is the difference of two.

Model and loop are those of the demo; the plant is the perturbed one with the factor 1.0137 ("eq37"), or with
`--unperturbed` the model itself. White noise of 0.02 on both PVs, 240 min at 0.05 min, a set-point move each 30 min.
The controllers scan as the record does, and are declared so; with `--undeclared` they are the paper's continuous ones,
whose answer counts that OP may act up to half a sample from where it was recorded, though here it does not.
Prints how often each element is called changed, how often the two lags of (1, 2), which are the model's in truth,
are starred, and how often its net gain and its response are covered.

    python benchmarks/bench_mill.py [--records 200] [--unperturbed] [--undeclared] [--workers 2]
"""

from __future__ import annotations

import argparse
import os
import sys
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from multiprocessing import get_context
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))

from random_plants import decided

import trueplant as tp
from trueplant.loop import Controller, simulate
from trueplant.notebook.loops import project_of
from trueplant.plants import mill

MINUTES, STEP, NOISE = 240.0, 0.05, 0.02
MOVES = (0.5, 3.0, -0.8, -5.0, 0.5, 3.0, -0.2, -1.0)
"""Of the two set-points in turn."""
FREQUENCIES = (0.05, 0.2, 0.8)
"""rad/min: below, at and above the bandwidth."""
LAGS = ("tau1", "tau2")


@dataclass(frozen=True)
class Said:
    changed: dict[tuple[int, int], bool]
    starred: dict[str, bool]
    """Parameters of (1, 2)."""
    covered: dict[str, bool]
    """Of (1, 2): net gain, real and imaginary part of its response."""


def record(seed: int, unperturbed: bool = False, undeclared: bool = False):
    """A record of the loop as columns, and the project."""
    case = mill("eq37")
    controller = case.controller if undeclared else _scanned(case.controller)
    steps = round(MINUTES / STEP)
    r, each = np.zeros((steps, 2)), steps // len(MOVES)
    for k, move in enumerate(MOVES):
        r[k * each + each // 5 :, k % 2] += move
    v = NOISE * np.random.default_rng(seed).standard_normal((steps, 2))
    done = simulate(case.model if unperturbed else case.plant, controller, r, STEP, v=v)
    frame = {"time": done.t}
    for k in range(2):
        frame |= {f"sp{k}": done.r[:, k], f"op{k}": done.u[:, k], f"pv{k}": done.y[:, k]}
    laws = [controller.entries[k, k] for k in range(2)]
    loops = [tp.Loop(f"L{k}", pv=f"pv{k}", sp=f"sp{k}", op=f"op{k}", controller=laws[k]) for k in range(2)]
    names = {(f"L{i}", f"L{j}"): {"tf": tf} for (i, j), tf in FORMULAS.items()}
    return frame, project_of(["record"], loops, names, None, "min", {})


def _scanned(controller: Controller) -> Controller:
    """The same laws in a controller that scans as the record does."""
    laws = {at: replace(law, sample_time=STEP) for at, law in controller.entries.items()}
    return replace(controller, entries=laws)


FORMULAS = {
    (0, 0): "-0.58 exp(-0.68 s)/(2.5 s + 1)",
    (0, 1): "4 (1 - 0.9938 exp(-0.47 s)) exp(-0.2 s)/((2 s + 1)(6 s + 1))",
    (1, 0): "2.2 exp(-0.6 s)/(6 s + 1)",
    (1, 1): "2.83 exp(-0.13 s)/(3.5 s + 1)",
}


def answer(seed: int, unperturbed: bool, undeclared: bool) -> Said:
    """What an analysis says of one record."""
    frame, project = record(seed, unperturbed, undeclared)
    case = mill("eq37")
    truth = (case.model if unperturbed else case.plant)[0, 1]
    found = decided(project, frame)
    elements = {(int(e.output[1]), int(e.input[1])): e for e in found.elements}
    estimate = found.estimates[0]
    m = next(k for k, spec in enumerate(estimate.row.specs) if spec.column == 1)
    part, structure = estimate.row.slices[m], estimate.row.specs[m].structure
    theta, covariance = estimate.theta[part], estimate.covariance[part, part]
    covered = {}
    for name, of in _quantities(structure, truth).items():
        value, right = of(theta)
        steps = 1e-6 * np.maximum(np.abs(theta), 1e-3)
        # forwards: a dead time may be 0
        slope = np.array([(of(theta + d)[0] - value) / d.max() for d in np.diag(steps)])
        covered[name] = bool(abs(value - right) <= 1.96 * np.sqrt(slope @ covariance @ slope))
    starred = {p.name: bool(p.changed) for p in elements[0, 1].parameters}
    return Said({at: str(e.verdict) == "changed" for at, e in elements.items()}, starred, covered)


def _quantities(structure, truth):
    """By name: functions of theta that give the value, and the true one."""

    def response(theta, w):
        return structure.transfer(theta)(1j * w)

    def pair(of, w):
        right = of(truth(1j * w))
        return lambda theta: (of(response(theta, w)), right)

    found = {"net gain": pair(np.real, 0.0)}
    for w in FREQUENCIES:
        found[f"real part at {w:g} rad/min"] = pair(np.real, w)
        found[f"imaginary part at {w:g} rad/min"] = pair(np.imag, w)
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--records", type=int, default=200)
    parser.add_argument("--unperturbed", action="store_true")
    parser.add_argument("--undeclared", action="store_true")
    parser.add_argument("--workers", type=int, default=2)
    options = parser.parse_args()
    for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
        os.environ[name] = "1"
    with ProcessPoolExecutor(options.workers, mp_context=get_context("spawn")) as pool:
        job = partial(answer, unperturbed=options.unperturbed, undeclared=options.undeclared)
        said = list(pool.map(job, range(options.records)))
    plant, scan = (
        "unperturbed" if options.unperturbed else "perturbed",
        "undeclared" if options.undeclared else "declared",
    )
    print(f"{len(said)} simulated records, {plant}, scan {scan}")
    for at in sorted(FORMULAS):
        print(f"({at[0] + 1}, {at[1] + 1}) changed: {sum(one.changed[at] for one in said)}")
    print("any element changed:", sum(any(one.changed.values()) for one in said))
    print("(1, 2):", {name: sum(one.starred.get(name, False) for one in said) for name in LAGS}, "lags starred")
    for name in said[0].covered:
        print(f"(1, 2), {name}: covered {100 * np.mean([one.covered[name] for one in said]):.1f} %")


if __name__ == "__main__":
    main()
