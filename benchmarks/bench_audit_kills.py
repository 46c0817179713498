"""Audits whose processes are killed (SIGKILL) at random moments, beside one that nobody disturbed.

    python benchmarks/bench_audit_kills.py [--loops 200] [--kills 50] [--seed 20261124] [--seconds S] [--out FOLDER]

The loops are small (600 simulated samples; a quarter of their plants changed). A scheduler and two workers of Dask run
on this machine; each kill takes the client, a worker or the scheduler, in random order, so many of each kind. What was
killed is started again, and what is missing is audited again; between kills a few rows are taken away, so that there is
work to do. One kill in four falls at any moment of the start, the others after the audit has written a row of its own,
since on a busy machine they would all hit processes that have not begun. In the end the table is compared with that of
the undisturbed audit. With --seconds the kills end earlier, and their number is said. POSIX only.
"""

from __future__ import annotations

import argparse
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

import polars as pl

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from fleet.conftest import CHANGED, MODEL, SITE, write_loop

MEASURED = ["cpu_s", "memory_mb", "since"]
"""What two audits of the same data may differ in."""
TAKEN = 8
"""Rows that are taken away before each kill, but never more than half of them."""
STARTING = 0.25
"""Share of the kills that may fall before any work."""
PATIENCE = 180.0
"""Seconds to wait for a row."""


class Cluster:
    """A scheduler at a port of this machine, and two workers."""

    def __init__(self, folder: Path, port: int) -> None:
        self.folder, self.address, self.port = folder, f"tcp://127.0.0.1:{port}", port
        self.own: dict[str, subprocess.Popen[bytes]] = {}

    def ready(self) -> None:
        """Start what does not run."""
        own = ["--port", str(self.port)]
        self._start("scheduler", "dask_scheduler", "--host", "127.0.0.1", "--no-dashboard", *own)
        for k in range(2):
            threads = ["--nthreads", "1", "--no-dashboard", "--host", "127.0.0.1", "--no-nanny"]
            self._start(f"worker {k}", "dask_worker", self.address, *threads)

    def _start(self, name: str, module: str, *arguments: str) -> None:
        process = self.own.get(name)
        if process is None or process.poll() is not None:
            command = [sys.executable, "-m", f"distributed.cli.{module}", *arguments]
            self.own[name] = subprocess.Popen(
                command, cwd=self.folder, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
            )

    def kill(self, victim: str, chance: random.Random) -> None:
        name = f"worker {chance.randrange(2)}" if victim == "worker" else victim
        self.own[name].kill()
        self.own[name].wait()

    def end(self) -> None:
        for process in self.own.values():
            process.kill()
            process.wait()


def begun(site: Path, out: str, *options: str) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "trueplant", "audit", str(site), "--out", str(site.parent / out), *options]
    return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)


def whole(site: Path, out: str, *options: str) -> pl.DataFrame:
    """The table of an audit that runs to its end."""
    process = begun(site, out, *options)
    _, said = process.communicate()
    if process.returncode != 0:
        raise SystemExit(f"an audit that nobody disturbed ended with {process.returncode}: {said}")
    return last(site, out)


def last(site: Path, out: str) -> pl.DataFrame:
    file = sorted((site.parent / out).glob("run=*/audit.parquet"))[-1]
    return pl.read_parquet(file, hive_partitioning=False).drop(MEASURED).sort("loop")


def at_work(process: subprocess.Popen[str], site: Path, before: set[Path]) -> bool:
    """Wait until the audit has written a row; False where it ended, or wrote none for long."""
    end = time.monotonic() + PATIENCE
    while process.poll() is None and time.monotonic() < end:
        if set((site.parent / "killed" / "loops").glob("*.json")) - before:
            return True
        time.sleep(0.05)
    return False


def disturbed(site: Path, cluster: Cluster, kills: list[str], chance: random.Random, end: float) -> Counter[str]:
    """How many of each kind were killed while an audit ran, and how audits ended that lost their scheduler."""
    done: Counter[str] = Counter()
    process: subprocess.Popen[str] | None = None
    for victim in kills:
        if time.monotonic() > end:
            break
        rows = sorted((site.parent / "killed" / "loops").glob("*.json"))
        for row in chance.sample(rows, k=min(TAKEN, len(rows) // 2)):
            row.unlink(missing_ok=True)
        cluster.ready()
        if process is None or process.poll() is not None:
            process = begun(site, "killed", "--dask", cluster.address)
        there = set((site.parent / "killed" / "loops").glob("*.json"))
        if chance.random() < STARTING:
            done["killed at the start"] += 1
        else:
            done["killed at work"] += at_work(process, site, there)
        time.sleep(chance.uniform(0.0, 6.0))
        if process.poll() is not None:
            done[f"audit over before the kill, status {process.returncode}"] += 1
        elif victim == "client":
            process.send_signal(signal.SIGKILL)
            process.wait()
        else:
            cluster.kill(victim, chance)
        done[victim] += 1
        if victim == "scheduler" and process.poll() is None:
            try:
                _, said = process.communicate(timeout=90)
                done[f"scheduler gone, status {process.returncode}"] += 1
                done["traceback"] += "Traceback" in said or "internal error" in said
            except subprocess.TimeoutExpired:
                done["scheduler gone, audit still waits after 90 s"] += 1
                process.kill()
                process.wait()
    if process is not None and process.poll() is None:
        process.kill()
        process.wait()
    return done


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--loops", type=int, default=200)
    parser.add_argument("--kills", type=int, default=50, help="of each kind")
    parser.add_argument("--seed", type=int, default=20261124)
    parser.add_argument("--seconds", type=float, default=float("inf"))
    parser.add_argument("--port", type=int, default=18786)
    parser.add_argument("--out", type=Path)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        folder = given.out or Path(scratch)
        folder.mkdir(parents=True, exist_ok=True)
        for k in range(given.loops):
            write_loop(folder / "units", f"loop{k:03}", CHANGED if k % 4 == 0 else MODEL, k)
        site = folder / "site.toml"
        site.write_text(SITE, encoding="utf-8")
        began = time.monotonic()
        undisturbed = whole(site, "whole", "--workers", "2")
        print(f"{given.loops} loops undisturbed: {time.monotonic() - began:.0f} s; seed {given.seed}", flush=True)
        chance = random.Random(given.seed)
        kills = [victim for victim in ("client", "worker", "scheduler") for _ in range(given.kills)]
        chance.shuffle(kills)
        cluster = Cluster(folder, given.port)
        try:
            done = disturbed(site, cluster, kills, chance, time.monotonic() + given.seconds)
        finally:
            cluster.end()
        found = whole(site, "killed", "--workers", "2")
        print(*(f"{what}: {number}" for what, number in sorted(done.items())), sep="\n")
        left = list((folder / "killed" / "loops").glob(".*"))
        print(f"the same table: {found.equals(undisturbed, null_equal=True)}; files left behind: {len(left)}")


if __name__ == "__main__":
    os.environ["PYTHONPATH"] = os.pathsep.join(
        [str(Path(__file__).parents[1] / "src"), os.environ.get("PYTHONPATH", "")]
    )
    main()
