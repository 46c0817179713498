"""Test plans held against the truth, on plants, loops, limits and disturbances drawn at random, all simulated.

Each case is a record that leaves something open. Its plan, if there is one, is run on the TRUE plant right after the
record, many times, with another disturbance of the same kind each time. Printed: how often PV or OP leaves the limits
(with the plan, and without any move), and, from refits of all the records and tests, the rms error of every parameter
that matters over the standard error that was foretold. A share above 5 %, or a median of that ratio outside of 0.85 to
1.15, is a fault of the plans.

Parts 1 and 2 are to build with, part 3 to look at once. Answers are kept in the file, a line a case, and a later call
goes on from there.

    python benchmarks/bench_plans.py [--part 1] [--cases 50] [--runs 30] [--file answers.jsonl]
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

os.environ["OPENBLAS_NUM_THREADS"] = "1"
os.environ["OMP_NUM_THREADS"] = "1"
sys.path.insert(0, str(Path(__file__).parent))

import numpy as np
from random_plants import STRUCTURE_SHARES, STRUCTURES, _law, _matrix, _parameters
from scipy.signal import lfilter
from scipy.stats import norm

from trueplant.errors import TrueplantError
from trueplant.identify import Row, Spec, fit_row, pieces_of
from trueplant.identify.noise import fit_ar
from trueplant.loop import Controller, Simulation, simulate, unstable_poles
from trueplant.lti import Structure, TransferMatrix, to_formula
from trueplant.project import Project
from trueplant.record.types import Segment
from trueplant.result import MoreData
from trueplant.study.data.controller_check import check_controllers
from trueplant.study.data.excitation import blocked, doubts
from trueplant.study.data.prepare import prepare
from trueplant.study.experiment.plans import more_data
from trueplant.study.loops.settled import against_settled_loop
from trueplant.study.plant.gate import through_the_gate
from trueplant.study.plant.identified import identify
from trueplant.study.plant.updated import updated_plant
from trueplant.study.study import quiet

Array = np.ndarray
BURN_IN = 1000
Z = float(norm.ppf(0.975))
AR_ORDER = 10
TOLD = 0.8
"""A plan tells something of a parameter whose interval it is to bring below this part of what it is."""
MOST_SAMPLES = 2000
"""Of record and plan, for the refits: their time is what bounds the benchmark."""


@dataclass(frozen=True, eq=False)
class Case:
    """A record and all that it was made from."""

    structures: list[list[Structure]]
    truth: list[list[Array]]
    plant: TransferMatrix
    law: Controller | None
    h: float
    moves: Array
    """(N, n) of the set-points, of OP in open loop."""
    noise: tuple[str, float]
    """Kind and pole."""
    sizes: Array
    """(n,) of the disturbance at each PV."""
    e: Array
    """(BURN_IN + N, n) what the record's disturbance was made of."""
    limits: tuple[Array | None, Array | None]
    """(n, 2) declared of PV and of OP."""
    project: Project
    record: Simulation
    kind: str

    @property
    def size(self) -> int:
        return len(self.sizes)

    def run(self, moves: Array, e: Array) -> Simulation:
        """The true plant, from rest before the record, without limits of OP: a plan is to keep away from them."""
        v = coloured(e, self.noise, self.h)[BURN_IN:] * self.sizes
        free = np.tile([-np.inf, np.inf], (self.size, 1))
        if self.law is None:
            return simulate(self.plant, None, np.zeros_like(moves), self.h, u=moves, v=v, limits=free)
        return simulate(self.plant, self.law, moves, self.h, v=v, limits=free)


def coloured(e: Array, noise: tuple[str, float], h: float) -> Array:
    """(N, n) of about unit size; a random walk moves as far in ten time units as the others do, from 0 at BURN_IN."""
    kind, pole = noise
    if kind == "random walk":
        walk = np.cumsum(e, axis=0) * np.sqrt(h / 10.0)
        return walk - walk[BURN_IN]
    colours = {"white": ([1.0], [1.0]), "AR": ([1.0, -pole], [1.0])} | {
        "ARMA": ([1.0, -pole - 0.5, 0.5 * pole], [1.0, -0.3])
    }
    a, c = colours[kind]
    return lfilter(c, a, e, axis=0) / np.sqrt(np.sum(lfilter(c, a, np.eye(1, 5000)[0]) ** 2))


def draw(part: int, number: int) -> Case:
    """The case of this number; plants that no rule can control, and loops that are unstable, are drawn again."""
    for attempt in range(1000):
        try:
            case = _drawn(np.random.default_rng([7, part, number, attempt]))
        except TrueplantError:
            continue
        if case is not None:
            return case
    raise RuntimeError(f"nothing stable in 1000 draws for case {number} of part {part}")


def _drawn(rng: np.random.Generator) -> Case | None:
    n, h, closed = int(rng.integers(1, 4)), float(rng.choice([0.5, 1.0, 2.0])), bool(rng.random() < 0.75)
    structures = [[Structure.parse(rng.choice(STRUCTURES, p=STRUCTURE_SHARES)) for _ in range(n)] for _ in range(n)]
    truth = [[_parameters(rng, structures[i][j], i == j) for j in range(n)] for i in range(n)]
    model = [[_off(rng, structures[i][j], truth[i][j]) for j in range(n)] for i in range(n)]
    plant = _matrix(structures, truth)
    law = _law(rng, _matrix(structures, model), h) if closed else None
    if closed and (law is None or unstable_poles(plant, law) or unstable_poles(_matrix(structures, model), law)):
        return None
    steps = int(rng.integers(150, 600))
    moves = _moves(rng, steps, h, n, centred=not closed)
    free = np.tile([-np.inf, np.inf], (n, 1))
    quiet_one = (
        simulate(plant, law, moves, h, limits=free)
        if law
        else simulate(plant, None, np.zeros_like(moves), h, u=moves, limits=free)
    )
    if np.max(np.abs(quiet_one.y)) > 40:
        return None
    noise = str(rng.choice(["white", "AR", "ARMA", "random walk"])), float(np.exp(-h / rng.uniform(2.0, 15.0)))
    sizes = np.exp(rng.uniform(np.log(0.1), np.log(0.6), n)) * np.std(quiet_one.y, axis=0).clip(0.02)
    e = rng.standard_normal((BURN_IN + steps, n))
    case = Case(structures, truth, plant, law, h, moves, noise, sizes, e, (None, None), None, quiet_one, "")
    record = case.run(moves, e)
    limits = tuple(_limits(rng, x) if rng.random() < 0.6 else None for x in (record.y, record.u))
    known = rng.random((n, n)) < 0.9
    kind = f"{'closed' if closed else 'open'}, {noise[0]}"
    project = _project(structures, model, known, law, limits)
    return Case(structures, truth, plant, law, h, moves, noise, sizes, e, limits, project, record, kind)


def _off(rng: np.random.Generator, structure: Structure, theta: Array) -> Array:
    """A model that is up to a quarter off."""
    return theta * np.exp(rng.uniform(-0.25, 0.25, theta.size) * ~(structure.is_damping))


def _moves(rng: np.random.Generator, steps: int, h: float, n: int, centred: bool) -> Array:
    """(steps, n) about one to four moves a channel, some channels none at all; up and down alike where centred."""
    out = np.zeros((steps, n))
    for c in range(n):
        size = rng.uniform(0.7, 1.5)
        if n > 1 and rng.random() < 0.15:
            continue
        at = np.sort(rng.choice(np.arange(20, steps - 20), size=2 * int(rng.integers(1, 3)), replace=False))
        for k, begin in enumerate(at):
            level = size * (1 if k % 2 == 0 else (-1 if centred else 0))
            out[begin:, c] = level
        if centred:
            out[at[-1] + (at[-1] - at[-2]) :, c] = 0.0
    return out


def _limits(rng: np.random.Generator, x: Array) -> Array:
    """(n, 2) beyond what the record shows by a tenth to twice its range, to each side for itself."""
    low, high = x.min(axis=0), x.max(axis=0)
    more = np.exp(rng.uniform(np.log(0.1), np.log(2.0), (2, x.shape[1]))) * (high - low)
    return np.column_stack([low - more[0], high + more[1]])


def _project(structures, model, known, law, limits) -> Project:
    n = len(structures)
    tables: dict = {"time_unit": "min", "data": {"time": "time"}}
    tables["experiment"] = [{"file": "record", "loop": "closed" if law else "open"}]
    for key, what, x in (("output", "pv", limits[0]), ("input", "op", limits[1])):
        tables[key] = [{"name": f"{what}{k}", what: what + str(k)} for k in range(n)]
        if key == "output" and law:
            for k, entry in enumerate(tables[key]):
                entry["sp"] = f"sp{k}"
        if x is not None:
            for k, entry in enumerate(tables[key]):
                entry["limits"] = [float(x[k, 0]), float(x[k, 1])]
    tables["model"] = [
        {"output": f"pv{i}", "input": f"op{j}"}
        | (
            {"tf": to_formula(structures[i][j].transfer(model[i][j]), 17)}
            if known[i, j] or i == j
            else {"tf": "0", "structure": str(structures[i][j])}
        )
        for i in range(n)
        for j in range(n)
    ]
    if law:
        laws = [(k, law.entries[k, k]) for k in range(n)]
        keys = ("Kc", "Ti", "Td", "alpha", "sample_time")
        tables["controller"] = [
            {"input": f"op{k}", "output": f"pv{k}"}
            | {key: getattr(pid, key) for key in keys if getattr(pid, key) is not None}
            for k, pid in laws
        ]
    return Project(**tables)


def planned(case: Case) -> tuple[MoreData, ...] | None:
    """What the product says; None where the record is refused before anything can be estimated."""
    sim = case.record
    frame = {"time": sim.t}
    for k in range(case.size):
        frame |= {f"op{k}": sim.u[:, k], f"pv{k}": sim.y[:, k]} | ({f"sp{k}": sim.r[:, k]} if case.law else {})
    study = prepare(case.project, quiet, [frame])
    if not study.segments or blocked(doubts(study)):
        return None
    identified = against_settled_loop(study, through_the_gate(study, identify(study, quiet)), check_controllers(study))
    if not identified.estimates:
        return None
    plant = updated_plant(study.model, identified.estimates).nominal
    return more_data(study.with_first_model(plant), identified.estimates, plant)


def course(case: Case, plan: MoreData) -> Array:
    """(N, n) the moves of a plan as its words say them."""
    out = np.zeros((round(plan.length / case.h), case.size))
    t = (np.arange(len(out)) + 1e-6) * case.h
    for move in plan.moves:
        c = int(move.name[2:])
        turns = np.floor(t / move.every)
        pairs = np.floor(plan.length * (1 + 1e-9) / (2 * move.every))
        out[:, c] = np.where(turns < 2 * pairs, np.where(turns % 2 == 0, move.size, -move.size), 0.0)
    return out


def answer(part: int, number: int, runs: int) -> dict:
    """One case as a line of the file."""
    case, begun = draw(part, number), time.process_time()
    plans = planned(case)
    line = {"part": part, "number": number, "kind": case.kind, "loops": case.size}
    line["limits"] = [x is not None for x in case.limits]
    line["seconds"] = round(time.process_time() - begun, 2)
    if not plans:
        return line | {"plan": "refused" if plans is None else "nothing open"}
    plan = plans[0]
    line |= {"sentence": plan.sentence, "others": len(plans) - 1}
    if not plan.moves:
        return line | {"plan": str(plan.not_worth or "none")}
    line |= {"plan": "first of two" if plan.first_of_two else "whole", "length": plan.length}
    tail = np.zeros((round(60.0 / case.h), case.size))
    now = case.moves[-1]
    after = np.vstack([course(case, plan), tail]) + now
    line |= left(case, after, runs, part, number)
    if len(case.moves) + len(after) <= MOST_SAMPLES:
        line["ratios"] = ratios(case, plan, after, runs, part, number)
    return line


def left(case: Case, after: Array, runs: int, part: int, number: int) -> dict:
    """Shares of the runs after the record that leave the limits: with the plan, and with none."""
    first = len(case.moves)
    bounds = []
    for x, declared in zip((case.record.y, case.record.u), case.limits, strict=True):
        low, high = x.min(axis=0), x.max(axis=0)
        bounds.append(np.column_stack([2 * low - high, 2 * high - low]) if declared is None else declared)
    still = np.broadcast_to(case.moves[-1], after.shape)
    found = {"left": 0, "still": 0, "how": []}
    for k in range(runs):
        e = np.vstack([case.e, np.random.default_rng([9, part, number, k]).standard_normal(after.shape)])
        for name, moves in (("left", after), ("still", still)):
            sim = case.run(np.vstack([case.moves, moves]), e)
            out = [
                np.any((x[first:] < b[:, 0]) | (x[first:] > b[:, 1]))
                for x, b in zip((sim.y, sim.u), bounds, strict=True)
            ]
            found[name] += bool(any(out))
            if name == "left" and any(out):
                found["how"].append("".join(w for w, o in zip(("PV", "OP"), out, strict=True) if o))
    return found | {"how": dict(Counter(found["how"])), "runs": runs}


def ratios(case: Case, plan: MoreData, after: Array, runs: int, part: int, number: int) -> list[dict]:
    """rms error over foretold standard error of every parameter that matters: records drawn anew, with their tests."""
    cut, moves = len(case.moves), np.vstack([case.moves, after])
    sims = [
        case.run(moves, np.random.default_rng([11, part, number, k]).standard_normal((BURN_IN + len(moves), case.size)))
        for k in range(runs)
    ]
    long = coloured(np.random.default_rng(1).standard_normal((20000, case.size)), case.noise, case.h)[BURN_IN:]
    out = []
    for i in sorted({int(s.output[2:]) for s in plan.settles if s.matters}):
        v = (long * case.sizes)[:, i]
        ar = fit_ar([v - v.mean()], [np.ones(v.size, dtype=bool)], AR_ORDER)[0]
        errors = np.array([_refitted(case, sim, cut, i, ar) for sim in sims]) - np.concatenate(case.truth[i])
        rms = np.sqrt(np.mean(errors**2, axis=0))
        names = [(j, name) for j in range(case.size) for name in case.structures[i][j].names]
        for s in plan.settles:
            if s.matters and int(s.output[2:]) == i and (int(s.input[2:]), s.parameter) in names:
                at = names.index((int(s.input[2:]), s.parameter))
                told = s.now is None or s.then < TOLD * s.now
                out.append({"ratio": float(rms[at] / (s.then / Z)), "told": told, "name": s.parameter})
    return out


def _refitted(case: Case, sim: Simulation, cut: int, i: int, ar: Array) -> Array:
    """The fit of one output to record and test, from the truth: the error of the minimum, not of a search."""
    n, segments = case.size, []
    for k, own in enumerate((slice(0, cut), slice(cut, None))):
        r, u, y = sim.r[own], sim.u[own], sim.y[own]
        t = np.arange(len(y)) * case.h
        segments.append(
            Segment(k, case.h, t, r, u, y, np.zeros((len(y), 0)), np.ones((len(y), n), dtype=bool), ("zoh",) * n)
        )
    specs = tuple(Spec(j, case.structures[i][j], tuple(case.truth[i][j])) for j in range(n))
    row = Row(specs, tuple(pieces_of(segments, i)))
    return fit_row(row, np.concatenate(case.truth[i]), ar, reweight=False, iterations=25).theta


def show(lines: list[dict]) -> None:
    """The tables."""
    print("cases:", len(lines), dict(Counter(line["plan"] for line in lines)))
    made = [line for line in lines if "left" in line]
    groups = {"all": made}
    for key in ("plan", "kind", "loops", "limits"):
        for value in sorted({str(line[key]) for line in made}):
            groups[f"{key}: {value}"] = [line for line in made if str(line[key]) == value]
    print(f"{'':28}{'plans':>6}{'left %':>8}{'still %':>9}{'above 5 %':>11}{'ratio':>7}{'quartiles':>14}{'of':>6}")
    for name, some in groups.items():
        runs = sum(line["runs"] for line in some)
        of = np.array([r["ratio"] for line in some for r in line.get("ratios", []) if r["told"]])
        q = np.quantile(of, [0.25, 0.5, 0.75]) if of.size else [np.nan] * 3
        above = sum(line["left"] > 0.05 * line["runs"] for line in some)
        print(
            f"{name:28}{len(some):6}{100 * sum(x['left'] for x in some) / runs:8.2f}"
            f"{100 * sum(x['still'] for x in some) / runs:9.2f}{above:11}{q[1]:7.2f}{q[0]:8.2f}{q[2]:6.2f}{of.size:6}"
        )
    told = [[r["ratio"] for r in line.get("ratios", []) if r["told"]] for line in made]
    by_case = [np.median(of) for of in told if of]
    whole = [r["ratio"] for line in made for r in line.get("ratios", [])]
    if whole:
        print(f"median ratio of all {len(whole)} parameters, what a plan tells nothing of included:", end=" ")
        print(round(float(np.median(whole)), 2))
    if by_case:
        print("median over cases of each case's median ratio:", round(float(np.median(by_case)), 2))
    print("CPU a plan, with its analysis:", round(float(np.median([line["seconds"] for line in lines])), 2), "s")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--part", type=int, choices=(1, 2, 3), default=1)
    parser.add_argument("--cases", type=int, default=20)
    parser.add_argument("--runs", type=int, default=30)
    parser.add_argument("--file", type=Path)
    options = parser.parse_args()
    lines = []
    if options.file and options.file.exists():
        lines = [json.loads(text) for text in options.file.read_text(encoding="utf-8").splitlines()]
    done = {(line["part"], line["number"]) for line in lines}
    for number in range(options.cases):
        if (options.part, number) in done:
            continue
        lines.append(answer(options.part, number, options.runs))
        if options.file:
            with options.file.open("a", encoding="utf-8") as file:
                file.write(json.dumps(lines[-1]) + "\n")
    wanted = [line for line in lines if line["part"] == options.part and line["number"] < options.cases]
    print(f"part {options.part}, simulated")
    show(wanted)


if __name__ == "__main__":
    main()
