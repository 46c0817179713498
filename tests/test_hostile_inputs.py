"""Files, streams and places that are out to break something: each ends with its status, one message, and nothing lost.

`benchmarks/fuzz.py` does the same to thousands of mutated inputs.
"""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
from pathlib import Path

import pytest

import trueplant
from trueplant.cli import main

ENVIRONMENT = os.environ | {"PYTHONPATH": str(Path(trueplant.__file__).parents[1])}
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


@pytest.fixture(scope="module")
def record(tmp_path_factory):
    folder = tmp_path_factory.mktemp("record")
    (folder / "project.toml").write_text(PROJECT)
    assert main(["simulate", str(folder / "project.toml"), "--out", str(folder / "record.csv")]) == 0
    return (folder / "record.csv").read_text()


@pytest.fixture
def folder(tmp_path, record, monkeypatch):
    (tmp_path / "project.toml").write_text(PROJECT)
    (tmp_path / "record.csv").write_text(record)
    monkeypatch.chdir(tmp_path)
    return tmp_path


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


# -- streams -----------------------------------------------------------------------------------------------------


def in_shell(folder: Path, line: str) -> tuple[int, str, str]:
    """Status of the command (not of what reads it), standard output and standard error; `TP` is the command."""
    line = line.replace("TP", f"{sys.executable} -m trueplant") + "; exit ${PIPESTATUS[0]}"
    done = subprocess.run(["bash", "-c", line], cwd=folder, env=ENVIRONMENT, capture_output=True, timeout=120)
    return done.returncode, done.stdout.decode(errors="replace"), done.stderr.decode(errors="replace")


@pytest.mark.parametrize(
    ("line", "status", "said"),
    [
        ("TP run project.toml --out out | true", 0, ""),
        ("TP run project.toml --out out --json | head -c 10 > /dev/null", 0, ""),
        ("TP run changed.toml --out out --fail-on-mismatch | true", 1, ""),
        ("TP check still.toml | true", 3, ""),
        ("TP run project.toml --out out > /dev/full", 2, "No space left"),
        ("TP check project.toml --json > /dev/full", 2, "No space left"),
        ("TP run project.toml --out out >&-", 0, ""),
        ("TP run nothere.toml 2>&-", 2, ""),
        ("TP run nothere.toml 2> /dev/full", 2, ""),
        ("TP run nothere.toml >&- 2>&- <&-", 2, ""),
        ("TP run $'\\xff\\x1b[31m.toml'", 2, "\\udcff\\x1b[31m.toml does not exist"),
        ("TP --version | true", 0, ""),
    ],
)
def test_streams_change_neither_status_nor_result(line, status, said, folder):
    (folder / "changed.toml").write_text(PROJECT.replace("2 exp(-2 s)", "1 exp(-2 s)"))
    (folder / "still.toml").write_text(PROJECT.replace('pv = "pv"', 'pv = "sp"').replace('op = "op"', 'op = "still"'))
    lines = (folder / "record.csv").read_text().splitlines()
    still = [f"{one},{'still' if k == 0 else '5'}" for k, one in enumerate(lines)]
    (folder / "record.csv").write_text("\n".join(still) + "\n")
    found, _, err = in_shell(folder, line)
    assert found == status, err
    assert (said in err and err.count("\n") == 1) if said else err == ""
    if "--out out" in line:
        assert json.loads((folder / "out" / "result.json").read_text())["status"] == "ok"


# -- not files ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["a pipe", "a folder", "a device", "a socket"])
@pytest.mark.parametrize("given", ["data", "project", "init"])
def test_what_is_no_file_is_refused_before_it_is_read(kind, given, folder, capsys):
    place = folder / ("record.csv" if given == "data" else "strange.csv")
    place.unlink(missing_ok=True)
    if kind == "a pipe":
        os.mkfifo(place)
    elif kind == "a folder":
        place.mkdir()
    elif kind == "a device":
        place.symlink_to("/dev/zero")
    else:
        with socket.socket(socket.AF_UNIX) as listening:
            listening.bind(place.name)  # by its name alone: its path has to be short
    command = {"data": ["run", "project.toml"], "project": ["run", "strange.csv"], "init": ["init", "strange.csv"]}
    refused(command[given], capsys, place.name, kind)


# -- the user's files --------------------------------------------------------------------------------------------


def test_the_project_that_was_given_is_never_overwritten(folder, capsys):
    (folder / "plant.toml").write_text(PROJECT)
    for force in ([], ["--force"]):
        refused(["run", "plant.toml", "--out", ".", *force], capsys, "plant.toml", "read by this run")
    assert main(["run", "project.toml", "--out", "out"]) == 0
    for force in ([], ["--force"]):
        refused(["run", "out/plant.toml", "--out", "out", *force], capsys, "plant.toml", "read by this run")
        refused(["simulate", "project.toml", "--out", "project.toml", *force], capsys, "project.toml")
        refused(["init", "record.csv", "--out", "record.csv", *force], capsys, "record.csv", "read by this run")


def test_a_record_that_bears_the_name_of_a_result_is_never_overwritten(folder, capsys):
    (folder / "record.csv").rename(folder / "report.html")
    (folder / "project.toml").write_text(PROJECT.replace("record.csv", "report.html"))
    refused(["run", "project.toml", "--out", ".", "--force"], capsys, "report.html", "read by this run")


@pytest.mark.parametrize("name", ["plant.toml", "report.html", "result.json", "curves.json"])
def test_files_that_no_run_wrote_are_replaced_on_demand_only(name, folder, capsys):
    (folder / "out").mkdir()
    (folder / "out" / name).write_text("{}")
    refused(["run", "project.toml", "--out", "out"], capsys, name, "--force")
    assert main(["run", "project.toml", "--out", "out", "--force"]) == 0
    assert (folder / "out" / name).read_text() != "{}"


def test_what_an_earlier_run_wrote_is_replaced_unless_it_was_edited(folder, capsys):
    assert main(["run", "project.toml", "--out", "out"]) == 0
    (folder / "project.toml").write_text(PROJECT.replace("2 exp", "2.1 exp"))
    assert main(["run", "project.toml", "--out", "out"]) == 0
    with (folder / "out" / "plant.toml").open("a") as file:
        file.write("# as agreed with operations\n")
    refused(["run", "project.toml", "--out", "out"], capsys, "plant.toml", "--force")


def test_a_refusal_does_not_take_the_users_files_away(folder, capsys):
    (folder / "out").mkdir()
    (folder / "out" / "plant.toml").write_text(PROJECT)
    (folder / "project.toml").write_text(PROJECT.replace('op = "op"', 'op = "sp"'))
    refused(["run", "project.toml", "--out", "out"], capsys, "plant.toml", "--force")


def test_demos_and_simulations_leave_files_alone_that_they_did_not_write(folder, capsys):
    (folder / "record.csv").rename(folder / "elsewhere.csv")
    refused(["demo", "--out", "."], capsys, "project.toml", "--force")
    (folder / "elsewhere.csv").rename(folder / "record.csv")
    assert main(["simulate", "project.toml", "--out", "record.csv"]) == 0  # the same content again
    (folder / "record.csv").write_text("t,pv\n0,1\n")
    refused(["simulate", "project.toml", "--out", "record.csv"], capsys, "record.csv", "--force")
    assert main(["simulate", "project.toml", "--out", "record.csv", "--force"]) == 0
    assert len((folder / "record.csv").read_text()) > 1000


@pytest.mark.parametrize("command", [["run", "project.toml"], ["demo"], ["simulate", "project.toml"], ["paper"]])
def test_an_empty_place_is_no_place(command, folder, capsys):
    refused([*command, "--out", ""], capsys, "--out is empty")


def test_a_very_long_path_is_not_echoed(folder, capsys):
    refused(["run", f"{'x/' * 2500}project.toml"], capsys, "project.toml")
