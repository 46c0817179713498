"""`trueplant run` as a whole, and where its time goes: start, reading, screening, estimates, result, report.

Commands are timed as new processes, stages inside one process, first call and median of further calls. Beside them:
the interpreter alone, the import of the libraries alone, and polars reading the same files.

    python benchmarks/bench_run.py [PROJECT.toml] [--repeats 3]
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np

from trueplant import Project
from trueplant.errors import SourceError

PROJECT = Path(__file__).parent.parent / "examples" / "tclab_pid_short.toml"
LIBRARIES = "import numpy, scipy.optimize, scipy.signal, scipy.stats, numba, polars, pydantic, plotly.graph_objects"
OURS = "import trueplant.study.pipeline, trueplant.study.assemble, trueplant.report, plotly.graph_objects"


def process_times(commands: dict[str, list[str]], repeats: int) -> dict[str, float]:
    """Median wall time in s of each command, taken in turn so that a busy moment does not fall on one of them."""
    times: dict[str, list[float]] = {name: [] for name in commands}
    for command in commands.values():  # compiles and fills the disk's cache
        subprocess.run([sys.executable, *command], check=True, capture_output=True)
    for _ in range(repeats):
        for name, command in commands.items():
            begin = time.perf_counter()
            subprocess.run([sys.executable, *command], check=True, capture_output=True)
            times[name].append(time.perf_counter() - begin)
    return {name: float(np.median(values)) for name, values in times.items()}


class Clock:
    """Adds up the time from one message of the analysis to the next, under the first word of the message."""

    def __init__(self) -> None:
        self.stages: dict[str, float] = {}
        self.running: tuple[str, float] | None = None

    def __call__(self, message: str) -> None:
        now = time.perf_counter()
        if self.running is not None:
            stage, begun = self.running
            self.stages[stage] = self.stages.get(stage, 0.0) + now - begun
        self.running = (message.split()[0], now) if message else None


STAGES = {
    "project": "project file",
    "reading": "reading",
    "screening": "screening",
    "checking": "controllers checked",
    "estimating": "estimates",
    "comparing": "other methods",
    "putting": "result put together",
    "report": "report",
    "writing": "files written",
}
"""First words of the messages, and what to call them."""


def stages(path: Path, folder: Path) -> dict[str, float]:
    """Time in s of each stage of one analysis in this process."""
    from trueplant.output import write_results
    from trueplant.report import render
    from trueplant.study import pipeline
    from trueplant.study.data import prepare

    clock = Clock()
    read_record = prepare.read_record

    def reading(*args: Any, **kwargs: Any) -> Any:
        clock("reading")
        return read_record(*args, **kwargs)

    clock("project file")
    project = Project.load(path)
    with mock.patch.object(prepare, "read_record", reading):
        result = pipeline.analyse(project, clock)
    clock("report")
    page = render(result)
    clock("writing")
    write_results(result, project, folder, page)
    clock("")
    return {name: clock.stages[key] for key, name in STAGES.items() if key in clock.stages}


def read_by_polars(path: Path) -> Callable[[], None]:
    """The same files read by polars into a frame, and nothing else."""
    import polars

    project = Project.load(path)

    def read() -> None:
        for plan in project.experiments:
            polars.read_csv(plan.path, infer_schema_length=None)

    return read


def median_time(function: Callable[[], object], repeats: int) -> float:
    times = []
    for _ in range(repeats):
        begin = time.perf_counter()
        function()
        times.append(time.perf_counter() - begin)
    return float(np.median(times))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("project", nargs="?", type=Path, default=PROJECT)
    parser.add_argument("--repeats", type=int, default=3)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        try:
            first = stages(options.project, Path(folder))
        except SourceError as error:
            print(f"the records of {options.project.name} are not to be had, so nothing is timed: {error}")
            return
        again = [stages(options.project, Path(folder)) for _ in range(options.repeats)]
        commands = {
            "interpreter alone": ["-c", "pass"],
            "import trueplant": ["-c", "import trueplant"],
            "trueplant --help": ["-m", "trueplant", "--help"],
            "libraries alone": ["-c", LIBRARIES],
            "libraries and trueplant": ["-c", OURS],
            "trueplant run": ["-m", "trueplant", "run", str(options.project), "--out", folder],
        }
        processes = process_times(commands, options.repeats)
    alone = processes["interpreter alone"]
    print(f"{options.project.name}: new processes, median of {options.repeats}")
    for name, seconds in processes.items():
        print(f"  {name:24} {1000 * seconds:8.0f} ms  x{seconds / alone:6.1f} of the interpreter alone")
    libraries = processes["libraries alone"]
    added, ratio = processes["libraries and trueplant"] - libraries, processes["trueplant run"] / libraries
    print(f"  own modules add {1000 * added:.0f} ms to the libraries' import; the whole run takes x{ratio:.1f} of it")
    later = {name: float(np.median([run[name] for run in again])) for name in first}
    total = sum(later.values())
    print(f"stages in one process: first time, then median of {options.repeats}, share of {1000 * total:.0f} ms")
    for name, seconds in later.items():
        print(f"  {name:24} {1000 * first[name]:8.0f} ms {1000 * seconds:8.0f} ms {100 * seconds / total:6.1f} %")
    floor = median_time(read_by_polars(options.project), options.repeats)
    print(f"reading takes x{later['reading'] / floor:.1f} of polars.read_csv on the same files ({1000 * floor:.1f} ms)")


if __name__ == "__main__":
    main()
