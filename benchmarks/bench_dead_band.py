"""Historians that store a PV when it left a dead band: is an unchanged plant called changed, a changed one found?

Simulated loops of the demo site (flow, pressure, level, temperature, cascade) with seeds of their own, ten days each.
Their PV is stored only where it is further from the last stored value than some standard deviations of its noise, and
comes back on straight lines. Each is analysed as `trueplant audit` does it, once with the plant of the model and once
with a gain 40 % larger. Printed by band: share of the samples stored, plants called changed, 95 % intervals that hold
the truth.

    python benchmarks/bench_dead_band.py [--runs 3] [--bands 1 2 3]
"""

from __future__ import annotations

import argparse
import tempfile
from collections import Counter
from datetime import timedelta
from pathlib import Path

import polars as pl

from trueplant.connect import ensure
from trueplant.fleet.demo import END
from trueplant.fleet.demo.simulate import kept
from trueplant.fleet.demo.site import events_of
from trueplant.fleet.demo.templates import template_of
from trueplant.fleet.demo.truth import KINDS, Fault, Kind, Truth
from trueplant.lti.structure import structure_of
from trueplant.project import Project
from trueplant.project.exclusions import all_but_usable
from trueplant.result import ElementVerdict
from trueplant.study.pipeline import analyse
from trueplant.tracking.find import find

SINGLE = [kind for kind in KINDS if len(kind.Kc) == 1]
START = END - timedelta(days=10)
SEED = 70_000


def stored(kind: Kind, fault: Fault, band: float, seed: int) -> tuple[pl.DataFrame, float]:
    """The events of a loop, and the share of the PV that was stored."""
    # a cascade whose name ends in 8 has another lag instead of another gain
    events = events_of(Truth(f"{kind.prefix}1", kind, fault, seed), START)
    pv = pl.col("tag").str.ends_with(f"{kind.prefix}1.PV")
    own = events.filter(pv)
    keep = kept(own["value"].to_numpy(), band * kind.noise * kind.move[0])
    return pl.concat([events.filter(~pv), own.filter(pl.Series(keep))]), float(keep.mean())


def run(folder: Path, kind: Kind, fault: Fault, band: float, seed: int, counts: Counter[str]) -> float:
    """One analysis, into `counts`."""
    events, share = stored(kind, fault, band, seed)
    (folder / "lake" / "all").mkdir(parents=True, exist_ok=True)
    events.write_parquet(folder / "lake" / "all" / "events.parquet")
    text = template_of(kind).replace("{{name}}", f"{kind.prefix}1")
    window = f"[data]\nfrom = {START.isoformat()}\nto = {END.isoformat()}\n"
    (folder / "loop.toml").write_text(text.replace("[data]\n", window), encoding="utf-8")
    (folder / "loop-snapshot.parquet").unlink(missing_ok=True)
    project = Project.load(folder / "loop.toml")
    ensure(project)
    usable = find(project)
    result = analyse(project.with_exclusions(all_but_usable(project, usable)))
    (element,) = result.elements
    counts["changed" if element.verdict == ElementVerdict.CHANGED else "not"] += 1
    truth = structure_of(project.model_matrix()[0, 0])[1]
    for parameter, true in zip(element.parameters, truth, strict=False):
        if parameter.ci is not None and len(element.parameters) == len(truth):
            true = true * (1.4 if fault == Fault.STEP and parameter.name in ("gain", "slope") else 1.0)
            counts["inside"] += parameter.ci[0] <= true <= parameter.ci[1]
            counts["intervals"] += 1
    return share


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--runs", type=int, default=3, help="of each kind of loop")
    parser.add_argument("--bands", type=float, nargs="+", default=[1.0, 2.0, 3.0])
    given = parser.parse_args()
    for band in given.bands:
        for fault in (Fault.NONE, Fault.STEP):
            counts: Counter[str] = Counter()
            with tempfile.TemporaryDirectory() as scratch:
                shares = [
                    run(Path(scratch), kind, fault, band, SEED + 100 * k + seed, counts)
                    for k, kind in enumerate(SINGLE)
                    for seed in range(given.runs)
                ]
            print(
                f"band {band:g}, {'gain 40 % larger' if fault == Fault.STEP else 'unchanged'}: "
                f"{100 * sum(shares) / len(shares):.0f} % stored; {counts['changed']} of {len(shares)} called changed; "
                f"intervals hold {counts['inside']} of {counts['intervals']}",
                flush=True,
            )


if __name__ == "__main__":
    main()
