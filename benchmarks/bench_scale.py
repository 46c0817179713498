"""Long and wide records through `trueplant check`: seconds, and memory beside that of the columns as numbers.

    python benchmarks/bench_scale.py [--samples 2000000 30000000] [--loops 4 1] [--other 0 0] [--folder FOLDER]

One simulated record (loops that follow their set-points, noise, a stamp a second) for each number of samples, with its
loops and `other` columns that nobody names, as CSV and as Parquet. Memory is the most that the process held beyond what
a `check` of 2,000 samples holds, divided by 8 bytes for each sample of each named column and of time. The peer is
polars, which reads the same columns of the same file.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import time
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import polars as pl
from scipy.signal import lfilter


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--samples", type=int, nargs="+", default=[2_000_000, 30_000_000])
    parser.add_argument("--loops", type=int, nargs="+", default=[4, 1])
    parser.add_argument("--other", type=int, nargs="+", default=[0, 0])
    parser.add_argument("--folder", type=Path)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(dir=options.folder) as folder:
        empty = _measured(_checked(_written(Path(folder), 2000, 1, 0, "csv")))[1]
        print(f"a check of 2,000 samples holds {empty / 1e6:.0f} MB")
        for samples, loops, other in zip(options.samples, options.loops, options.other, strict=True):
            for ending in ("csv", "parquet"):
                project = _written(Path(folder), samples, loops, other, ending)
                named = 8 * samples * (3 * loops + 1)
                seconds, held = _measured(_checked(project))
                peer, peer_held = _measured(_read(project.with_name(f"record.{ending}"), 3 * loops + 1))
                print(
                    f"{samples:,} samples of {3 * loops + 1} columns (+ {other}) as {ending}: {seconds:.1f} s, "
                    f"{(held - empty) / named:.2f} times the columns; polars reads them in {peer:.1f} s, "
                    f"{peer_held / named:.2f} times"
                )


def _written(folder: Path, samples: int, loops: int, other: int, ending: str) -> Path:
    rng = np.random.default_rng(1)
    start = datetime(2024, 1, 1)
    stamps = pl.datetime_range(start, start + timedelta(seconds=samples - 1), "1s", time_unit="us", eager=True)
    columns: dict[str, object] = {"time": stamps}
    text = ['time_unit = "s"\n[data]\ntime = "time"\nmax_samples = 1_000_000_000\n' + f'files = ["record.{ending}"]\n']
    for k in range(loops):
        sp = np.repeat(50 + rng.integers(-3, 4, samples // 3600 + 1), 3600)[:samples].astype(float)
        pole = np.exp(-1 / 120)
        late = np.concatenate([np.full(60, sp[0]), sp[:-60]]) - sp[0]
        noise = lfilter([1.0], [1.0, -0.98], rng.normal(0, 0.02, samples))
        pv = np.round(lfilter([1 - pole], [1.0, -pole], late) + sp[0] + noise, 3)
        op = np.round(20 + 0.5 * (sp - pv) + np.cumsum(sp - pv) / 600, 3)
        columns |= {f"sp{k}": sp, f"pv{k}": pv, f"op{k}": op}
        text += [
            f'[[output]]\nname = "y{k}"\npv = "pv{k}"\nsp = "sp{k}"\n[[input]]\nname = "u{k}"\nop = "op{k}"\n',
            f'[[model]]\noutput = "y{k}"\ninput = "u{k}"\ntf = "exp(-60 s)/(120 s + 1)"\n',
        ]
    columns |= {f"other{k}": rng.normal(size=samples).round(3) for k in range(other)}
    frame = pl.DataFrame(columns)
    getattr(frame, f"write_{ending}")(folder / f"record.{ending}")
    (folder / "project.toml").write_text("".join(text), encoding="utf-8")
    return folder / "project.toml"


def _checked(project: Path) -> list[str]:
    return [sys.executable, "-m", "trueplant", "check", str(project)]


def _read(record: Path, columns: int) -> list[str]:
    read = f"import polars as pl; pl.read_{record.suffix[1:]}({str(record)!r}, columns=list(range({columns})))"
    return [sys.executable, "-c", read]


def _measured(command: list[str]) -> tuple[float, float]:
    """Seconds of a command, and the most bytes that it held."""
    watched = (
        "import resource, subprocess, sys; subprocess.run(sys.argv[1:], stdout=subprocess.DEVNULL); "
        "print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)"
    )
    begin = time.perf_counter()
    done = subprocess.run([sys.executable, "-c", watched, *command], capture_output=True, text=True, check=True)
    unit = 1 if sys.platform == "darwin" else 1024
    return time.perf_counter() - begin, unit * float(done.stdout)


if __name__ == "__main__":
    main()
