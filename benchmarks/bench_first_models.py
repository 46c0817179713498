"""A first model from the record alone: are the elements that are there found, those that are not left out?

Simulated: two loops of one kind (flow, pressure, level, temperature) under PI, an element between them in half of the
cases each way, set-points that move at random, an AR(1) disturbance. The project has no model, and says of what kind
each output is unless `--no-kinds`. Prints for each kind: elements found of those that are there, the true structure, a
smaller one whose step response lies within the truth's 95 % band, coverage of gain and dead time, and elements answered
that are not there.

    python benchmarks/bench_first_models.py [--records 200] [--workers 2] [--no-kinds] [--first 0]
"""

from __future__ import annotations

import argparse
import os
import sys
from collections import defaultdict
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import polars as pl

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))

import trueplant as tp
from support.simulated import coloured, random_switching
from trueplant.loop import PID, Controller, simulate
from trueplant.lti import TransferMatrix, tf
from trueplant.lti.sampled import sampled_response
from trueplant.lti.structure import structure_of
from trueplant.study.pipeline import analyse

SAMPLES = 2000


@dataclass(frozen=True)
class Kind:
    """Ranges from which a loop is drawn, in seconds and engineering units; the interval in seconds."""

    h: float
    gain: tuple[float, float]
    lag: tuple[float, float]
    """Of a level none: its gain is a slope."""
    second: tuple[float, float] | None
    """Second lag, as a share of the first."""
    dead_time: tuple[float, float]
    structure: str
    dwell: float
    """Samples from one move of a set-point to the next, on average."""


KINDS = {
    "flow": Kind(1.0, (0.5, 3.0), (2.0, 6.0), None, (0.5, 2.5), "fopdt", 25.0),
    "pressure": Kind(2.0, (0.02, 0.2), (15.0, 60.0), None, (2.0, 8.0), "fopdt", 40.0),
    "level": Kind(10.0, (0.002, 0.02), (0.0, 0.0), None, (10.0, 60.0), "integrator", 80.0),
    "temperature": Kind(30.0, (0.3, 2.0), (400.0, 900.0), (0.25, 0.6), (30.0, 150.0), "sopdt", 80.0),
}


@dataclass(frozen=True, eq=False)
class Case:
    """A simulated record, and what made it."""

    kind: str
    truth: dict[tuple[int, int], str]
    record: dict[str, np.ndarray]


def draw(seed: int) -> Case:
    rng = np.random.default_rng([76, seed])
    name = list(KINDS)[seed % len(KINDS)]
    kind = KINDS[name]
    own = [_element(kind, rng, 1.0) for _ in range(2)]
    there = rng.random(2) < 0.5
    across = [_element(kind, rng, 0.4) for _ in range(2)]
    cells = [[own[0].text, across[0].text if there[0] else "0"], [across[1].text if there[1] else "0", own[1].text]]
    law = Controller.diagonal([_pi(one, kind) for one in own])
    flips = random_switching(rng, SAMPLES, 2, kind.dwell)
    size = np.array([1.0 if kind.lag[1] == 0 else abs(one.gain) for one in own])
    r = flips * 5.0 * size
    v = coloured(rng, SAMPLES, 2, [1, -0.8], [1], 0.25) * size
    done = simulate(TransferMatrix.of(cells, "s"), law, r, kind.h, v=v)
    columns = {"t": np.arange(SAMPLES) * kind.h}
    for k in range(2):
        columns |= {f"sp{k}": done.r[:, k], f"pv{k}": done.y[:, k], f"op{k}": done.u[:, k]}
    truth = {(i, j): cells[i][j] for i in range(2) for j in range(2) if cells[i][j] != "0"}
    return Case(name, truth, columns)


@dataclass(frozen=True)
class _Element:
    gain: float
    lag: float
    second: float
    dead_time: float
    text: str


def _element(kind: Kind, rng: np.random.Generator, scale: float) -> _Element:
    gain = scale * rng.uniform(*kind.gain) * (1 if scale == 1 else rng.choice([-1, 1]))
    lag, dead = rng.uniform(*kind.lag), rng.uniform(*kind.dead_time)
    second = lag * rng.uniform(*kind.second) if kind.second else 0.0
    lags = " ".join(f"({one:.5g} s + 1)" for one in (lag, second) if one) if lag else "s"
    return _Element(gain, lag, second, dead, f"{gain:.6g} exp(-{dead:.5g} s)/({lags})")


def _pi(one: _Element, kind: Kind) -> PID:
    """SIMC (Skogestad 2003), for twice the closed-loop time that it calls tight."""
    theta = one.dead_time + one.second / 2 + kind.h / 2
    lag = one.lag + one.second / 2
    slope = one.gain / lag if lag else one.gain
    closed = 2 * max(theta, 0.5 * lag / 5)
    kc, ti = 1 / slope / (closed + theta), 4 * (closed + theta)
    return PID(Kc=kc, Ti=min(lag, ti) if lag else ti, sample_time=kind.h)


def answer(seed: int, kinds: bool) -> dict[str, object]:
    case = draw(seed)
    said = {"kind": case.kind} if kinds else {}
    project = tp.Project(
        time_unit="s",
        data={"files": ["record"], "time": "t"},
        output=[{"name": f"y{k}", "pv": f"pv{k}", "sp": f"sp{k}", **said} for k in range(2)],
        input=[{"name": f"u{k}", "op": f"op{k}", "actuator": "other"} for k in range(2)],
    )
    result = analyse(project, frames=[pl.DataFrame(case.record)])
    found = {}
    for element in result.elements:
        place = (int(element.output[1]), int(element.input[1]))
        found[f"{place[0]}{place[1]}"] = _judged(case, place, element, result)
    return {"seed": seed, "kind": case.kind, "headline": result.headline, "elements": found}


def _judged(case: Case, place: tuple[int, int], element: object, result: object) -> dict[str, object]:
    told = {"verdict": str(element.verdict), "structure": element.structure, "there": place in case.truth}
    if place not in case.truth or element.tf_plant is None:
        return told
    structure, values = structure_of(tf(case.truth[place]))
    told["right"] = element.structure == str(structure)
    told["within"] = _within(case, place, result)
    told["smaller"] = len(element.parameters) < len(values)
    known = {p.name: p.ci for p in element.parameters if p.ci is not None}
    for name, value in zip(structure.names, values, strict=True):
        if name in known and told["right"]:
            told[name] = bool(known[name][0] <= value <= known[name][1])
    return told


def _within(case: Case, place: tuple[int, int], result: object) -> bool:
    """Does the true step response lie within the 95 % band of the plant's, at 19 of 20 of its instants?"""
    curves = result.curves
    t = curves.step_t
    truth = sampled_response(tf(case.truth[place]), np.ones(t.size), t[1])
    low, high = (band[:, place[0], place[1]] for band in (curves.step_low, curves.step_high))
    return bool(np.mean((truth >= low) & (truth <= high)) >= 0.95)


def show(answers: list[dict[str, object]]) -> None:
    print(f"{'kind':12}{'there':>6}{'found':>7}{'right':>7}{'or small':>9}{'absent':>8}{'answered':>9}  coverage")
    for kind in [*KINDS, "all"]:
        cells = [e for a in answers if kind in (a["kind"], "all") for e in a["elements"].values()]
        there = [e for e in cells if e["there"]]
        found = [e for e in there if "right" in e]
        right = [e for e in found if e["right"]]
        small = [e for e in found if not e["right"] and e["smaller"] and e["within"]]
        absent = [e for e in cells if not e["there"]]
        wrong = [e for e in absent if e["verdict"] == "found"]
        cover = defaultdict(list)
        for e in right:
            for name in ("gain", "slope", "tau1", "tau2", "dead_time"):
                if name in e:
                    cover[name].append(e[name])
        told = ", ".join(f"{name} {100 * np.mean(c):.1f}" for name, c in cover.items())
        print(f"{kind:12}{len(there):6}{len(found):7}{len(right):7}{len(small):9}{len(absent):8}{len(wrong):9}  {told}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--records", type=int, default=200)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--no-kinds", action="store_true")
    said = parser.parse_args()
    os.environ["OPENBLAS_NUM_THREADS"] = "1"
    jobs = range(said.first, said.first + said.records)
    with ProcessPoolExecutor(said.workers, mp_context=get_context("spawn")) as pool:
        answers = list(pool.map(partial(answer, kinds=not said.no_kinds), jobs, chunksize=1))
    for a in answers:
        for place, e in a["elements"].items():
            if e["there"] != (e["verdict"] == "found") or not (e.get("right", True) or e.get("within", True)):
                print(a["seed"], a["kind"], place, e)
    show(answers)


if __name__ == "__main__":
    main()
