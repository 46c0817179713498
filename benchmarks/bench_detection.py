"""False alarms and power of the verdicts, beside partial correlation and the plant-model ratio on the same records.

Simulated: Wood-Berry (h = 1 min, dead times off the grid) and the mill (h = 0.25 min), every set-point switching
at random at once, coloured disturbances. The model is the plant before its change. Each record goes through
`trueplant.detect.verdicts`, the test that `trueplant run` makes, and through both detectors. A line of JSON a record
is appended to the file, and records that are there are not simulated again: the study can be stopped and gone on with.
A change that makes the loop unstable (Wood-Berry, +4 min in 11) is judged under the slower controller.

    python benchmarks/bench_detection.py [--file runs.jsonl] [--nulls 1000] [--power 200] [--workers 2] [--plant NAME]
    python benchmarks/bench_detection.py --file runs.jsonl --report
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from multiprocessing import get_context
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))

from support.simulated import BLT, WOOD_BERRY, coloured, random_switching, segment_of
from trueplant import detect, plants
from trueplant.loop import Controller, simulate, unstable_poles
from trueplant.lti import TransferMatrix
from trueplant.lti.structure import structure_of

LEVEL = 0.05
AR1, OTHER = ([1, -0.8], [1]), ([1, -1.5, 0.6], [1, -0.4])
MILL = plants.mill()
MILL_H = 0.25


@dataclass(frozen=True)
class Setting:
    model: TransferMatrix
    controller: Controller
    retuned: Controller
    h: float
    samples: int
    switching: float
    """Mean samples between the moves of a set-point."""
    setpoint: tuple[float, float]
    std: tuple[float, float]


def sampled(controller: Controller, h: float, gain: float = 1.0, integral: float = 1.0) -> Controller:
    entries = {
        place: replace(pid, sample_time=h, Kc=pid.Kc * gain, Ti=pid.Ti * integral)
        for place, pid in controller.entries.items()
    }
    return Controller(entries, controller.n_u, controller.n_y)


SETTINGS = {
    "wood-berry": Setting(WOOD_BERRY, BLT, sampled(BLT, 1.0, 0.7, 1.4), 1.0, 1000, 20.0, (2.0, 2.0), (0.3, 0.3)),
    "mill": Setting(
        MILL.model,
        sampled(MILL.controller, MILL_H),
        sampled(MILL.controller, MILL_H, 0.7, 1.4),
        MILL_H,
        1000,
        20.0,
        (1.0, 5.0),
        (0.03, 0.4),
    ),
}
NULLS = ("nothing", "disturbance", "controller")
CHANGES = ("gain +10 %", "gain -10 %", "lag +20 %", "lag -20 %", "dead time +1", "dead time +4")
PLACES = [(i, j) for i in range(2) for j in range(2)]
POWER = tuple(f"{change} in {i + 1}{j + 1}" for i, j in PLACES for change in CHANGES)


def changed(setting: Setting, case: str) -> TransferMatrix:
    """The plant of a case: the model with one element changed. Lags, delayed gains and dead times change together."""
    if case in NULLS:
        return setting.model
    what, place = case.split(" in ")
    i, j = int(place[0]) - 1, int(place[1]) - 1
    structure, values = structure_of(setting.model[i, j])
    p = values.copy()
    for k, name in enumerate(structure.names):
        if (what[:3], name[:3]) in {("gai", "gai"), ("lag", "tau")}:
            p[k] *= 1 + float(what.split()[1]) / 100
        elif what.startswith("dead") and name.startswith("dead"):
            p[k] += float(what.split()[-1]) * setting.h
    rows = [list(row) for row in setting.model.elements]
    rows[i][j] = structure.transfer(p)
    return TransferMatrix(tuple(tuple(row) for row in rows), setting.model.time_unit)


def run(job: tuple[str, str, int]) -> dict:
    """One record through all three."""
    name, case, seed = job
    setting = SETTINGS[name]
    rng = np.random.default_rng([seed, sorted(SETTINGS).index(name), (*NULLS, *POWER).index(case)])
    r = random_switching(rng, setting.samples, 2, setting.switching) / 2 * np.array(setting.setpoint)
    a, c = OTHER if case == "disturbance" else AR1
    v = coloured(rng, setting.samples, 2, a, c, 1.0) * np.array(setting.std) * (2 if case == "disturbance" else 1)
    plant = changed(setting, case)
    slower = case == "controller" or unstable_poles(plant, setting.controller) > 0
    controller = setting.retuned if slower else setting.controller
    segment = segment_of(simulate(plant, controller, r, setting.h, v=v))
    begun = time.perf_counter()
    ours = detect.verdicts([segment], setting.model)
    seconds = time.perf_counter() - begun
    signals = detect.signals_of([segment], setting.model)
    others = {
        "partial": detect.partial_correlation(signals, LEVEL),
        "ratio": detect.plant_model_ratio(signals, setting.model, LEVEL),
    }
    line = {"plant": name, "case": case, "seed": seed, "seconds": round(seconds, 3)}
    line["verdicts"] = [ours[place].verdict for place in PLACES]
    line["p"] = [ours[place].p_adjusted for place in PLACES]
    for key, found in others.items():
        line[key] = [round(float(x), 5) for x in found.statistic.ravel()]
        line[f"{key}_limit"] = round(float(found.threshold.max()), 5)
    return line


def wilson(hits: int, count: int) -> tuple[float, float]:
    """95 % interval of a share."""
    z, share = 1.96, hits / count
    centre = (share + z**2 / (2 * count)) / (1 + z**2 / count)
    half = z / (1 + z**2 / count) * np.sqrt(share * (1 - share) / count + z**2 / (4 * count**2))
    return centre - half, centre + half


def jobs(names: list[str], nulls: int, power: int) -> list[tuple[str, str, int]]:
    """All records, ordered so that every case has about the same share of its number at any time."""
    wanted = [((k + 0.5) / nulls, n, case, k) for n in names for case in NULLS for k in range(nulls)]
    wanted += [((k + 0.5) / power, n, case, k) for n in names for case in POWER for k in range(power)]
    return [(n, case, k) for _, n, case, k in sorted(wanted)]


def read(path: Path) -> list[dict]:
    return [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []


def study(path: Path, wanted: list[tuple[str, str, int]], workers: int) -> None:
    done = {(line["plant"], line["case"], line["seed"]) for line in read(path)}
    left = [job for job in wanted if job not in done]
    print(f"{len(done)} records there, {len(left)} to go")
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool, path.open("a") as file:
        for line in pool.map(run, left, chunksize=10):
            file.write(json.dumps(line) + "\n")
            file.flush()


def share(hits: int, count: int) -> str:
    low, high = wilson(hits, count)
    return f"{100 * hits / count:.1f} ({100 * abs(low):.1f}..{100 * high:.1f})"


def flags(lines: list[dict], key: str, limit: float | None = None) -> np.ndarray:
    """(n, 4) which elements were called changed, by a detector's own threshold or by `limit`."""
    if key == "ours":
        return np.array([[v == "changed" for v in line["verdicts"]] for line in lines])
    return np.array([[x > (limit or line[f"{key}_limit"]) for x in line[key]] for line in lines])


def report(path: Path) -> None:
    """Tables in Markdown. Power is compared at thresholds that flag 5 % of the records without a change."""
    lines = read(path)
    for name in SETTINGS:
        own = [line for line in lines if line["plant"] == name]
        same = [line for line in own if line["case"] in NULLS]
        if not same:
            continue
        print(f"\n{name}: false alarms anywhere in the matrix at the {100 * LEVEL:.0f} % level, in per cent")
        print("\n| changed | records | verdicts | partial correlation | plant-model ratio |\n|---|---|---|---|---|")
        for case in (*NULLS, "all three"):
            mine = [line for line in same if case in (line["case"], "all three")]
            cells = [share(int(flags(mine, k).any(axis=1).sum()), len(mine)) for k in ("ours", "partial", "ratio")]
            print(f"| {case} | {len(mine)} | {' | '.join(cells)} |")
        limit = {key: float(np.quantile([max(line[key]) for line in same], 1 - LEVEL)) for key in ("partial", "ratio")}
        print(f"\n{name}: changes found in the right element, in per cent, thresholds at 5 % false alarms\n")
        print("| change | records | verdicts | partial correlation | plant-model ratio | refused | others flagged |")
        print("|---|---|---|---|---|---|---|")
        for case in POWER:
            mine = [line for line in own if line["case"] == case]
            if not mine:
                continue
            k = PLACES.index((int(case[-2]) - 1, int(case[-1]) - 1))
            hit = [int(flags(mine, key, limit.get(key))[:, k].sum()) for key in ("ours", "partial", "ratio")]
            refused = sum(line["verdicts"][k] == "not identifiable" for line in mine)
            beside = int(np.delete(flags(mine, "ours"), k, axis=1).any(axis=1).sum())
            cells = [share(h, len(mine)) for h in hit]
            print(f"| {case} | {len(mine)} | {' | '.join(cells)} | {refused} | {beside} |")
        seconds = np.median([line["seconds"] for line in own])
        refused = np.mean([v == "not identifiable" for line in own for v in line["verdicts"]])
        print(f"\nmedian {seconds:.2f} s for the verdicts of one record; {100 * refused:.2f} % of all elements refused")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--file", type=Path, help="where records are kept; without it in a file that is thrown away")
    parser.add_argument("--nulls", type=int, default=20, help="records of each case without a change")
    parser.add_argument("--power", type=int, default=2, help="records of each change")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--plant", choices=sorted(SETTINGS), action="append")
    parser.add_argument("--report", action="store_true", help="only print the tables")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        path = options.file or Path(folder) / "records.jsonl"
        if not options.report:
            study(path, jobs(options.plant or sorted(SETTINGS), options.nulls, options.power), options.workers)
        report(path)


if __name__ == "__main__":
    main()
