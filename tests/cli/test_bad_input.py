"""Every kind of bad input gives one message and the right exit status, and leaves nothing half-written."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from support.command import ENVIRONMENT, PROJECT
from trueplant.cli import main

Change = Callable[[Path], None]


@dataclass(frozen=True)
class Case:
    """One mistake: what is done to the sound project in the folder, the status, and what the message must say."""

    change: Change
    status: int
    said: tuple[str, ...]
    command: tuple[str, ...] = ("run", "project.toml", "--out", "out")


def _project(old: str, new: str) -> Change:
    def change(folder: Path) -> None:
        text = (folder / "project.toml").read_text()
        assert old in text
        (folder / "project.toml").write_text(text.replace(old, new, 1))

    return change


def _content(content: bytes) -> Change:
    return lambda folder: (folder / "record.csv").write_bytes(content) and None


def _lines(edit: Callable[[list[str]], list[str]]) -> Change:
    def change(folder: Path) -> None:
        lines = (folder / "record.csv").read_text().splitlines()
        (folder / "record.csv").write_text("\n".join(edit(lines)) + "\n")

    return change


def _column(name: str, edit: Callable[[list[str]], list[str]]) -> Change:
    """Change one column of the record; the values are text."""

    def change(lines: list[str]) -> list[str]:
        rows = [line.split(",") for line in lines]
        at = rows[0].index(name)
        for row, value in zip(rows[1:], edit([row[at] for row in rows[1:]]), strict=True):
            row[at] = value
        return [",".join(row) for row in rows]

    return _lines(change)


def _all(value: str) -> Callable[[list[str]], list[str]]:
    return lambda values: [value] * len(values)


def _one(value: str) -> Callable[[list[str]], list[str]]:
    return lambda values: [*values[:50], value, *values[51:]]


def _shuffled(values: list[str]) -> list[str]:
    return [values[k] for k in np.random.default_rng(0).permutation(len(values))]


CASES = {
    # files
    "data file missing": Case(lambda f: (f / "record.csv").unlink(), 2, ("record.csv", "does not exist")),
    "data file empty": Case(_content(b""), 2, ("record.csv", "empty")),
    "data file binary": Case(_content(bytes(range(256)) * 40), 2, ("record.csv",)),
    "data file a folder": Case(_project('"record.csv"', '"."'), 2, ("folder",)),
    "ragged": Case(_lines(lambda x: [*x[:20], x[20] + ",1,2", *x[21:]]), 2, ("record.csv", "line 21")),
    "header only": Case(_lines(lambda x: x[:1]), 2, ("record.csv",)),
    "no header": Case(_lines(lambda x: x[1:]), 2, ("record.csv", "header")),
    "three rows": Case(_lines(lambda x: x[:4]), 2, ("record.csv",)),
    # columns
    "column missing": Case(_project('pv = "pv"', 'pv = "pw"'), 2, ("record.csv", "pw", "pv")),
    "time column missing": Case(_project('time = "t"', 'time = "time"'), 2, ("record.csv", "time")),
    "column all NaN": Case(_column("pv", _all("NaN")), 2, ("pv",)),
    "column empty": Case(_column("op", _all("")), 2, ("op",)),
    "column of words": Case(_column("pv", _all("bad")), 2, ("pv",)),
    "PV constant": Case(_column("pv", _all("1.0")), 3, ("pv",)),
    "OP constant": Case(_column("op", _all("1.0")), 3, ("op",)),
    "no set-point change": Case(_column("sp", _all("0.0")), 3, ("set-point",)),
    # time
    "time in disorder": Case(_column("t", _shuffled), 2, ("record.csv", "t")),
    "time constant": Case(_column("t", _all("7")), 2, ("record.csv", "t")),
    "time without numbers": Case(_column("t", _all("now")), 2, ("record.csv", "t")),
    # the project file
    "project missing": Case(lambda f: (f / "project.toml").unlink(), 2, ("project.toml does not exist",)),
    "project a folder": Case(lambda f: None, 2, ("cannot be read",), ("run", ".", "--out", "out")),
    "project not TOML": Case(_project("[[output]]", "[[output"), 2, ("project.toml", "line 5")),
    "unknown key": Case(_project("Ti = 8.0", "Tii = 8.0"), 2, ("line 20", "Tii", "Ti")),
    "wrong type": Case(_project("Ti = 8.0", 'Ti = "8"'), 2, ("line 20", "Ti", "number")),
    "negative time": Case(_project("Ti = 8.0", "Ti = -8.0"), 2, ("line 20", "Ti")),
    "formula is code": Case(_project('"2 exp(-2 s)/(10 s + 1)"', "\"().__class__\""), 2, ("line 15", "tf")),
    "formula improper": Case(_project('"2 exp(-2 s)/(10 s + 1)"', '"2 s^2/(10 s + 1)"'), 2, ("line 15", "improper")),
    "formula divides by zero": Case(_project('"2 exp(-2 s)/(10 s + 1)"', '"2/(1 - 1)"'), 2, ("line 15", "zero")),
    "formula predicts": Case(_project('"2 exp(-2 s)/(10 s + 1)"', '"2 exp(2 s)/(10 s + 1)"'), 2, ("line 15",)),
    "model names nothing known": Case(_project('input = "u"\ntf', 'input = "v"\ntf'), 2, ("line 14", '"v"')),
    "no data named": Case(_project('files = ["record.csv"]\n', ""), 2, ("data.files",)),
    "nothing to estimate": Case(_project('+ 1)"\n', '+ 1)"\nestimate = false\n'), 2, ("estimate",)),
    "wrong sign of the controller": Case(
        _project("Kc = 0.8", "Kc = -0.8"),
        2,
        ("output y (PV pv)", "input u (OP op)", "negative gain (Kc = -0.8", "positive one (2 exp", "set its action"),
    ),
    "wrong action of the controller": Case(
        _project("Kc = 0.8", 'Kc = 0.8\naction = "direct"'), 2, ('Kc = 0.8, action = "direct"', "remove its action")
    ),
    "wrong sign in a simulation": Case(
        _project("Kc = 0.8", "Kc = -0.8"), 2, ("project.toml", "change the sign of Kc"), ("simulate", "project.toml")
    ),
    "a record for a project": Case(lambda f: None, 2, ("trueplant init record.csv",), ("run", "record.csv")),
    "a binary record for a project": Case(
        lambda f: (f / "x.parquet").write_bytes(b"PAR1\xff\xfe") and None,
        2,
        ("x.parquet is not a project file", "trueplant init x.parquet"),
        ("check", "x.parquet"),
    ),
    "unknown example record": Case(_project('"record.csv"', '"dataset:x/y.csv"'), 2, ("x/y.csv",)),
    # where results go
    "output is a file": Case(lambda f: (f / "out").write_text("mine") and None, 2, ("out", "file")),
    "output below a file": Case(
        lambda f: None, 2, ("record.csv is a file",), ("run", "project.toml", "--out", "record.csv/out")
    ),
    "output not writable": Case(lambda f: None, 2, ("cannot write",), ("run", "project.toml", "--out", "/proc/x/out")),
    # other commands
    "check without data": Case(lambda f: (f / "record.csv").unlink(), 2, ("record.csv",), ("check", "project.toml")),
    "check without moves": Case(_column("sp", _all("0.0")), 3, ("set-point",), ("check", "project.toml")),
    "init of nothing": Case(lambda f: None, 2, ("gone.csv", "does not exist"), ("init", "gone.csv")),
    "init without a loop": Case(
        lambda f: (f / "x.csv").write_text("a,b\n1,2\n2,3\n") and None, 2, ("x.csv", "PV and OP"), ("init", "x.csv")
    ),
    "init of a project": Case(
        lambda f: None,
        2,
        ("project.toml is a project file", "the record", "trueplant check project.toml"),
        ("init", "project.toml", "--force"),
    ),
    "init into nowhere": Case(lambda f: None, 2, ("cannot write",), ("init", "record.csv", "--out", "/proc/x/y.toml")),
    "simulate without a table": Case(
        _project("[simulate]", "[simulate_]"), 2, ("simulate",), ("simulate", "project.toml")
    ),
    "simulate into a file": Case(
        lambda f: None, 2, ("record.csv is a file",), ("simulate", "project.toml", "--out", "record.csv/x.csv")
    ),
    "simulate a controller that acts on a transformed pv": Case(
        _project("Kc = 0.8", 'pv_transform = "sqrt(pv)"\nKc = 0.8'),
        2,
        ("pv_transform", "not simulated"),
        ("simulate", "project.toml", "--out", "new.csv"),
    ),
    "a limit of mu without weights": Case(
        _project("[simulate]", "[tuning.limits]\nmu = 0.9\n[simulate]"), 2, ("mu", "wI and wP")
    ),
    "simulate an unstable loop": Case(
        _project("Kc = 0.8", "Kc = 80"), 2, ("unstable",), ("simulate", "project.toml", "--out", "new.csv")
    ),
    "demo below a file": Case(lambda f: None, 2, ("is a file",), ("demo", "--out", "record.csv/out")),
}  # fmt: skip

SURVIVABLE = {
    "one value missing": _column("pv", _one("")),
    "one word among numbers": _column("pv", _one("Bad Input")),
    "one value infinite": _column("pv", _one("inf")),
    "one value 1e308": _column("pv", _one("1e308")),
    "one value -9999": _column("op", _one("-9999")),
    "latest line first": _lines(lambda x: [x[0], *x[:0:-1]]),
    "one line twice": _lines(lambda x: [*x[:50], x[49], *x[50:]]),
}


@pytest.fixture(scope="module")
def record(tmp_path_factory) -> str:
    folder = tmp_path_factory.mktemp("sound")
    (folder / "project.toml").write_text(PROJECT)
    assert main(["simulate", str(folder / "project.toml"), "--out", str(folder / "record.csv")]) == 0
    return (folder / "record.csv").read_text()


@pytest.fixture
def folder(tmp_path, monkeypatch, record) -> Path:
    (tmp_path / "project.toml").write_text(PROJECT)
    (tmp_path / "record.csv").write_text(record)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def _files(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


@pytest.mark.parametrize("case", CASES.values(), ids=CASES)
def test_bad_input_is_answered_by_one_message(case, folder, capsys):
    case.change(folder)
    before = _files(folder)
    capsys.readouterr()
    status = main(list(case.command))
    out, err = capsys.readouterr()
    assert status == case.status, out + err
    assert "Traceback" not in out + err
    if status == 2:
        assert out == ""
        assert err.startswith("trueplant: ") and err.count("trueplant: ") == 1
        assert _files(folder) == before
    else:
        # a refusal is a result: it says why, on paper too
        assert err == ""
        new = set(_files(folder)) - set(before)
        assert new <= {"out/result.json", "out/report.html", "out/curves.json"}
        assert case.command[0] != "run" or "out/result.json" in new
    for word in case.said:
        assert word.lower() in (out + err).lower(), out + err


@pytest.mark.parametrize("change", SURVIVABLE.values(), ids=SURVIVABLE)
def test_single_flaws_do_not_stop_an_analysis(change, folder, capsys):
    change(folder)
    assert main(["run", "project.toml", "--out", "out"]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    assert out.splitlines()[1].startswith("No change was found"), out


@pytest.mark.parametrize("value", ["1e308", "inf"])
@pytest.mark.parametrize("column", ["pv", "op", "sp"])
def test_absurd_columns_are_refused_or_named(value, column, folder, capsys):
    rng = np.random.default_rng(0)
    signs = rng.choice(["", "-"], 10_000)
    _column(column, lambda values: [f"{s}{value}" for s in signs[: len(values)]])(folder)
    status = main(["run", "project.toml", "--out", "out"])
    out, err = capsys.readouterr()
    assert status in (2, 3), out + err
    assert "Traceback" not in out + err


@pytest.mark.parametrize("moment", [0.3, 1.0, 2.0])
def test_interrupted_run_leaves_nothing(moment, folder):
    # a record long enough that the work is not done when the signal comes
    text = PROJECT.replace("duration = 300", "duration = 100000")
    (folder / "project.toml").write_text(text)
    assert main(["simulate", "project.toml", "--out", "record.csv", "--force"]) == 0
    before = _files(folder)
    command = [sys.executable, "-m", "trueplant", "run", "project.toml", "--out", "out"]
    process = subprocess.Popen(
        command, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=ENVIRONMENT
    )
    time.sleep(moment)
    if process.poll() is None:
        os.kill(process.pid, signal.SIGINT)
    out, err = process.communicate(timeout=60)
    if process.returncode == 0:
        assert "out/result.json" in _files(folder)
        return
    # where the signal meets a library that runs code of its own, Python ends by the signal: shells call that 130 too
    assert process.returncode in (130, -signal.SIGINT), out + err
    assert err == "trueplant: interrupted; no file was left half written\n"
    assert out == ""
    assert _files(folder) == before
