"""Every real record, alone and in groups, structures declared and free: what is said, beside what is known of each.

The records belong to others and are read from TRUEPLANT_DATA_DIR. Known are the ranges that independent output-error
fits of the same files gave (its README); lines marked "!" have an interval that lies outside, "?" a structure of their
own, whose parameters have no such range. An interval that says nothing is right.

    python benchmarks/bench_real_records.py [--only TEXT] [--words]
"""

from __future__ import annotations

import argparse
import os
import tomllib
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from copy import deepcopy
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any

os.environ["OPENBLAS_NUM_THREADS"] = "1"

import tomlkit

from trueplant import Project, Result, run
from trueplant.result import Element

EXAMPLES = Path(__file__).parent.parent / "examples"
Known = dict[tuple[int, int], dict[str, tuple[float, float]]]

PID_RIG: Known = {
    (1, 1): {"gain": (0.917, 0.918), "tau1": (167, 168), "dead_time": (15.7, 15.7)},
    (1, 2): {"gain": (0.24, 0.30), "tau1": (540, 700), "dead_time": (50, 58)},
    (2, 1): {"gain": (0.31, 0.402), "tau1": (385, 462), "dead_time": (68, 70)},
    (2, 2): {"gain": (0.545, 0.554), "tau1": (180, 184), "dead_time": (16.1, 16.1)},
}
LQG_RIG: Known = {
    (1, 1): {"gain": (0.455, 0.483), "tau1": (143, 158), "dead_time": (13, 17)},
    (1, 2): {"gain": (0.067, 0.088), "tau1": (199, 290), "dead_time": (58, 68)},
    (2, 1): {"gain": (0.143, 0.203), "tau1": (205, 322), "dead_time": (58, 78)},
    (2, 2): {"gain": (0.241, 0.250), "tau1": (141, 152), "dead_time": (13, 15)},
}
OVEN: Known = {(1, 1): {"gain": (0.62, 0.70), "tau1": (215, 340)}}
FLOW: Known = {(1, 1): {"gain": (1.4, 1.8)}}


def elsewhere(known: Known) -> Known:
    """In open loop the rigs were at other temperatures, where gains differ by up to a quarter."""
    gains = {place: of["gain"] for place, of in known.items()}
    return {place: {"gain": (low / 1.25, high * 1.25)} for place, (low, high) in gains.items()}


@dataclass(frozen=True)
class Case:
    name: str
    toml: str
    known: Known


@dataclass(frozen=True)
class Answer:
    case: Case
    status: str
    lines: tuple[str, ...]
    outside: int
    within: int
    words: str


# -- the projects ----------------------------------------------------------------------------------------------------


def cases() -> Iterator[Case]:
    for names, runs in (("01 and 02", (0, 1)), ("01", (0,)), ("02", (1,))):
        for told in ("controllers", "no controllers"):
            for free in (False, True):
                tables = read("tclab_pid_short", free=free, controllers=told == "controllers")
                tables["data"]["files"] = [tables["data"]["files"][k] for k in runs]
                yield case(f"TCLab PID {names}, {told}, {word(free)}", tables, PID_RIG)
        tables = read("tclab_pid_short")
        tables["data"]["files"] = [tables["data"]["files"][k] for k in runs]
        yield case(f"TCLab PID {names}, model of the fits", with_model(tables, PID_RIG), PID_RIG)
        tables = deepcopy(tables)
        tables["model"] = read("tclab_pid_short")["model"][:2]
        yield case(f"TCLab PID {names}, heat across not asked for", tables, PID_RIG)
        for loop in (0, 1):
            yield case(f"TCLab PID {names}, loop {loop + 1} alone", one_loop(tables, loop), PID_RIG)
    for free in (False, True):
        yield case(f"TCLab open loop, {word(free)}", read("tclab_openloop", free=free), elsewhere(PID_RIG))
        for example, words in (("tclab_lqg_arx", "ARX"), ("tclab_lqg_ml", "failed design")):
            yield case(f"TCLab LQG {words}, {word(free)}", read(example, free=free, all_declared=not free), LQG_RIG)
        yield case(f"TCLab LQG both, {word(free)}", both_lqg(free), LQG_RIG)
        yield case(f"TCLab PRBS in open loop, {word(free)}", prbs(free), elsewhere(LQG_RIG))
    for example, words in (("tclab_lqg_arx", "ARX"), ("tclab_lqg_ml", "failed design")):
        yield case(f"TCLab LQG {words}, model of the fits", with_model(read(example), LQG_RIG), LQG_RIG)
    for day in ("20180114", "20180205"):
        whole = read(f"pid_oven_{day}")
        number = len(whole["experiment"])
        groups = [(k,) for k in range(number)] + [tuple(range(number))]
        groups += list(combinations(range(number), 2)) if number == 3 else [(0, 1, 2), (3, 4, 5, 6)]
        for group in groups:
            for free in (False, True):
                for told in ("controllers", "no controllers"):
                    tables = read(f"pid_oven_{day}", free=free, controllers=told == "controllers")
                    tables["experiment"] = [tables["experiment"][k] for k in group]
                    runs = ", ".join(
                        one["file"].split("_run")[1].split("-")[0].split(".")[0] for one in tables["experiment"]
                    )
                    yield case(f"oven {day} run {runs}, {told}, {word(free)}", tables, OVEN)
    for name in ("fic10201", "fic45102c"):
        for free in (False, True):
            known = FLOW if name == "fic10201" else {}
            yield case(f"refinery {name}, {word(free)}", read(f"refinery_{name}", free=free), known)

    for example, known in (("tclab_pid_short", PID_RIG), ("tclab_lqg_arx", LQG_RIG), ("pid_oven_20180205", OVEN)):
        tables = read(example)
        for one in tables["input"]:
            one["actuator"] = "valve"
        yield case(f"{example}, heaters taken for valves", tables, known)


def word(free: bool) -> str:
    return "structures free" if free else "structures declared"


def read(example: str, free: bool = False, controllers: bool = True, all_declared: bool = False) -> dict[str, Any]:
    tables = tomllib.loads((EXAMPLES / f"{example}.toml").read_text(encoding="utf-8"))
    for element in tables["model"]:
        if free:
            element.pop("structure", None)
        elif all_declared:
            element["structure"] = "fopdt"
    if not controllers:
        tables.pop("controller", None)
        for experiment in tables.get("experiment", []):
            experiment.pop("controllers", None)
    return tables


def with_model(tables: dict[str, Any], known: Known) -> dict[str, Any]:
    """The same with a model in the middle of what is known."""
    tables = deepcopy(tables)
    outputs, inputs = ([one["name"] for one in tables[kind]] for kind in ("output", "input"))
    tables["model"] = []
    for (i, j), of in known.items():
        K, tau, D = (sum(of[name]) / 2 for name in ("gain", "tau1", "dead_time"))
        tf = f"{K:.4f} exp(-{D:.1f} s)/({tau:.0f} s + 1)"
        tables["model"].append({"output": outputs[i - 1], "input": inputs[j - 1], "tf": tf, "structure": "fopdt"})
    return tables


def one_loop(tables: dict[str, Any], loop: int) -> dict[str, Any]:
    tables = deepcopy(tables)
    name = tables["output"][loop]["name"]
    for kind in ("output", "input"):
        tables[kind] = [tables[kind][loop]]
    for kind in ("model", "controller"):
        tables[kind] = [one for one in tables[kind] if one["output"] == name]
    return tables


def both_lqg(free: bool) -> dict[str, Any]:
    tables = read("tclab_lqg_arx", free=free, all_declared=not free)
    tables["data"]["files"] += read("tclab_lqg_ml")["data"]["files"]
    return tables


def prbs(free: bool) -> dict[str, Any]:
    tables = read("tclab_lqg_arx", free=free, all_declared=not free)
    del tables["data"]["files"]
    tables["experiment"] = [{"file": "dataset:tclab_lqg/openloop_prbs.csv", "loop": "open"}]
    for output in tables["output"]:
        del output["sp"]
    return tables


def case(name: str, tables: dict[str, Any], known: Known) -> Case:
    return Case(name, tomlkit.dumps(tables), known)


# -- what is said of them --------------------------------------------------------------------------------------------


def answer(case: Case) -> Answer:
    result = run(Project.from_toml(case.toml))
    said = [one for element in result.elements for one in lines_of(element, case.known.get(place_of(element), {}))]
    lines, rights = [line for line, _ in said], [right for _, right in said]
    return Answer(case, str(result.status), tuple(lines), rights.count(False), rights.count(True), words_of(result))


def place_of(element: Element) -> tuple[int, int]:
    """By the numbers at the ends of the names; 1 where they have none."""
    i, j = ((int(name[-1]) if name[-1].isdigit() else 1) for name in (element.output, element.input))
    return i, j


def lines_of(element: Element, known: dict[str, tuple[float, float]]) -> Iterator[tuple[str, bool | None]]:
    head = f"{element.output} <- {element.input}: {element.structure}, {element.verdict}"
    head += f" (instead of {element.rejected_structure})" if element.rejected_structure else ""
    yield head + (f": {element.reason}" if element.reason and not element.parameters else ""), None
    for p in element.parameters:
        if p.plant is None or p.ci is None:
            yield f"    {p.name}: not answered", None
            continue
        right = None
        if p.name in known and element.structure == "fopdt":
            low, high = known[p.name]
            right = p.ci[0] <= high and p.ci[1] >= low
        elif p.name == "gain" and p.name in known:
            right = p.ci[0] <= known[p.name][1] and p.ci[1] >= known[p.name][0]
        mark = {None: "?" if known else " ", True: " ", False: "!"}[right]
        star = "*" if p.changed else " "
        yield (
            f"  {mark} {p.name}: {p.plant:.4g} [{p.ci[0]:.4g}, {p.ci[1]:.4g}]{star}  known {known.get(p.name, '')}",
            right,
        )


def words_of(result: Result) -> str:
    return "\n".join(f"    {line}" for line in str(result).splitlines())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default="", help="records whose name holds this")
    parser.add_argument("--words", action="store_true", help="what is said in words as well")
    parser.add_argument("--workers", type=int, default=2)
    options = parser.parse_args()
    if not os.environ.get("TRUEPLANT_DATA_DIR"):
        print("the real records are not part of the project: name their folder in TRUEPLANT_DATA_DIR")
        return
    wanted = [one for one in cases() if options.only in one.name]
    found: list[Answer] = []
    with ProcessPoolExecutor(options.workers) as pool:
        for one in pool.map(answer, wanted):
            found.append(one)
            print(f"\n{one.case.name}: {one.status}", *one.lines, sep="\n", flush=True)
            if options.words:
                print(one.words, flush=True)
    summary(found)


def summary(found: Sequence[Answer]) -> None:
    print(f"\n{len(found)} projects; intervals that reach what is known, and that do not")
    for one in found:
        if one.outside:
            print(f"  {one.case.name}: {one.within}, {one.outside}")
    print(f"  all: {sum(one.within for one in found)}, {sum(one.outside for one in found)}")


if __name__ == "__main__":
    main()
