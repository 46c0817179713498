"""An audit of the demo site beside its truth, and what its workers cost beside a plain loop.

    python benchmarks/bench_audit.py [--site small|whole|none] [--loops N] [--minutes M] [--long N] [--out FOLDER]

The small site has 24 loops over 10 days, the whole one 60 over 30. N quick loops (20) of M minutes (300; two samples a
minute) measure the workers: all ratios are taken in one run on warm caches. Bytes are those of the machine's loopback
meanwhile, so they are at most what the audit sent. With --long one worker goes over as many loops, and what it holds is
said by quarters.
"""

from __future__ import annotations

import argparse
import shutil
import sys
import tempfile
import time
from datetime import timedelta
from pathlib import Path

import polars as pl

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from fleet.conftest import CHANGED, MODEL, SITE, write_loop
from trueplant.cli.levels import SMALL, SMALL_DAYS, WHOLE
from trueplant.fleet import Audited, Options, Site, audit
from trueplant.fleet.demo import END, START, judge, write_site
from trueplant.fleet.demo import SITE as DEMO
from trueplant.fleet.demo.judge import lines
from trueplant.fleet.row import Outcome


def timed(site: Path, out: Path, workers: int) -> tuple[float, float, Audited]:
    """Wall time, CPU time of the loops, and what came out, of an audit into a folder that is emptied first."""
    shutil.rmtree(out, ignore_errors=True)
    began = time.perf_counter()
    found = audit(Site.load(site), out, Options(workers=workers))
    return time.perf_counter() - began, sum(one.row.cpu_s for one in found.loops), found


def against_truth(folder: Path, whole: bool) -> None:
    """Found, missed, false and refused, by kind of fault."""
    per_kind, start = (WHOLE, START) if whole else (SMALL, END - timedelta(days=SMALL_DAYS))
    truths = write_site(folder, per_kind, start)
    began = time.perf_counter()
    found = audit(Site.load(folder / DEMO), folder / "audit", Options(workers=2))
    wall = time.perf_counter() - began
    table = pl.read_parquet(found.run / "audit.parquet", hive_partitioning=False)
    print(f"{len(truths)} loops over {(END - start).days} days, {wall:.0f} s with two workers")
    loops = table.group_by("loop").agg(pl.first("cpu_s", "memory_mb"))
    print(
        f"loops with a row: {len(loops)}; {loops['cpu_s'].sum():.0f} s CPU; at most {loops['memory_mb'].max():.0f} MB"
    )
    for kind in dict.fromkeys(truth.kind.name for truth in truths):
        own = loops.filter(pl.col("loop").is_in([truth.name for truth in truths if truth.kind.name == kind]))["cpu_s"]
        print(f"CPU s a loop, {kind}: median {own.median():.1f}, largest {own.max():.1f}")
    print(*lines(judge(truths, found.loops)), sep="\n")


def workers(folder: Path, number: int, minutes: int) -> None:
    """Two workers against one, one against a plain loop, memory, bytes.

    A third of the loops come first: they warm all caches up, and what a further loop takes is free of the start.
    """
    few, site, out = (
        quick_site(folder / "few", number // 3, minutes),
        quick_site(folder, number, minutes),
        folder / "out",
    )
    for k in (0, 1, 2):
        timed(few, out, k)
    (one_few, _, _), (two_few, _, _) = timed(few, out, 1), timed(few, out, 2)
    plain, cpu, _ = timed(site, out, 0)
    before = loopback()
    one, cpu_one, _ = timed(site, out, 1)
    sent = loopback() - before
    two, cpu_two, found = timed(site, out, 2)
    nothing = time.perf_counter()
    audit(Site.load(site), out, Options(workers=2))
    nothing = time.perf_counter() - nothing
    further = (one - one_few) / (two - two_few)
    print(f"{number} loops of {2 * minutes} samples: plain {plain:.1f} s, one worker {one:.1f} s, two {two:.1f} s")
    print(f"CPU of the loops: plain {cpu:.1f} s, one worker {cpu_one:.1f} s, two workers {cpu_two:.1f} s")
    print(f"{number // 3} of them: one worker {one_few:.1f} s, two {two_few:.1f} s")
    print(f"two workers are {one / two:.2f} times one with their start, {further:.2f} times by what further loops take")
    print(f"one worker takes {one - plain:.1f} s more than a plain loop")
    print(f"memory of a worker, by quarters: {by_quarters(found)}")
    print(f"at most {sent / number / 1024:.0f} kB over the wire a loop; an audit with nothing new: {nothing:.2f} s")


def long(folder: Path, number: int) -> None:
    """Does a worker hold more after many loops than after few?"""
    wall, _, found = timed(quick_site(folder, number), folder / "out", 1)
    failed = sum(one.row.outcome is Outcome.FAILED for one in found.loops)
    print(
        f"one worker over {number} loops, {wall:.0f} s, {failed} failed; its memory, by quarters: {by_quarters(found)}"
    )


def quick_site(folder: Path, number: int, minutes: int = 300) -> Path:
    """A site file, and small loops of which a quarter have changed."""
    for k in range(number):
        write_loop(folder / "units", f"loop{k:03}", CHANGED if k % 4 == 0 else MODEL, k, minutes)
    site = folder / "site.toml"
    site.write_text(SITE, encoding="utf-8")
    return site


def by_quarters(found: Audited) -> str:
    """The largest memory of a worker in each quarter of the loops, in their order."""
    memory = [row.row.memory_mb or 0.0 for row in sorted(found.loops, key=lambda row: row.name)]
    quarters = [memory[k * len(memory) // 4 : (k + 1) * len(memory) // 4] for k in range(4)]
    return ", ".join(f"{max(quarter, default=0.0):.0f}" for quarter in quarters) + " MB"


def loopback() -> int:
    """Bytes that the machine has sent to itself."""
    for line in Path("/proc/net/dev").read_text().splitlines():
        name, _, cells = line.partition(":")
        if name.strip() == "lo":
            return int(cells.split()[8])
    return 0


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--site", choices=["small", "whole", "none"], default="small")
    parser.add_argument("--loops", type=int, default=20)
    parser.add_argument("--minutes", type=int, default=300)
    parser.add_argument("--long", type=int, default=0)
    parser.add_argument("--out", type=Path)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        folder = given.out or Path(scratch)
        if given.loops:
            workers(folder / "workers", given.loops, given.minutes)
        if given.long:
            long(folder / "long", given.long)
        if given.site != "none":
            against_truth(folder / "site", given.site == "whole")


if __name__ == "__main__":  # workers import this file
    main()
