"""A sound project of one simulated loop, and what the tests of what a command makes of mistakes in it share."""

from __future__ import annotations

import os
from pathlib import Path

import trueplant
from trueplant.cli import main

ENVIRONMENT = os.environ | {"PYTHONPATH": str(Path(trueplant.__file__).parents[1])}
"""For commands in processes of their own."""
PROJECT = """\
time_unit = "s"
[data]
files = ["record.csv"]
time = "t"
[[output]]
name = "y"
pv = "pv"
sp = "sp"
[[input]]
name = "u"
op = "op"
[[model]]
output = "y"
input = "u"
tf = "2 exp(-2 s)/(10 s + 1)"
[[controller]]
input = "u"
output = "y"
Kc = 0.8
Ti = 8.0
sample_time = 0.5
[simulate]
duration = 300
sample_time = 0.5
noise = 0.02
setpoints = [{time = 5, output = "y", value = 1}, {time = 100, output = "y", value = -1}]
"""


def contents(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def refused(arguments: list[str], capsys, *words: str) -> None:
    """The command ends with 2 and one message that holds the words, and leaves every file as it was."""
    before = contents(Path())
    capsys.readouterr()
    status = main(arguments)
    out, err = capsys.readouterr()
    assert (status, out) == (2, ""), out + err
    assert err.startswith("trueplant: ") and err.count("\n") == 1 and len(err) < 1000, err
    for word in words:
        assert word in err, err
    assert contents(Path()) == before


def simulated(folder: Path) -> str:
    """The record of the project, simulated in an empty folder."""
    (folder / "project.toml").write_text(PROJECT)
    assert main(["simulate", str(folder / "project.toml"), "--out", str(folder / "record.csv")]) == 0
    return (folder / "record.csv").read_text()


def sound(folder: Path, record: str) -> Path:
    """The folder, with the project and its record in it."""
    (folder / "project.toml").write_text(PROJECT)
    (folder / "record.csv").write_text(record)
    return folder
