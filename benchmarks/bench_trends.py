"""A long record on the screen Trends of the app: seconds to its first view, milliseconds of a zoom, memory.

    python benchmarks/bench_trends.py [--samples 10000000] [--points 1500]

Two simulated loops with a stamp a second as Parquet. A view is what a browser asks for: lowest and highest of each
stretch of a few widths of the record, for SP, PV and OP of both loops. The peers are polars, which reads the same
columns, and the same view from raw samples, without the stored level.
"""

from __future__ import annotations

import argparse
import resource
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
from scipy.signal import lfilter

from trueplant.app.screens.records import Records, Shown
from trueplant.project import Project
from trueplant.project.draft import draft_project
from trueplant.project.look import look
from trueplant.record.readers import read_table

WIDTHS = (1.0, 0.5, 0.1, 0.02, 0.001)
REPEATED = 5


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--samples", type=int, default=10_000_000)
    parser.add_argument("--points", type=int, default=1500)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "record.parquet"
        written(path, options.samples)
        peer, _ = _timed(lambda: pl.read_parquet(path))
        project = path.with_suffix(".toml")
        project.write_text(draft_project(path.name, look(read_table(path))), encoding="utf-8")
        loaded = Project.load(project)
        records = Records()
        seconds, shown = _timed(lambda: records.get(loaded, loaded.experiments[0]))
        held = sum(one.x.nbytes + one.low.nbytes + one.high.nbytes for one in shown.signals.values()) + shown.t.nbytes
        print(
            f"{options.samples:,} samples: read in {seconds:.1f} s (polars alone {peer:.1f} s), "
            f"{held / 1e6:.0f} MB kept, {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6:.1f} GB at most"
        )
        struck = ((float(shown.t[100]), float(shown.t[5000]), "all"),)
        seconds, gone = _timed(lambda: shown.without(struck))
        print(f"a stretch struck from all signals in {1e3 * seconds:.0f} ms")
        for width in WIDTHS:
            view = _best(lambda: _view(gone, width, options.points))  # noqa: B023
            raw = _best(lambda: _raw(gone, width, options.points))  # noqa: B023
            print(f"view of {100 * width:g} %: {1e3 * view:.1f} ms, from raw samples {1e3 * raw:.1f} ms")


def _view(shown: Shown, width: float, points: int) -> Any:
    start = float(shown.t[0]) + 0.3 * (1 - width) * float(shown.t[-1])
    return shown.view(start, start + width * float(shown.t[-1]), points)


def _raw(shown: Shown, width: float, points: int) -> Any:
    first = int(0.3 * (1 - width) * shown.t.size)
    end = first + int(width * shown.t.size)
    edges = np.unique(np.linspace(first, end - 1, points + 1).astype(int)[:-1]) - first
    parts = [one.shown(first, end) for one in shown.signals.values()]
    return [(np.fmin.reduceat(x, edges), np.fmax.reduceat(x, edges)) for x in parts]


def written(path: Path, samples: int) -> None:
    columns: dict[str, Any] = {"time": pl.Series(np.arange(samples) * 1_000_000).cast(pl.Datetime("us", "UTC"))}
    for k in (1, 2):
        rng = np.random.default_rng(k)
        sp = np.repeat(rng.normal(50, 3, samples // 20_000 + 1), 20_000)[:samples]
        pv = 50 + lfilter([0.05], [1, -0.95], sp - 50) + 0.1 * rng.normal(size=samples)
        columns |= {f"FIC{k}.SP": sp, f"FIC{k}.PV": pv, f"FIC{k}.OP": 50 + 2 * (sp - pv)}
    pl.DataFrame(columns).write_parquet(path)


def _timed(work: Callable[[], Any]) -> tuple[float, Any]:
    begun = time.perf_counter()
    done = work()
    return time.perf_counter() - begun, done


def _best(work: Callable[[], Any]) -> float:
    return min(_timed(work)[0] for _ in range(REPEATED))


if __name__ == "__main__":
    main()
