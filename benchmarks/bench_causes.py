"""Causes named on simulated records whose cause is known: how often the right one, a wrong one, or none.

Simulated: one loop (K = 2, lag 10 min, dead time 3.3 min, PI) and the Wood-Berry column under two PIs, h = 1 min,
set-points switching at random. The model is the plant at the start of the record, but for "gain +40 % from the start".
Noise, plant or start are what the case says. A cause is wrong if neither the case has it nor an element of the plant
differs from the model: false alarms of the verdicts ("cause-plant") count as well. Each column gives percent of the
records; "wrong" says which.

    python benchmarks/bench_causes.py [--runs 50] [--samples 1500] [--only TEXT] [--workers 2] [--first 0]
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))

from scipy.signal import lfilter

import trueplant as tp
from support.changing import changing_loop
from support.simulated import BLT, WOOD_BERRY, coloured, random_switching
from trueplant.loop import PID, Controller, Simulation, simulate
from trueplant.lti import TransferMatrix, to_formula
from trueplant.notebook.loops import project_of
from trueplant.study.data.excitation import blocked, doubts
from trueplant.study.data.prepare import prepare
from trueplant.study.plant.elements import judge
from trueplant.study.plant.gate import through_the_gate
from trueplant.study.plant.identified import identify
from trueplant.study.plant.updated import updated_plant
from trueplant.study.study import quiet

Array = np.ndarray
ONE = TransferMatrix.of([["2 exp(-3.3 s)/(10 s + 1)"]], "min")
LAW = Controller.diagonal([PID(Kc=0.66, Ti=10.0, sample_time=1.0)])
DISTURBANCE, MOVED = "cause-disturbance", "cause-moved-meanwhile"
OF_PLANT = {"cause-plant", "cause-unknown"}
"""What may be said where an element of the plant is not the model's."""


@dataclass(frozen=True)
class Case:
    record: Callable[[np.random.Generator, int], Simulation]
    expected: str = ""
    changed: bool = False
    """Does the plant differ from the model?"""
    from_sample: int = 0
    """Where the record begins in the simulation."""


def white(rng: np.random.Generator, n: int) -> Array:
    return 0.1 * rng.standard_normal((n, 1))


def outliers(rng: np.random.Generator, n: int) -> Array:
    return white(rng, n) + np.where(rng.random((n, 1)) < 0.01, rng.choice([-1.0, 1.0], (n, 1)), 0.0)


def student(rng: np.random.Generator, n: int) -> Array:
    return 0.1 * rng.standard_t(3, (n, 1)) / np.sqrt(3)


def bursts(rng: np.random.Generator, n: int) -> Array:
    """Errors whose size wanders: its logarithm is AR(1) with a pole of 0.9."""
    e = white(rng, n) * np.exp(coloured(rng, n, 1, [1, -0.9], [1], 0.5))
    return np.asarray(lfilter([1], [1, -0.8], e, axis=0))


def walk(rng: np.random.Generator, n: int) -> Array:
    return 0.5 * np.cumsum(white(rng, n), axis=0)


def ar(rng: np.random.Generator, n: int) -> Array:
    return coloured(rng, n, 1, [1, -0.8], [1], 0.1)


def doubled(rng: np.random.Generator, n: int) -> Array:
    return ar(rng, n) * np.where(np.arange(n) < n // 2, 1.0, 2.0)[:, None]


def recoloured(rng: np.random.Generator, n: int, std: float = 0.1) -> Array:
    """From AR(0.5) to AR(0.95) of the same standard deviation."""
    half = n // 2
    return np.vstack([coloured(rng, k, 1, [1, -a], [1], std) for k, a in ((half, 0.5), (n - half, 0.95))])


def one(noise: Callable[[np.random.Generator, int], Array], plant: TransferMatrix = ONE, first: float = 0.0):
    """A record of the one loop; its set-point may begin far away."""

    def record(rng: np.random.Generator, n: int) -> Simulation:
        r = random_switching(rng, n, 1, 40.0)
        r[:20] += first
        return simulate(plant, LAW, r, 1.0, v=noise(rng, n))

    return record


def one_moved(at: float):
    """The one loop whose gain rises by 40 % at this share of the record."""

    def record(rng: np.random.Generator, n: int) -> Simulation:
        gain = 2 * np.where(np.arange(n) < at * n, 1.0, 1.4)
        return changing_loop(ONE, LAW, random_switching(rng, n, 1, 40.0), ar(rng, n), (0, 0), gain, 10.0, 3.3)

    return record


def two(changes: bool = False, colour: bool = False):
    """Wood-Berry; the gain from reflux to bottom rises by 40 % halfway, or the noise of bottom changes its colour."""

    def record(rng: np.random.Generator, n: int) -> Simulation:
        r, v = random_switching(rng, n, 2, 20.0), coloured(rng, n, 2, [1, -0.8], [1], 0.3)
        if colour:
            v = np.column_stack([coloured(rng, n, 1, [1, -0.5], [1], 0.3)[:, 0], recoloured(rng, n, 0.3)[:, 0]])
        gain = 6.6 * np.where(np.arange(n) < n // 2, 1.0, 1.4)
        return (
            changing_loop(WOOD_BERRY, BLT, r, v, (1, 0), gain, 10.9, 7.4)
            if changes
            else simulate(WOOD_BERRY, BLT, r, 1.0, v=v)
        )

    return record


HIGHER = TransferMatrix.of([["2.8 exp(-3.3 s)/(10 s + 1)"]], "min")
CASES = {
    "white noise": Case(one(white)),
    "1 % outliers of 10 sigma": Case(one(outliers)),
    "Student t(3) noise": Case(one(student)),
    "noise in bursts": Case(one(bursts)),
    "random walk": Case(one(walk)),
    "starts far from rest": Case(one(ar, first=30.0), from_sample=22),
    "2 x 2, nothing": Case(two()),
    "noise doubles halfway": Case(one(doubled), DISTURBANCE),
    "noise changes colour halfway": Case(one(recoloured), DISTURBANCE),
    "2 x 2, noise changes colour": Case(two(colour=True), DISTURBANCE),
    "gain +40 % from the start": Case(one(ar, HIGHER), "cause-unknown", True),
    "gain +40 % halfway": Case(one_moved(0.5), MOVED, True),
    "gain +40 % at 85 %": Case(one_moved(0.85), MOVED, True),
    "2 x 2, one gain +40 % halfway": Case(two(changes=True), MOVED, True),
}


def causes_named(simulation: Simulation, model: TransferMatrix, law: Controller) -> set[str]:
    """Codes of the causes of an analysis, by its stages up to the verdicts."""
    frame, loops = {"time": simulation.t}, []
    for k in range(simulation.y.shape[1]):
        frame |= {f"sp{k}": simulation.r[:, k], f"op{k}": simulation.u[:, k], f"pv{k}": simulation.y[:, k]}
        loops.append(tp.Loop(f"L{k}", pv=f"pv{k}", sp=f"sp{k}", op=f"op{k}", controller=law.entries[k, k]))
    n = range(len(loops))
    elements = {(f"L{i}", f"L{j}"): {"tf": to_formula(model[i, j], 12)} for i in n for j in n}
    study = prepare(project_of(["record"], loops, elements, None, "min", {}), quiet, [frame])
    if not study.segments or blocked(doubts(study)):
        return {"refused"}
    identified = through_the_gate(study, identify(study, quiet))
    judged = judge(study, identified, updated_plant(study.model, identified.estimates).nominal)
    return {str(reason.code) for reason in judged.causes}


def run(job: tuple[str, int, int]) -> tuple[bool, set[str]]:
    """Is the right cause named, and which wrong ones?"""
    name, seed, samples = job
    case = CASES[name]
    sim = case.record(np.random.default_rng([list(CASES).index(name), seed]), samples)
    first = case.from_sample
    kept = {key: getattr(sim, key)[first:] for key in ("r", "u", "y", "t")}
    one_loop = sim.y.shape[1] == 1
    named = causes_named(Kept(**kept), *((ONE, LAW) if one_loop else (WOOD_BERRY, BLT)))
    wrong = named - {case.expected} - (OF_PLANT if case.changed else set())
    return (case.expected in named if case.expected else not named), wrong


@dataclass(frozen=True)
class Kept:
    """The part of a simulation that was recorded."""

    r: Array
    u: Array
    y: Array
    t: Array


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=50)
    parser.add_argument("--samples", type=int, default=1500)
    parser.add_argument("--only", default="")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--first", type=int, default=0, help="first seed")
    options = parser.parse_args()
    for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
        os.environ[name] = "1"
    begun, seeds = time.perf_counter(), range(options.first, options.first + options.runs)
    print(f"{options.runs} simulated records of {options.samples} samples each, seeds {seeds.start} on")
    print(f"{'case':32}{'right %':>9}{'wrong %':>9}{'neither %':>11}  which wrong")
    with ProcessPoolExecutor(options.workers, mp_context=get_context("spawn")) as pool:
        for name in (n for n in CASES if options.only in n):
            found = list(pool.map(run, [(name, seed, options.samples) for seed in seeds], chunksize=5))
            wrong = np.array([bool(codes) for _, codes in found])
            right = np.array([ok for ok, _ in found]) & ~wrong
            which = Counter(code for _, codes in found for code in codes)
            said = ", ".join(f"{code} {count}" for code, count in which.most_common())
            shares = [100 * np.mean(x) for x in (right, wrong, ~right & ~wrong)]
            print(f"{name:32}{shares[0]:9.0f}{shares[1]:9.0f}{shares[2]:11.0f}  {said}", flush=True)
    print(f"{time.perf_counter() - begun:.0f} s")


if __name__ == "__main__":
    main()
