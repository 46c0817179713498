"""`trueplant run` over an existing result, killed at random moments: what is left, and what is made of it next?

A sound project of one loop is analysed again and again, with another model each time, in processes that are killed
(SIGKILL): every other one at a random moment of the analysis, the rest before an opening, moving or removing of a file
of the result, each of these in turn in random order. Prints how often the folder held the old result, the new one, or a
mixture or litter that `repair` then made one of them; a run at the end has to leave no other file behind. Exits with 1
where anything else was found.

    python benchmarks/kills.py [--kills 200] [--seed 0]
"""

from __future__ import annotations

import argparse
import json
import os
import random
import signal
import sys
import tempfile
import time
from collections import Counter
from importlib import import_module
from itertools import count, cycle
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))

from support.command import PROJECT
from trueplant.cli import main as command
from trueplant.output import read_results

for module in ("trueplant.report", "trueplant.study.pipeline"):
    import_module(module)  # once, before the forks; polars is not used here: its threads do not live on in a copy

RUN = ["run", "project.toml", "--out", "out"]
WRITES = 19
"""Openings, movings and removings of files of the result: as many as a run over another one has."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    rng, ends = random.Random(options.seed), Counter[str]()
    writes = cycle(rng.sample(range(WRITES), WRITES))
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        Path("project.toml").write_text(PROJECT)
        whole("simulate", "project.toml", "--out", "record.csv")
        whole(*RUN)
        began = time.perf_counter()
        whole(*RUN)
        took = time.perf_counter() - began
        kills = 0
        for k in count():
            if kills == options.kills:
                break
            Path("project.toml").write_text(PROJECT.replace("2 exp", f"{2 + (k + 1) / 1e4} exp"))
            old = analysed()
            cut = killed(rng.uniform(0, took)) if k % 2 else killed(next(writes))
            kills += cut
            ends[state(old) + ("" if cut else ", done before")] += 1
        whole(*RUN)
        left = sorted(path.name for path in Path("out").iterdir())
    print(f"{options.kills} kills:", ", ".join(f"{end}: {count}" for end, count in sorted(ends.items())))
    print("after the next run:", ", ".join(left))
    sound = left == ["curves.json", "plant.toml", "report.html", "result.json"]
    sys.exit(not sound or any("broken" in end for end in ends))


def whole(*arguments: str) -> None:
    """A command in a process of its own, to its end."""
    status = os.waitpid(started(arguments, None), 0)[1]
    assert status == 0, (arguments, status)


def killed(moment: float | int) -> bool:
    """Whether a run that was killed after so many seconds, or before its so many-th writing, had not ended before."""
    child = started(RUN, moment if isinstance(moment, int) else None)
    if isinstance(moment, float):
        time.sleep(moment)
        os.kill(child, signal.SIGKILL)
    return os.waitpid(child, 0)[1] == signal.SIGKILL


def started(arguments: list[str] | tuple[str, ...], writes: int | None) -> int:
    child = os.fork()
    if child:
        return child
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    left = writes

    def watch(event: str, of: tuple[object, ...]) -> None:
        nonlocal left
        if left is None or event not in ("open", "os.rename", "os.remove") or not str(of[0]).startswith("out/"):
            return
        left -= 1
        if left < 0:
            os.kill(os.getpid(), signal.SIGKILL)

    sys.addaudithook(watch)
    os._exit(command(list(arguments)))


def analysed() -> str:
    """Which project the result is of."""
    return str(json.loads(Path("out/result.json").read_text())["provenance"]["project_sha256"])


def state(old: str) -> str:
    """The result that is there, and whether it had to be mended; read as a run reads it."""
    before = {path.name: path.stat().st_ino for path in Path("out").iterdir()}
    try:
        found = read_results("out").provenance.project_sha256
        sums = json.loads(Path("out/result.json").read_text())["files"]
    except Exception as error:  # whatever it is, it is what is looked for here
        return f"broken ({error})"
    after = {path.name: path.stat().st_ino for path in Path("out").iterdir()}
    if set(after) != {"result.json", *sums}:
        return f"broken (holds {', '.join(sorted(after))})"
    return ("old" if found == old else "new") + ("" if before == after else ", mended")


if __name__ == "__main__":
    main()
