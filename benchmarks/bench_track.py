"""Tracking on simulated Wood-Berry records: false alarms, changes found and told apart, coverage of their instant.

    python benchmarks/bench_track.py [runs a case] [word of the case's name]

Every record has 6,000 samples of 1 min, BLT controllers, set-points that switch at random every 20 min on average,
an AR(1) disturbance of standard deviation 0.3 in each output; seeds 0, 1, 2, ... The process itself changes
(tests/support/changing.py), so that its state runs on over the change.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from support.changing import changing_wood_berry, write_project
from support.simulated import Simulation
from trueplant import Project
from trueplant.result import Track
from trueplant.tracking.track import track

SAMPLES = 6000
X = np.arange(SAMPLES)


@dataclass(frozen=True)
class Case:
    """A kind of record, the element that changes (if any), the kind of its change, and since when."""

    make: Callable[[int], Simulation]
    element: tuple[str, str] | None = None
    kind: str = ""
    time: float | None = None


CASES = {
    "nothing changes": Case(lambda seed: changing_wood_berry(seed, SAMPLES)),
    "only the disturbance doubles": Case(
        lambda seed: changing_wood_berry(seed, SAMPLES, level=np.where(X >= 3000, 2.0, 1.0))
    ),
    "no set-point moves for a third": Case(lambda seed: changing_wood_berry(seed, SAMPLES, quiet=(2500, 4500))),
    "gain of reflux -> top +20 % at 3300": Case(
        lambda seed: changing_wood_berry(seed, SAMPLES, (0, 0), gain=np.where(X >= 3300, 1.2, 1.0)),
        ("reflux", "top"),
        "step",
        3300.0,
    ),
    "time constant of steam -> bottom drifts by 40 %": Case(
        lambda seed: changing_wood_berry(seed, SAMPLES, (1, 1), tau=1 + 0.4 * X / SAMPLES),
        ("steam", "bottom"),
        "drift",
    ),
}


def followed(simulation: Simulation) -> Track:
    with tempfile.TemporaryDirectory() as folder:
        return track(Project.load(write_project(simulation, Path(folder))))


def line(case: Case, tracks: list[Track]) -> str:
    others = sum(any((c.input, c.output) != case.element for c in t.changes) for t in tracks)
    if case.element is None:
        return f"called a change in {others} of {len(tracks)}"
    own = [[c for c in t.changes if (c.input, c.output) == case.element] for t in tracks]
    kinds = [c[0].kind if len(c) == 1 else "several" if c else "missed" for c in own]
    told = ", ".join(f"{kind} {kinds.count(kind)}" for kind in sorted(set(kinds)))
    text = f"{told} of {len(tracks)}; another element too in {others}"
    steps = [c for cs in own for c in cs if c.kind == "step"]
    if case.time is not None and steps:
        covered = sum(c.interval[0] - 1 <= case.time <= c.interval[1] + 1 for c in steps)
        width = np.median([c.interval[1] - c.interval[0] for c in steps])
        text += f"; interval covers {covered} of {len(steps)}, median width {width:.0f} min"
    return text


def main() -> None:
    runs = int(sys.argv[1]) if len(sys.argv) > 1 else 20
    wanted = sys.argv[2] if len(sys.argv) > 2 else ""
    for name, case in CASES.items():
        if wanted not in name:
            continue
        print(f"{name}: {line(case, [followed(case.make(seed)) for seed in range(runs)])}", flush=True)


if __name__ == "__main__":
    main()
