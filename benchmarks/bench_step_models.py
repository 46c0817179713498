"""A model of step coefficients against the same model as formulas: does it find what has changed as often?

Simulated: Wood and Berry's column and the 3x3 corner y1, y2, y7 of Shell's problem under decentralised PI. The model
was made by step tests before the change: the coefficients are the mean of four steps of each input, so large that every
PV moves by at least `--clear` standard deviations of the disturbance of the records, which acts on the tests, too. The
gain, or the dead time and lag, of one element changes, and a record of operation is made, in which all set-points move
at random. Each record is analysed twice, beside the formulas (exact) and beside the coefficients. Prints how many
elements were called changed for both models, of those that have changed, by the size of the change, and of those that
have not, and how far the two models are apart with the standard error of that (paired).

    python benchmarks/bench_step_models.py [--plant wood-berry|shell] [--clear 20] [--records 100]
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import polars as pl

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))

import trueplant as tp
from support.simulated import BLT, WOOD_BERRY, coloured, random_switching
from trueplant import plants
from trueplant.loop import Controller, simulate, unstable_poles
from trueplant.lti import TransferMatrix, to_formula
from trueplant.lti.sampled import sampled_response
from trueplant.lti.structure import structure_of
from trueplant.study.pipeline import analyse

SAMPLES = 2000
STD = 0.3
"""Of the disturbance, AR(1) with 0.8, in the units of PV."""
TESTS = 4
SMALL = 0.1
"""Share of the parameter below which a change counts as small."""


@dataclass(frozen=True)
class Process:
    """Model, controller sampled at h, samples of a step test, and how the set-points move: samples between, size."""

    model: TransferMatrix
    law: Controller
    h: float
    steps: int
    dwell: float
    size: float


def process(name: str) -> Process:
    if name == "wood-berry":
        return Process(WOOD_BERRY, BLT, 1.0, 120, 20.0, 1.0)
    shell = plants.shell_3x3()
    h = 3.7
    entries = {place: replace(entry, sample_time=h) for place, entry in shell.controller.entries.items()}
    return Process(shell.model, Controller(entries, 3, 3), h, 90, 25.0, 3.0)


@dataclass(frozen=True, eq=False)
class Case:
    """A record, the step coefficients of the model, and what has changed by which factor."""

    record: dict[str, np.ndarray]
    steps: dict[str, np.ndarray]
    place: tuple[int, int]
    factor: float


def draw(name: str, seed: int, clear: float = 20.0) -> Case:
    known = process(name)
    rng = np.random.default_rng([1215, seed])
    n = known.model.shape[0]
    while True:
        place = (int(rng.integers(n)), int(rng.integers(n)))
        factor = 1 + rng.choice([-1, 1]) * rng.uniform(0.03, 0.25)
        plant = _changed(known.model, place, factor, gain=bool(rng.random() < 0.6))
        if not unstable_poles(plant, known.law):
            break
    r = known.size * random_switching(rng, SAMPLES, n, known.dwell)
    done = simulate(plant, known.law, r, known.h, v=coloured(rng, SAMPLES, n, [1, -0.8], [1], STD))
    columns = {"t": np.arange(SAMPLES) * known.h}
    for k in range(n):
        columns |= {f"sp{k}": done.r[:, k], f"pv{k}": done.y[:, k], f"op{k}": done.u[:, k]}
    steps = {}
    for j in range(n):
        noise = np.mean([coloured(rng, known.steps, n, [1, -0.8], [1], STD) for _ in range(TESTS)], axis=0)
        size = clear * STD / np.min(np.abs([known.model[i, j].dc_gain for i in range(n)]))
        for i in range(n):
            exact = sampled_response(known.model[i, j], np.ones(known.steps + 1), known.h)[1:]
            steps[f"u{j} -> y{i}"] = exact + noise[:, i] / size
    return Case(columns, steps, place, float(factor))


def _changed(model: TransferMatrix, place: tuple[int, int], factor: float, gain: bool) -> TransferMatrix:
    """One element with another gain, or with another lag and dead time."""
    structure, values = structure_of(model[place])
    moved = np.array([one * factor if structure.is_gain[k] == gain else one for k, one in enumerate(values)])
    rows = [list(row) for row in model.elements]
    rows[place[0]][place[1]] = structure.transfer(moved)
    return TransferMatrix(tuple(map(tuple, rows)), model.time_unit)


def answer(seed: int, name: str, clear: float) -> dict[str, object]:
    case, known = draw(name, seed, clear), process(name)
    n = known.model.shape[0]
    places = [(i, j) for i in range(n) for j in range(n)]
    formulas = {place: {"tf": to_formula(known.model[place])} for place in places}
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "steps.csv"
        pl.DataFrame(case.steps).write_csv(file)
        of_file = {"step": str(file), "sample_time": known.h, "structure": "fopdt"}
        coefficients = {(i, j): {**of_file, "column": f"u{j} -> y{i}"} for i, j in places}
        found = {
            form: _verdicts(case, known, model) for form, model in (("formulas", formulas), ("steps", coefficients))
        }
    return {"seed": seed, "changed": f"{case.place[0]}{case.place[1]}", "factor": case.factor, **found}


def _verdicts(case: Case, known: Process, model: dict[tuple[int, int], dict[str, object]]) -> dict[str, str]:
    n = known.model.shape[0]
    project = tp.Project(
        time_unit=known.model.time_unit,
        data={"files": ["record"], "time": "t"},
        output=[{"name": f"y{k}", "pv": f"pv{k}", "sp": f"sp{k}"} for k in range(n)],
        input=[{"name": f"u{k}", "op": f"op{k}", "actuator": "other"} for k in range(n)],
        model=[{"output": f"y{i}", "input": f"u{j}", **form} for (i, j), form in model.items()],
    )
    result = analyse(project, frames=[pl.DataFrame(case.record)])
    return {f"{e.output[1]}{e.input[1]}": str(e.verdict) for e in result.elements}


def show(answers: list[dict[str, object]]) -> None:
    def called(form: str, own: bool, small: bool | None = None) -> np.ndarray:
        return np.array(
            [
                verdict == "changed"
                for a in answers
                if small is None or (abs(a["factor"] - 1) < SMALL) == small
                for place, verdict in a[form].items()
                if (place == a["changed"]) == own
            ],
            dtype=float,
        )

    rows = [
        ("changed", True, None),
        (f"  by less than {100 * SMALL:g} %", True, True),
        ("  by more", True, False),
        ("unchanged", False, None),
    ]
    print(f"{'called changed, of those':26}{'number':>7}{'formulas':>10}{'coefficients':>14}{'apart':>16}")
    for words, own, small in rows:
        a, b = called("formulas", own, small), called("steps", own, small)
        apart, error = np.mean(b - a), np.std(b - a) / np.sqrt(a.size)
        print(
            f"{words:26}{a.size:7}{100 * a.mean():9.1f}%{100 * b.mean():13.1f}%{100 * apart:+9.1f} +- {100 * error:.1f}"
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--plant", choices=["wood-berry", "shell"], default="wood-berry")
    parser.add_argument("--clear", type=float, default=20.0, help="standard deviations that a PV moves by, at least")
    parser.add_argument("--records", type=int, default=100)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--workers", type=int, default=2)
    said = parser.parse_args()
    os.environ["OPENBLAS_NUM_THREADS"] = "1"
    begun = time.perf_counter()
    jobs = range(said.first, said.first + said.records)
    answers = []
    with ProcessPoolExecutor(said.workers, mp_context=get_context("spawn")) as pool:
        for one in pool.map(partial(answer, name=said.plant, clear=said.clear), jobs, chunksize=1):
            answers.append(one)
            print(json.dumps(one), file=sys.stderr, flush=True)
    print(f"{said.plant}: {len(answers)} simulated records of {SAMPLES} samples, seeds {jobs[0]} to {jobs[-1]}")
    print(f"four step tests an input, of at least {said.clear:g} standard deviations of the disturbance in each PV")
    show(answers)
    print(f"{time.perf_counter() - begun:.0f} s with {said.workers} workers")


if __name__ == "__main__":
    main()
