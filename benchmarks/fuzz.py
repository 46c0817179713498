"""Mutated projects and data files: how does each end, and does anything but the documented statuses come up?

A sound project of one loop is simulated; its project file, CSV, Parquet or XLSX record is mutated (bytes changed, cut,
repeated, lines and cells exchanged for what breaks things), and `trueplant check` or `run` is called on it in a process
of its own memory limit, which is replaced where it dies or takes longer than the limit of time. Prints how many cases
ended with which status, and of each that ended otherwise its number and what it said: `--only NUMBER` repeats one.

    python benchmarks/fuzz.py [--cases 2000] [--seed 0] [--only NUMBER] [--seconds 60] [--gigabytes 6] [--workers 2]
"""

from __future__ import annotations

import argparse
import io
import os
import resource
import shutil
import sys
import tempfile
import zipfile
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path
from queue import Queue

import numpy as np

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))

from support.command import PROJECT

KINDS = ("project.toml", "record.csv", "record.parquet", "record.xlsx")
COMMANDS = (("check", "project.toml"), ("run", "project.toml", "--out", "out", "--force"))
EXPECTED = (0, 2, 3)
TOKENS = [
    *(b"nan", b"inf", b"-inf", b"1e308", b"-1e-308", b"1e400", b"0", b"-1", b"99999999999999999999"),
    *(b"", b'"', b"'", b";", b"\t", b"\x00", b"\xff\xfe", b"\n\n", b"[[", b"]]", b"=", b"true"),
    *(b"2024-02-30 25:61:00", b"exp(-s)", b"((((", b"s^20", b"\xe2\x80\xae", b"\x1b[2J"),
    *(b"../../etc/passwd", b"/dev/zero", b"record.csv", b"{from = 1, to = 0}"),
]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", type=int)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--gigabytes", type=float, default=6.0)
    parser.add_argument("--workers", type=int, default=2)
    options = parser.parse_args()
    numbers = range(options.cases) if options.only is None else [options.only]
    with tempfile.TemporaryDirectory() as folder:
        sound = _sound(Path(folder) / "sound")
        runners: Queue[_Runner] = Queue()
        for k in range(options.workers):
            runners.put(_Runner(Path(folder) / f"case-{k}", options.seconds, options.gigabytes))

        def one(number: int) -> tuple[str, str, str]:
            runner = runners.get()
            try:
                return runner.answer(sound, options.seed, number)
            finally:
                runners.put(runner)

        with ThreadPoolExecutor(options.workers) as pool:
            found = list(pool.map(one, numbers))
        while not runners.empty():
            runners.get().end()
    for kind in KINDS:
        ends = Counter(end for of, end, _ in found if of == kind)
        print(f"{kind:16}", ", ".join(f"{end}: {count}" for end, count in sorted(ends.items())))
    strange = [(n, kind, end, said) for n, (kind, end, said) in zip(numbers, found, strict=True) if end not in GOOD]
    for number, kind, end, said in strange:
        print(f"case {number} ({kind}): {end}\n    {said[-1000:] if options.only is None else said}")
    print(f"{len(found)} cases, {len(strange)} of them did not end as promised")
    sys.exit(bool(strange))


SHEET = "xl/worksheets/sheet1.xml"
GOOD = {f"status {status}" for status in EXPECTED}


def _sound(folder: Path) -> dict[str, bytes]:
    """The files of a sound project, by name."""
    import polars as pl

    from trueplant.cli import main as command

    folder.mkdir()
    (folder / "project.toml").write_text(PROJECT)
    assert command(["simulate", str(folder / "project.toml"), "--out", str(folder / "record.csv")]) == 0
    frame = pl.read_csv(folder / "record.csv")
    frame.write_parquet(folder / "record.parquet")
    frame.write_excel(folder / "record.xlsx")
    return {name: (folder / name).read_bytes() for name in KINDS}


class _Runner:
    """A process that calls commands, and its folder."""

    def __init__(self, folder: Path, seconds: float, gigabytes: float) -> None:
        self._folder, self._seconds, self._gigabytes = folder, seconds, gigabytes
        self._begin()

    def _begin(self) -> None:
        context = get_context("spawn")
        self._ours, theirs = context.Pipe()
        self._process = context.Process(target=_work, args=(theirs, self._gigabytes), daemon=True)
        self._process.start()
        theirs.close()

    def end(self) -> None:
        self._process.kill()
        self._process.join()

    def answer(self, sound: dict[str, bytes], seed: int, number: int) -> tuple[str, str, str]:
        """What was mutated, how it ended, and what was said."""
        rng = np.random.default_rng([seed, number])
        kind, arguments = KINDS[number % len(KINDS)], COMMANDS[int(rng.random() < 0.2)]
        shutil.rmtree(self._folder, ignore_errors=True)
        self._folder.mkdir()
        files = dict(sound)
        if kind != "project.toml":
            files["project.toml"] = PROJECT.replace("record.csv", kind).encode()
        files[kind] = _mutated(files[kind], rng, kind)
        for name, content in files.items():
            (self._folder / name).write_bytes(content)
        self._ours.send((str(self._folder), arguments))
        try:
            if self._ours.poll(self._seconds):
                status, said = self._ours.recv()
                strange = "Traceback" in said or "Warning" in said or said.count("trueplant: ") > 1
                return kind, f"status {status}{' with more said' if strange else ''}", said
            end = f"more than {self._seconds:g} s"
        except EOFError:
            self._process.join()
            end = f"died ({self._process.exitcode})"
        self.end()
        self._begin()
        return kind, end, ""


def _work(pipe: Connection, gigabytes: float) -> None:
    """Call commands until the pipe ends, standard error and output kept."""
    most = int(gigabytes * 2**30)
    resource.setrlimit(resource.RLIMIT_AS, (most, most))
    from trueplant.cli import main as command

    with tempfile.TemporaryFile("w+b") as kept:
        for stream in (1, 2):
            os.dup2(kept.fileno(), stream)
        while True:
            folder, arguments = pipe.recv()
            os.chdir(folder)
            kept.seek(0)
            kept.truncate()
            status = command(list(arguments))
            sys.stdout.flush()
            sys.stderr.flush()
            kept.seek(0)
            pipe.send((status, kept.read().decode(errors="replace")))


def _mutated(content: bytes, rng: np.random.Generator, kind: str) -> bytes:
    """The content after one to three mutations; of a workbook mostly those of its sheet, packed again."""
    if kind == "record.xlsx" and rng.random() < 0.8:
        with zipfile.ZipFile(io.BytesIO(content)) as book:
            parts = {part.filename: book.read(part) for part in book.infolist()}
        chosen = SHEET if rng.random() < 0.7 else str(rng.choice(sorted(parts)))
        parts[chosen] = _mutated(parts[chosen], rng, "sheet")
        packed = io.BytesIO()
        with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as book:
            for name, part in parts.items():
                book.writestr(name, part)
        return packed.getvalue()
    binary = kind in ("record.parquet", "record.xlsx")
    for _ in range(int(rng.integers(1, 4))):
        some = MUTATIONS[:4] if binary else MUTATIONS
        content = some[int(rng.choice(len(some), p=None if binary else WEIGHTS))](content, rng)
    return content


def _changed_bytes(content: bytes, rng: np.random.Generator) -> bytes:
    out = bytearray(content)
    for place in rng.integers(0, max(len(out), 1), int(rng.integers(1, 20))) if out else ():
        out[place] = int(rng.integers(256))
    return bytes(out)


def _cut(content: bytes, rng: np.random.Generator) -> bytes:
    a, b = sorted(rng.integers(0, len(content) + 1, 2))
    return content[:a] + content[b:] if rng.random() < 0.7 else content[:a]


def _repeated(content: bytes, rng: np.random.Generator) -> bytes:
    a, b = sorted(rng.integers(0, len(content) + 1, 2))
    return content[:b] + content[a:b] + content[b:]


def _inserted(content: bytes, rng: np.random.Generator) -> bytes:
    at = int(rng.integers(0, len(content) + 1))
    return content[:at] + TOKENS[int(rng.integers(len(TOKENS)))] + content[at:]


def _other_cell(content: bytes, rng: np.random.Generator) -> bytes:
    """One word, number or cell for another."""
    separators = b",= \n<>"
    at = int(rng.integers(0, len(content) + 1))
    begin = max((content.rfind(bytes([s]), 0, at) for s in separators), default=-1) + 1
    ends = [end for s in separators if (end := content.find(bytes([s]), at)) >= 0]
    return content[:begin] + TOKENS[int(rng.integers(len(TOKENS)))] + content[min(ends, default=len(content)) :]


def _lines(content: bytes, rng: np.random.Generator) -> bytes:
    """One line left out, doubled, or exchanged with another."""
    lines = content.split(b"\n")
    a, b = (int(k) for k in rng.integers(0, len(lines), 2))
    kind = int(rng.integers(3))
    if kind == 0:
        del lines[a]
    elif kind == 1:
        lines.insert(b, lines[a])
    else:
        lines[a], lines[b] = lines[b], lines[a]
    return b"\n".join(lines)


MUTATIONS: tuple[Callable[[bytes, np.random.Generator], bytes], ...] = (
    _changed_bytes,
    _cut,
    _repeated,
    _inserted,
    _other_cell,
    _lines,
)
WEIGHTS = (0.1, 0.1, 0.1, 0.15, 0.4, 0.15)
"""Of the mutations of text: most leave it well-formed."""

if __name__ == "__main__":
    main()
