"""Verdicts and intervals over plants, loops, disturbances and actuators drawn at random, all simulated.

Each record goes through all of an analysis that its verdicts need; with --whole through the rest of `tp.run` as well,
which changes none of them. Prints, over all and by condition: false alarms per unchanged record,
coverage of the 95 % intervals (± one standard error, the parameters of one record counted as a cluster), answers
more than 4 standard errors off, and elements without a verdict although a test as good as the Cramer-Rao bound of the
record, made like the product's on all elements at once, would tell a change of 20 %; and the power where the change is
beyond what that bound can tell.

There are two halves: 1 to build with, 2 to look at once. With --unchanged only those of the records that no element
of the plant has changed in, which is where false alarms come from. Answers are kept in the file, a line a record, and
a later call goes on from there.

    python benchmarks/bench_random_plants.py [--half 1] [--first 0] [--records 400] [--file answers.jsonl] [--workers 2]
        [--whole] [--scale 10] [--finer 30] [--loops 4] [--unchanged]
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections import defaultdict
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))

from random_plants import FACTORS, SCALE, STRUCTURES, Answer, Sampled, analysed, bounds, draw, levels_of

from trueplant.detect import detectable_change

LEVEL = 0.05
TELLS = 1.96 + 0.84
"""Standard errors that a change needs to be seen in four of five records at that level, if nothing else is tested."""
WORTH_KNOWING = 0.2


def answer(job: tuple[int, int, bool, Sampled]) -> dict:
    """One record as a line of the file."""
    half, number, whole, sampled = job
    case = draw(half, number, sampled)
    begun = time.process_time()
    result = analysed(case, whole)
    spent = time.process_time() - begun
    least = bounds(case)
    found = {(e.output, e.input): e for e in result.elements}
    elements = []
    for i in range(case.size):
        for j in range(case.size):
            structure, truth, errors = case.structures[i][j], case.truth[i][j], np.sqrt(np.diag(least[i][j]))
            said = found.get((f"L{i}", f"L{j} OP"))
            given = {p.name: p for p in said.parameters} if said else {}
            elements.append(
                {
                    "at": [i, j],
                    "structure": str(structure),
                    "changed": bool(np.any(truth != case.model[i][j])),
                    "detectable": detectable_change(
                        structure, truth, least[i][j], case.size**2, LEVEL, structure.lag(truth)
                    ),
                    "alone": _detectable(structure, truth, errors),
                    "apart": _apart(structure, truth, case.model[i][j], errors),
                    "verdict": str(said.verdict) if said else "refused",
                    "reason": said.reason if said else "",
                    "follows": _follows(result, i, j),
                    "parameters": [
                        _parameter(name, t, b, given.get(name))
                        for name, t, b in zip(structure.names, truth, errors, strict=True)
                    ],
                }
            )
    return {
        "half": half,
        "number": number,
        "scale": sampled.scale,
        "finer": sampled.finer,
        "levels": case.levels,
        "status": result.status,
        "codes": list(result.codes),
        "headline": result.headline,
        "seconds": round(spent, 2),
        "elements": elements,
    }


def _follows(result: Answer, i: int, j: int) -> float | None:
    """p-value that the prediction errors of output i do not follow input j."""
    return float(result.estimates[i].cross_p[j]) if i in result.estimates else None


def _parameter(name: str, truth: float, bound: float, said) -> dict:
    row = {"name": name, "truth": truth, "bound": bound}
    if said is None or said.plant is None or said.ci is None:
        return row
    return row | {"plant": said.plant, "error": said.std_error, "ci": list(said.ci), "changed": bool(said.changed)}


def _sizes(structure, theta) -> np.ndarray:
    """What a change of each parameter is measured by: itself, and the lag as well for a dead time."""
    lag = structure.lag(theta)
    sizes = np.abs(theta)
    return np.where(structure.is_dead_time, sizes + lag, np.where(structure.is_lead, np.maximum(sizes, lag), sizes))


def _detectable(structure, theta, errors) -> float:
    """The largest of its parameters' relative changes that the bound can just tell."""
    return float(np.max(TELLS * errors / _sizes(structure, theta)))


def _apart(structure, theta, model, errors) -> float:
    """How many standard errors of the bound the most changed parameter is from the model."""
    return float(np.max(np.abs(theta - model) / np.maximum(errors, 1e-300)))


class Tally:
    """Counts of one condition."""

    def __init__(self) -> None:
        self.alarms: list[bool] = []
        self.hits: list[tuple[int, int]] = []
        self.far, self.told = 0, 0
        self.refused: list[bool] = []
        self.power: list[bool] = []
        self.elsewhere: list[bool] = []

    def add(self, line: dict, structure: str | None = None) -> None:
        chosen = [e for e in line["elements"] if structure is None or e["structure"] == structure]
        if not chosen:
            return
        hits = total = 0
        for element in chosen:
            for p in element["parameters"]:
                if "ci" not in p:
                    continue
                total += 1
                hits += p["ci"][0] <= p["truth"] <= p["ci"][1]
                self.far += abs(p["plant"] - p["truth"]) > 4 * (p["error"] or np.inf)
            if element["detectable"] < WORTH_KNOWING:
                self.refused.append(element["verdict"] not in ("changed", "unchanged"))
        self.told += total
        if total:
            self.hits.append((hits, total))
        wrong = any(e["verdict"] == "changed" and not e["changed"] for e in chosen)
        if line["levels"]["plant"] == "unchanged":
            self.alarms.append(wrong)
        else:
            self.elsewhere.append(wrong)
            self.power += [e["verdict"] == "changed" for e in chosen if e["changed"] and e["apart"] > 5]

    def row(self, name: str) -> str:
        hits, totals = (np.array([pair[k] for pair in self.hits], dtype=float) for k in (0, 1))
        covered = hits.sum() / max(totals.sum(), 1)
        spread = np.sqrt(np.sum((hits - covered * totals) ** 2)) / max(totals.sum(), 1)
        return (
            f"{name:30}{len(self.alarms):6}{_percent(self.alarms):>9}{_percent(self.elsewhere):>11}"
            f"{100 * covered:10.1f} ±{100 * spread:4.1f}{100 * self.far / max(self.told, 1):9.2f}{self.told:8}"
            f"{_percent(self.refused):>10}{len(self.refused):6}{_percent(self.power):>9}{len(self.power):6}"
        )


def _percent(flags: list[bool]) -> str:
    return f"{100 * np.mean(flags):.1f}" if flags else "-"


def show(lines: list[dict]) -> None:
    """The table."""
    print(
        f"{'':30}{'unch.':>6}{'alarms %':>9}{'elsewh. %':>11}{'covered %':>16}{'>4 se %':>9}{'of':>8}"
        f"{'refused %':>10}{'of':>6}{'power %':>9}{'of':>6}"
    )
    tallies: dict[str, Tally] = defaultdict(Tally)
    for line in lines:
        tallies["all"].add(line)
        for factor, level in line["levels"].items():
            tallies[f"{factor}: {level}"].add(line)
        for structure in STRUCTURES:
            tallies[f"elements: {structure}"].add(line, structure)
    order = ["all", *(f"{f}: {v}" for f, levels in FACTORS.items() for v in levels)]
    for name in order + [f"elements: {s}" for s in STRUCTURES]:
        print(tallies[name].row(name))
    with_valve = [line for line in lines if line["levels"]["actuator"] in ("backlash", "stick-slip")]
    without = [line for line in lines if line not in with_valve]
    for text, some in (("with a sticking valve", with_valve), ("without one", without)):
        claimed = sum("cause-valve-sticking" in line["codes"] for line in some)
        print(f"a valve is said to stick in {claimed} of {len(some)} records {text}")
    refusals: dict[str, int] = defaultdict(int)
    for line in lines:
        if line["status"] == "refused":
            for code in line["codes"]:
                refusals[code] += 1
    single = [e for line in lines for e in line["elements"] if e["alone"] < WORTH_KNOWING]
    without_verdict = sum(e["verdict"] not in ("changed", "unchanged") for e in single)
    print(f"were nothing else tested, the bound would tell 20 % of {len(single)}: {without_verdict} have no verdict")
    print("records refused whole:", sum(line["status"] == "refused" for line in lines), dict(refusals))
    print(f"CPU a record: {np.mean([line['seconds'] for line in lines]):.2f} s")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--half", type=int, choices=(1, 2), default=1)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--records", type=int, default=400)
    parser.add_argument("--file", type=Path)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--whole", action="store_true")
    parser.add_argument("--scale", type=float, default=SCALE, help="minutes that all times are drawn around")
    parser.add_argument("--finer", type=int, default=1, help="samples for each that there would be else")
    parser.add_argument("--loops", type=int, default=4, help="only records of so many loops at most")
    parser.add_argument("--unchanged", action="store_true", help="only records whose plant has not changed")
    options = parser.parse_args()
    lines = []
    if options.file and options.file.exists():
        lines = [json.loads(text) for text in options.file.read_text(encoding="utf-8").splitlines()]
    sampled = Sampled(options.scale, options.finer)
    lines = [line for line in lines if Sampled(line.get("scale", SCALE), line.get("finer", 1)) == sampled]
    done = {(line["half"], line["number"]) for line in lines}
    numbers = [
        k
        for k in range(options.first, options.first + options.records)
        if not options.unchanged or levels_of(options.half, k)["plant"] == "unchanged"
        if int(levels_of(options.half, k)["loops"]) <= options.loops
    ]
    jobs = [(options.half, k, options.whole, sampled) for k in numbers if (options.half, k) not in done]
    for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
        os.environ[name] = "1"  # a process is a thread: there is one for each core
    with ProcessPoolExecutor(options.workers, mp_context=get_context("spawn")) as pool:
        for line in pool.map(answer, jobs):
            lines.append(line)
            if options.file:
                with options.file.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(line) + "\n")
    wanted = [line for line in lines if line["half"] == options.half and line["number"] in numbers]
    print(f"half {options.half}, {len(wanted)} simulated records")
    show(wanted)


if __name__ == "__main__":
    main()
