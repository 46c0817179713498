"""Files, streams and places that are out to break something: each ends with its status, one message, and nothing lost.

`benchmarks/fuzz.py` does the same to thousands of mutated inputs.
"""

from __future__ import annotations

import json
import os
import re
import socket
import subprocess
import sys
import tomllib
import zipfile
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import polars as pl
import pytest
import tomlkit

import trueplant
from support.command import ENVIRONMENT, PROJECT, contents, refused
from trueplant.cli import main
from trueplant.project import Project
from trueplant.record import levels

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
    (folder / "still.toml").write_text(PROJECT.replace('op = "op"', 'op = "still"'))
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


# -- counted twice -----------------------------------------------------------------------------------------------


def several(folder: Path, *names: str) -> None:
    files = ", ".join(f'"{name}"' for name in names)
    (folder / "project.toml").write_text(PROJECT.replace('"record.csv"', files))


def dated(folder: Path) -> pl.DataFrame:
    frame = pl.read_csv(folder / "record.csv")
    stamps = pl.Series("t", [datetime(2024, 3, 1) + timedelta(seconds=0.5 * k) for k in range(frame.height)])
    return frame.with_columns(stamps)


def test_the_same_samples_in_two_files_are_an_error_that_names_both(folder, capsys):
    frame = pl.read_csv(folder / "record.csv")
    (folder / "again").mkdir()
    (folder / "again" / "copy.csv").write_bytes((folder / "record.csv").read_bytes())
    frame.write_parquet(folder / "other.parquet")
    frame.with_columns(pl.col("t") + 1e5).write_csv(folder / "later.csv")
    for other in ("record.csv", "again/copy.csv", "./again/../record.csv", "other.parquet", "later.csv"):
        several(folder, "record.csv", other)
        refused(["check", "project.toml"], capsys, f"record.csv and {other}", "the same samples")


def test_parts_of_one_file_are_no_repeats(folder, capsys):
    several(folder, "record.csv", "record.csv")
    text = (folder / "project.toml").read_text()
    experiments = """
[[experiment]]
file = "record.csv"
[[experiment]]
file = "copy.csv"
"""
    (folder / "copy.csv").write_bytes((folder / "record.csv").read_bytes())
    parts = 'exclude = [{file = "record.csv", from = 150, to = 400}, {file = "copy.csv", from = 0, to = 150}]'
    text = text.replace('files = ["record.csv", "record.csv"]', parts).replace(
        "[[output]]", experiments + "[[output]]", 1
    )
    (folder / "project.toml").write_text(text)
    assert main(["check", "project.toml"]) == 0
    assert "left out here" not in capsys.readouterr().out


@pytest.mark.parametrize("stamped", [True, False])
def test_exports_that_overlap_are_joined_once(stamped, folder, capsys):
    frame = dated(folder) if stamped else pl.read_csv(folder / "record.csv")
    frame[:400].write_csv(folder / "first.csv")
    frame[300:].with_columns(pl.col("pv").round(6)).write_csv(folder / "second.csv")
    several(folder, "first.csv", "second.csv")
    assert main(["check", "project.toml", "--json"]) == 0
    first, second = json.loads(capsys.readouterr().out)["data"]
    assert (first["samples"], second["samples"]) == (400, 201)
    assert [f["message"] for f in second["findings"] if f["kind"] == "overlap"] == [
        "100 samples that first.csv holds too were counted there, and left out here."
    ]
    frame[100:200].write_csv(folder / "second.csv")
    refused(["check", "project.toml"], capsys, "second.csv holds nothing that first.csv does not hold too")


def test_exports_that_contradict_each_other_are_an_error(folder, capsys):
    frame = dated(folder)
    frame[:400].write_csv(folder / "first.csv")
    frame[300:].with_columns(pl.col("pv") + 1).write_csv(folder / "second.csv")
    several(folder, "first.csv", "second.csv")
    refused(["check", "project.toml"], capsys, "first.csv and second.csv overlap in time (2024-")
    # the same instants in between, of another clock
    frame[300:].with_columns(pl.col("t") + timedelta(milliseconds=200)).write_csv(folder / "second.csv")
    refused(["check", "project.toml"], capsys, "first.csv and second.csv overlap in time")


def test_tests_that_each_begin_at_0_are_several(folder, capsys):
    (folder / "project.toml").write_text(PROJECT.replace("noise = 0.02", "noise = 0.02\nseed = 5"))
    assert main(["simulate", "project.toml", "--out", "second.csv"]) == 0
    several(folder, "record.csv", "second.csv")
    assert main(["check", "project.toml"]) == 0
    assert "left out here" not in capsys.readouterr().out


def test_exports_that_follow_each_other_are_used_whole(folder, capsys):
    frame = dated(folder)
    frame[:300].write_csv(folder / "first.csv")
    frame[300:].with_columns(pl.col("t") - timedelta(milliseconds=20)).write_csv(folder / "second.csv")
    several(folder, "first.csv", "second.csv")
    assert main(["check", "project.toml"]) == 0
    assert "left out here" not in capsys.readouterr().out


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


# -- workbooks and Parquet files ---------------------------------------------------------------------------------


def workbook(path: Path, more: bytes = b"") -> None:
    """The record as a workbook, with `more` put after its last row."""
    pl.read_csv(path.parent / "record.csv").write_excel(path)
    with zipfile.ZipFile(path) as book:
        parts = {part.filename: book.read(part) for part in book.infolist()}
    sheet = "xl/worksheets/sheet1.xml"
    parts[sheet] = parts[sheet].replace(b"</sheetData>", more + b"</sheetData>")
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as book:
        for name, content in parts.items():
            book.writestr(name, content)


@pytest.mark.parametrize("cell", ["XFD1048576", "ALL100000"])
def test_a_stray_cell_of_a_workbook_is_named(cell, folder, capsys):
    row = cell.lstrip("XFDAL").encode()
    workbook(folder / "record.xlsx", b'<row r="%s"><c r="%s"><v>1</v></c></row>' % (row, cell.encode()))
    (folder / "project.toml").write_text(PROJECT.replace("record.csv", "record.xlsx"))
    refused(["check", "project.toml"], capsys, "record.xlsx", f"row {int(row):,}", "delete stray cells")


@pytest.mark.parametrize("place", ["Atrue157", "AAAAAAAAAA1", "A99999999999", "A-1", ""])
def test_a_place_that_is_none_does_not_end_the_process(place, folder, capsys):
    workbook(folder / "record.xlsx", b'<row><c r="%s"><v>1</v></c></row>' % place.encode())
    (folder / "project.toml").write_text(PROJECT.replace("record.csv", "record.xlsx"))
    refused(["check", "project.toml"], capsys, "not a readable Excel workbook", "no place of a cell")


def test_a_workbook_that_unpacks_to_more_than_memory_is_refused(folder, capsys, monkeypatch):
    workbook(folder / "record.xlsx", b" " * 10_000_000)
    assert (folder / "record.xlsx").stat().st_size < 200_000
    (folder / "project.toml").write_text(PROJECT.replace("record.csv", "record.xlsx"))
    assert main(["check", "project.toml"]) == 0
    monkeypatch.setattr(levels, "MOST_UNPACKED", 5_000_000)
    refused(["check", "project.toml"], capsys, "unpacks to 0.0101 GB", "export it as CSV or Parquet")


@pytest.mark.parametrize("ending", ["xlsx", "parquet"])
def test_damaged_files_end_in_one_message(ending, folder, capfd):
    """40 files with up to 30 bytes changed: what can still be read may be, and nothing else is printed."""
    path = folder / f"record.{ending}"
    workbook(path) if ending == "xlsx" else pl.read_csv(folder / "record.csv").write_parquet(path)
    (folder / "project.toml").write_text(PROJECT.replace("record.csv", path.name))
    whole, rng, refusals = path.read_bytes(), np.random.default_rng(0), 0
    for _ in range(40):
        damaged = bytearray(whole)
        for place in rng.integers(4, len(whole), rng.integers(1, 30)):
            damaged[place] = rng.integers(256)
        path.write_bytes(damaged)
        status = main(["check", "project.toml"])
        err = capfd.readouterr().err
        assert status in (0, 2, 3), err
        assert err.count("\n") == (status == 2), err
        refusals += status == 2
    assert refusals >= 20


def test_more_cells_than_are_meant_are_refused_before_they_are_read(folder, capsys):
    pl.read_csv(folder / "record.csv").write_parquet(folder / "record.parquet")
    text = PROJECT.replace("record.csv", "record.parquet").replace('time = "t"', 'time = "t"\nmax_samples = 1000')
    (folder / "project.toml").write_text(text)
    refused(["check", "project.toml"], capsys, "601 rows of 4 columns", "1,000 cells", "data.max_samples")


# -- names that steer ----------------------------------------------------------------------------------------------

STRANGE = "a\x1b[31m\x07\x9b2J\u202eb\x7f\"'<script>alert(1)</script>%{x}"
STEERING = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069]")


@pytest.fixture
def strange(folder):
    """The project with such names for its signals and columns."""
    frame = pl.read_csv(folder / "record.csv").rename({"pv": STRANGE, "op": f"{STRANGE} 2"})
    frame.write_parquet("record.parquet")
    text = PROJECT.replace("record.csv", "record.parquet")
    for key, old, new in (("pv", "pv", STRANGE), ("op", "op", f"{STRANGE} 2")):
        text = text.replace(f'{key} = "{old}"', f"{key} = {tomlkit.item(new).as_string()}")
    for key, name in (("output", "y"), ("input", "u"), ("name", "y"), ("name", "u")):
        text = text.replace(f'{key} = "{name}"', f"{key} = {tomlkit.item(STRANGE + name).as_string()}")
    text = text.split("[simulate]")[0]
    (folder / "project.toml").write_text(text)
    return folder


def test_names_steer_neither_terminal_nor_page_and_stay_what_they_are(strange, capsys):
    (strange / "record.csv").unlink()
    assert main(["check", "project.toml"]) == 0
    assert main(["run", "project.toml", "--out", "out"]) == 0
    assert main(["init", "record.parquet", "--out", "new.toml"]) in (0, 2)
    out, err = capsys.readouterr()
    assert not STEERING.search(out + err)
    assert "\\x1b[31m" in out
    page = (strange / "out" / "report.html").read_text()
    library = max(re.findall(r"<script.*?</script>", page, re.DOTALL), key=len)
    page = page.replace(library, "")
    assert not STEERING.search(page) and "<script>alert" not in page
    for name in ("result.json", "curves.json"):
        text = (strange / "out" / name).read_text()
        assert not STEERING.search(text)
    result = json.loads((strange / "out" / "result.json").read_text())
    assert result["elements"][0]["output"] == STRANGE + "y"
    plant = tomllib.loads((strange / "out" / "plant.toml").read_text())
    assert plant["output"][0]["pv"] == STRANGE
    assert main(["run", "out/plant.toml", "--out", "again"]) == 0
    assert trueplant.load("again").headline.startswith("No change was found")


# -- models beyond reason ------------------------------------------------------------------------------------------

MODELS = {
    "1e300/(10 s + 1)": "gain of about 1e+299",
    "1e-300/(10 s + 1)": "gain of about 1e-301",
    "2/(1e300 s + 1)": "time constant or dead time of about 1e+300",
    "2/(1e-300 s + 1)": "time constant or dead time of about 1e-300",
    "2 exp(-1e300 s)/(10 s + 1)": "time constant or dead time of about 1e+300",
    "2/(10 s + 1)^500": "power 500 is too high",
    "+".join(["2/(10 s + 1)"] * 200): "2000 is the most that is read",
    "(" * 400 + "2" + ")" * 400 + "/(10 s + 1)": "nested deeper than",
    "1e309/(10 s + 1)": "too large a number",
    "2/0": "division by zero",
    "exp(exp(-s))": "the argument of exp",
}


@pytest.mark.parametrize("formula", MODELS, ids=range(len(MODELS)))
def test_models_beyond_reason_are_answered_at_once(formula, folder, capsys):
    (folder / "project.toml").write_text(PROJECT.replace("2 exp(-2 s)/(10 s + 1)", formula))
    before = contents(folder)
    status = main(["run", "project.toml", "--out", "out"])
    out, err = capsys.readouterr()
    assert (status, out) == (2, "") and MODELS[formula] in err and len(err) < 1000, err
    assert contents(folder) == before


def test_more_than_can_be_estimated_is_said_at_once(folder, capsys, monkeypatch):
    asked, wanted = [], Project.wanted
    monkeypatch.setattr(Project, "wanted", lambda self, *place: asked.append(place) or wanted(self, *place))
    many = 40
    rng = np.random.default_rng(5)
    frame = {"t": np.arange(2000.0)}
    text = ['time_unit = "s"\n[data]\nfiles = ["many.csv"]\ntime = "t"\n']
    for k in range(many):
        frame |= {f"sp{k}": np.repeat(rng.integers(-2, 3, 20), 100).astype(float), f"op{k}": rng.normal(size=2000)}
        frame[f"pv{k}"] = frame[f"sp{k}"] + rng.normal(size=2000)
        text += [f'[[output]]\nname = "y{k}"\npv = "pv{k}"\nsp = "sp{k}"\n[[input]]\nname = "u{k}"\nop = "op{k}"\n']
    text += [
        f'[[model]]\noutput = "y{i}"\ninput = "u{j}"\ntf = "1/(10 s + 1)"\n' for i in range(many) for j in range(many)
    ]
    pl.DataFrame(frame).write_csv("many.csv")
    Path("many.toml").write_text("".join(text))
    assert main(["run", "many.toml", "--json"]) == 3
    reasons = json.loads(capsys.readouterr().out)["reasons"]
    assert [one["code"] for one in reasons] == ["too-large"]
    assert "1600 elements, up to 40 of one output, from 2,000 samples" in reasons[0]["message"]
    assert "estimate = false" in reasons[0]["message"]
    # Each question looks through the whole model: one a time for every element is minutes.
    assert 0 < len(asked) <= 4 * many**2


def test_no_warning_of_a_library_reaches_a_user(folder):
    """A model of twelve lags, of which the fit overflows on its way."""
    project = PROJECT.replace("2 exp(-2 s)/(10 s + 1)", "2 exp(-2 s)/(3 s + 1)^12").replace("Kc = 0.8", "Kc = 0.1")
    (folder / "slow.toml").write_text(project)
    command = [sys.executable, "-m", "trueplant"]
    for arguments in (["simulate", "slow.toml", "--out", "record.csv", "--force"], ["run", "slow.toml"]):
        done = subprocess.run([*command, *arguments], env=ENVIRONMENT, capture_output=True, text=True, check=True)
        assert done.stderr == ""


@pytest.mark.parametrize(("options", "shown"), [([], False), (["-W", "default"], True)])
def test_warnings_are_shown_only_to_who_asks_for_them(options, shown, folder):
    """Those of a library that is called while a command runs."""
    (folder / "typer.py").write_text("import warnings\nwarnings.warn('of a library')\nraise SystemExit(0)\n")
    environment = ENVIRONMENT | {"PYTHONPATH": os.pathsep.join([str(folder), ENVIRONMENT["PYTHONPATH"]])}
    command = [sys.executable, *options, "-m", "trueplant", "check", "project.toml"]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert ("of a library" in done.stderr) is shown
