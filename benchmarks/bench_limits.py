"""Records with OP at its limits for long, and records of which a fifth can be used, in pieces; all simulated.

First: two loops under saturating PI, each OP at a limit in 30 to 40 % of the samples, set-points moved apart, in turn
and often (or --at 0.7: in about that share of the samples). Second: one loop of 6000 samples, of which 80 % are bad:
PV in bursts of some 60 ("pv"), PV here and there ("scattered"), or whole rows in bursts of some 240 ("rows"). The noise
is AR(1), the plant unchanged. Prints how many are refused, coverage of the 95 % intervals, answers beyond 4 standard
errors, and false alarms.

    python benchmarks/bench_limits.py [--runs 60] [--at 0.7] [--pieces 104]
"""

from __future__ import annotations

import argparse
from collections import Counter
from dataclasses import dataclass, field

import numpy as np
from scipy.signal import lfilter

import trueplant as tp
from trueplant.errors import TrueplantError
from trueplant.loop import PID, Controller, Simulation, alternating_steps, simulate, unstable_poles
from trueplant.lti import Structure, TransferMatrix, to_formula
from trueplant.notebook.loops import project_of
from trueplant.study.data.excitation import blocked, doubts
from trueplant.study.data.prepare import prepare
from trueplant.study.plant.elements import judge
from trueplant.study.plant.identified import identify
from trueplant.study.plant.updated import updated_plant
from trueplant.study.study import quiet
from trueplant.tune import METHODS, Choices

Array = np.ndarray
FOPDT = Structure.parse("fopdt")
PIECES = ("pv", "scattered", "rows")


@dataclass(frozen=True, eq=False)
class Case:
    """A record and what it was made from."""

    truth: list[list[Array]]
    frame: dict[str, Array]
    loops: list[tp.Loop]


def _parameters(rng: np.random.Generator, diagonal: bool) -> Array:
    gain = rng.uniform(1, 3) * (1.0 if diagonal else rng.uniform(0.15, 0.5)) * rng.choice([-1.0, 1.0])
    return np.array([gain, 10 * np.exp(rng.uniform(np.log(0.5), np.log(2))), rng.uniform(1, 10)])


def _noise(rng: np.random.Generator, samples: int, sizes: Array) -> Array:
    pole = np.exp(-1 / rng.uniform(2, 10))
    white = rng.standard_normal((samples, sizes.size))
    return lfilter([1], [1, -pole], white, axis=0) * np.sqrt(1 - pole**2) * sizes


def _pi(element) -> PID:
    found = METHODS["simc"](element, Choices(kind="PI"))
    return PID(Kc=found.Kc, Ti=found.Ti, sample_time=1.0)


def saturated(seed: int, share: float | None = None, samples: int = 1500) -> tuple[Case, Simulation, Array]:
    """Two saturating loops, their simulation and the shares of the samples with each OP at a limit."""
    for attempt in range(500):
        rng = np.random.default_rng([15, seed, attempt])
        truth = [[_parameters(rng, i == j) for j in range(2)] for i in range(2)]
        plant = TransferMatrix(tuple(tuple(FOPDT.transfer(p) for p in row) for row in truth), "min")
        slow = [_pi(plant[k, k]) for k in range(2)]
        law = Controller.diagonal([PID(Kc=c.Kc / 1.5, Ti=c.Ti, sample_time=1.0) for c in slow])
        try:
            if unstable_poles(plant, law):
                continue
        except TrueplantError:
            continue
        kind = ("apart", "in turn", "often")[seed % 3]
        if kind == "in turn":
            r = alternating_steps(samples, 1.0, 60.0, np.ones(2))
        else:
            flips = rng.random((samples, 2)) < 1 / (60 if kind == "apart" else 35)
            r = np.where(np.cumsum(flips, axis=0) % 2 == 1, 1.0, -1.0) * rng.uniform(0.7, 1.5, 2)
            r[:20] = 0
        v = _noise(rng, samples, np.std(simulate(plant, law, r, 1.0).y, axis=0) * rng.uniform(0.05, 0.25, 2))
        found = _limited(plant, law, r, v, rng.uniform(0.3, 0.4, 2) if share is None else np.full(2, share))
        if found is None:
            continue
        simulation, limits, at = found
        frame, loops = {"time": simulation.t}, []
        for k in range(2):
            columns = {"sp": simulation.r, "op": simulation.u, "pv": simulation.y}
            frame |= {f"{name}{k}": x[:, k] for name, x in columns.items()}
            limit = (float(limits[k, 0]), float(limits[k, 1]))
            loops.append(tp.Loop(f"L{k}", pv=f"pv{k}", sp=f"sp{k}", op=f"op{k}", op_limits=limit))
        return Case(truth, frame, loops), simulation, at
    raise RuntimeError(f"no loops with such limits in 500 draws for seed {seed}")


def _limited(
    plant: TransferMatrix, law: Controller, r: Array, v: Array, wanted: Array
) -> tuple[Simulation, Array, Array] | None:
    """The loops with limits that hold each OP in about the wanted share of the samples."""
    free = simulate(plant, law, r, 1.0, v=v)
    tails = wanted / 2
    for _ in range(30):
        limits = np.array([np.quantile(free.u[:, k], [tails[k], 1 - tails[k]]) for k in range(2)])
        if np.any(limits[:, 0] >= 0) or np.any(limits[:, 1] <= 0):
            return None
        found = simulate(plant, law, r, 1.0, v=v, limits=limits)
        at = np.mean((found.u <= limits[:, 0]) | (found.u >= limits[:, 1]), axis=0)
        if np.all(np.abs(at - wanted) < 0.03):
            return found, limits, at
        tails = np.clip(tails * (1 + 0.5 * (wanted / np.maximum(at, 0.01) - 1)), 0.01, 0.49)
    return None


def in_pieces(seed: int, kind: str, samples: int = 6000) -> Case:
    """One loop of which a fifth can be used."""
    rng = np.random.default_rng([16, seed])
    theta = _parameters(rng, True)
    plant = TransferMatrix(((FOPDT.transfer(theta),),), "min")
    law = _pi(plant[0, 0])
    r = np.where(np.cumsum(rng.random((samples, 1)) < 1 / 60, axis=0) % 2 == 1, 1.0, 0.0)
    r[:20] = 0
    v = _noise(rng, samples, np.array([rng.uniform(0.05, 0.3)]))
    s = simulate(plant, Controller.diagonal([law]), r, 1.0, v=v)
    frame = {"time": s.t, "sp": s.r[:, 0] + 50, "op": s.u[:, 0] + 40, "pv": s.y[:, 0] + 50}
    if kind == "pv":
        frame["pv"] = np.where(_bursts(rng, samples, 15), frame["pv"], np.nan)
    elif kind == "scattered":
        frame["pv"] = np.where(rng.random(samples) < 0.2, frame["pv"], np.nan)
    else:
        rows = _bursts(rng, samples, 60)
        frame = {name: x[rows] for name, x in frame.items()}
    return Case([[theta]], frame, [tp.Loop("L0", pv="pv", sp="sp", op="op", controller=law)])


def _bursts(rng: np.random.Generator, samples: int, good: int) -> Array:
    """True in stretches of that mean length, four times as far apart."""
    out = np.zeros(samples, dtype=bool)
    at = int(rng.integers(0, 5 * good))
    while at < samples:
        length = int(rng.geometric(1 / good))
        out[at : at + length] = True
        at += length + int(rng.geometric(1 / (4 * good)))
    return out


@dataclass
class Tally:
    records: int = 0
    refused: int = 0
    alarms: int = 0
    far: int = 0
    hits: list[bool] = field(default_factory=list)
    verdicts: Counter = field(default_factory=Counter)

    def add(self, case: Case) -> None:
        """One record through all stages of an analysis that its verdicts need."""
        self.records += 1
        n = len(case.loops)
        model = {
            (f"L{i}", f"L{j}"): {"tf": to_formula(FOPDT.transfer(case.truth[i][j]), 17), "structure": "fopdt"}
            for i in range(n)
            for j in range(n)
        }
        study = prepare(project_of(["record"], case.loops, model, None, "min", {}), quiet, [case.frame])
        if not study.segments or blocked(doubts(study)):
            self.refused += 1
            return
        identified = identify(study, quiet)
        judged = judge(study, identified, updated_plant(study.model, identified.estimates).nominal)
        self.alarms += any(e.verdict == "changed" for e in judged.elements)
        for e in judged.elements:
            self.verdicts[str(e.verdict)] += 1
            theta = case.truth[int(e.output[1])][int(e.input[1])]
            for p, true in zip(e.parameters, theta, strict=True):
                if p.plant is not None and p.ci is not None:
                    self.hits.append(bool(p.ci[0] <= true <= p.ci[1]))
                    self.far += bool(abs(p.plant - true) > 4 * (p.std_error or np.inf))

    def __str__(self) -> str:
        covered = 100 * np.mean(self.hits) if self.hits else np.nan
        return (
            f"{self.records} records, {self.refused} refused, {self.alarms} false alarms; {covered:.1f} % of "
            f"{len(self.hits)} intervals cover, {self.far} answers beyond 4 standard errors; {dict(self.verdicts)}"
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=12)
    parser.add_argument("--at", type=float)
    parser.add_argument("--pieces", type=int, default=4)
    options = parser.parse_args()
    limits, either = Tally(), []
    for seed in range(options.runs):
        case, simulation, _ = saturated(seed, options.at)
        edges = np.array([loop.op_limits for loop in case.loops])
        either.append(float(np.mean(((simulation.u <= edges[:, 0]) | (simulation.u >= edges[:, 1])).any(axis=1))))
        limits.add(case)
    if either:
        print(
            f"OPs at their limits, one or another in {100 * np.mean(either):.0f} % of the samples: {limits}", flush=True
        )
    for kind in PIECES:
        pieces = Tally()
        for seed in range(options.pieces):
            pieces.add(in_pieces(seed, kind))
        print(f"a fifth is usable, {kind}: {pieces}", flush=True)


if __name__ == "__main__":
    main()
