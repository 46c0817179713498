"""Is the law that wrote OP confirmed, and is one whose gain is 10 % or whose integral time is 25 % off found out?

Simulated: loops drawn at random (`tests/support/laws.py`): P, PI and PID in turn, three sums of the integral, five
kinds of anti-windup, derivative on error and on PV, started at rest and not, two manual stretches, 0.25 % of PV lost or
wrong in the record alone, OP and PV rounded, OP at its limits. Prints, for each kind of law, how often the right law is
confirmed and how often each wrong one is found out, with what was said of every other one. The tests hold seeds 0 to
299.

    python benchmarks/bench_controllers.py [--first 1000] [--runs 300]
"""

from __future__ import annotations

import argparse
import sys
import time
from collections import Counter
from dataclasses import replace
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))

from support.laws import drawn
from trueplant.result import ControllerCheck
from trueplant.study.data.controller_check import check_controllers
from trueplant.study.data.prepare import prepare

DECLARED = {
    "right": {},
    "gain +10 %": {"gain": 1.1},
    "gain -10 %": {"gain": 0.9},
    "Ti +25 %": {"ti": 1.25},
    "Ti -25 %": {"ti": 0.75},
}


def checks(seed: int) -> dict[str, ControllerCheck]:
    """What is said of the right law and of the wrong ones, of one record; a P law has no integral time."""
    loop = drawn(seed)
    study = prepare(loop.project(), frames=[loop.record()])
    found = {}
    for name, factors in DECLARED.items():
        if loop.law.Ti or "ti" not in factors:
            law = loop.project(**factors).controller(0)
            found[name] = check_controllers(replace(study, records=replace(study.records, declared=(law,))))[0]
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--first", type=int, default=1000)
    parser.add_argument("--runs", type=int, default=300)
    options = parser.parse_args()
    begun = time.process_time()
    said: Counter[tuple[str, str, bool | None]] = Counter()
    for seed in range(options.first, options.first + options.runs):
        kind = "PID" if drawn(seed).law.Td else "PI" if drawn(seed).law.Ti else "P"
        for name, check in checks(seed).items():
            said[kind, name, check.confirmed] += 1
            if check.confirmed is not (name == "right"):
                print(f"seed {seed}, {kind}, {name}: {check.confirmed}: {check.message}", flush=True)
    print(f"{options.runs} simulated records, seeds {options.first} on")
    print(f"{'':6}{'declared':14}{'records':>8}{'as it should':>14}{'cannot tell':>13}{'wrong':>7}")
    for kind in ("P", "PI", "PID"):
        for name in DECLARED:
            counts = [said[kind, name, answer] for answer in (name == "right", None, name != "right")]
            if sum(counts):
                print(f"{kind:6}{name:14}{sum(counts):8}{counts[0]:14}{counts[1]:13}{counts[2]:7}")
    print(f"{time.process_time() - begun:.0f} s of CPU")


if __name__ == "__main__":
    main()
