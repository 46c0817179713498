"""The commands: what they print, write, and exit with."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import polars as pl
import pytest

import trueplant as tp
from support.command import ENVIRONMENT, PROJECT
from trueplant.cli import main
from trueplant.cli.analyse import demo_text

LOOP = """\
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
limits = [-10, 10]
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
plant = "model"
duration = 240
sample_time = 0.5
noise = 0.02
seed = 3
setpoints = [
    {time = 5, output = "y", value = 1}, {time = 60, output = "y", value = -1},
    {time = 120, output = "y", value = 0.5}, {time = 180, output = "y", value = 0},
]
"""
CHANGED = (
    LOOP.replace('plant = "model"\n', "", 1)
    + '[[simulate.plant]]\noutput = "y"\ninput = "u"\ntf = "2.6 exp(-2 s)/(10 s + 1)"\n'
)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def _simulated(folder: Path, text: str) -> None:
    (folder / "loop.toml").write_text(text)
    assert main(["simulate", "loop.toml", "--out", "record.csv"]) == 0


def test_help_is_quick_and_lists_what_exists():
    started = time.perf_counter()
    command = [sys.executable, "-m", "trueplant", "--help"]
    done = subprocess.run(command, capture_output=True, text=True, check=True, env=ENVIRONMENT)
    assert time.perf_counter() - started < 3
    for command in ("run", "check", "init", "simulate", "demo"):
        assert f"  {command}  " in done.stdout
    assert "..." not in done.stdout.split("Commands:")[1]


def test_help_imports_nothing_heavy():
    code = (
        "import sys; from trueplant.cli import main; main(['--help']);"
        "print([m for m in ('numpy', 'scipy', 'numba', 'polars', 'pydantic', 'plotly', 'control') if m in sys.modules])"
    )
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, capture_output=True, text=True, check=True, env=ENVIRONMENT)
    assert done.stdout.splitlines()[-1] == "[]"


def test_version(capsys):
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"trueplant {tp.__version__}\n"


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ([], "Missing command"),
        (["runn"], "No such command 'runn'"),
        (["run"], "PROJECT.toml"),
        (["run", "a.toml", "--ouput", "x"], "--ouput"),
        (["run", "a.toml", "b.toml"], "b.toml"),
        (["demo", "nothing"], "mill, splitter, wood-berry"),
    ],
)
def test_wrong_usage_is_one_message(arguments, said, capsys, folder):
    assert main(arguments) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("trueplant: ") and err.count("\n") == 1 and said in err
    assert list(folder.iterdir()) == []


def test_a_formula_is_shown_below_its_message_and_a_name_cannot_begin_a_line(capsys, folder):
    path = folder / "a\ntrueplant: all is well.toml"
    path.write_text(PROJECT.replace("(10 s + 1)", "(10 s + 1"))
    assert main(["run", path.name]) == 2
    first, shown, caret = capsys.readouterr().err.splitlines()
    assert first.startswith(r"trueplant: a\ntrueplant: all is well.toml, line 15: model[1].tf: formula, column 13: ")
    assert shown == "    2 exp(-2 s)/(10 s + 1"
    assert caret == " " * shown.index("(10") + "^"


def test_internal_error_is_one_line_with_the_place_of_the_details(capsys, folder, monkeypatch):
    def broken(*_):
        raise ZeroDivisionError("boom")

    monkeypatch.setattr("trueplant.cli.data.init", broken)
    assert main(["init", "x.csv"]) == 70
    out, err = capsys.readouterr()
    assert out == "" and err.count("\n") == 1 and "ZeroDivisionError" in err
    details = Path(err.rsplit(" ", 1)[1].strip())
    assert "boom" in details.read_text()
    details.unlink()


def test_interruption_has_a_status_of_its_own(capsys, folder, monkeypatch):
    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("trueplant.cli.data.init", interrupted)
    assert main(["init", "x.csv"]) == 130
    assert capsys.readouterr().err.count("\n") == 1


def test_an_interruption_that_an_import_makes_its_own_error_of_is_still_one(capsys, folder, monkeypatch):
    def importing(*_):
        try:
            signal.raise_signal(signal.SIGINT)
        except KeyboardInterrupt:
            raise ImportError("initialization failed") from None

    monkeypatch.setattr("trueplant.cli.data.init", importing)
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        assert main(["init", "x.csv"]) == 130
    finally:
        signal.signal(signal.SIGINT, before)
    assert capsys.readouterr().err == "trueplant: interrupted; no file was left half written\n"


def test_simulated_record_is_the_loops(folder, capsys):
    _simulated(folder, LOOP)
    frame = pl.read_csv("record.csv")
    assert frame.columns == ["t", "sp", "op", "pv"]
    assert frame.height == 481
    assert frame["t"][-1] == 240
    assert frame.filter(pl.col("t") == 59.5)["sp"].item() == 1
    settled = frame.filter(pl.col("t").is_between(45, 59.5))["pv"].mean()
    assert settled == pytest.approx(1, abs=0.05)
    assert "481 samples of t, sp, op, pv\n" in capsys.readouterr().out


def test_simulation_says_what_to_write_where_the_project_reads_another_record(folder, capsys):
    (folder / "sub").mkdir()
    (folder / "sub" / "loop.toml").write_text(LOOP)
    assert main(["simulate", "sub/loop.toml"]) == 0
    said = capsys.readouterr().out
    assert "sub/loop.toml does not read it" in said and 'files = ["../loop-simulated.csv"] under [data]' in said
    text = LOOP.replace('"record.csv"', '"../loop-simulated.csv"')
    (folder / "sub" / "loop.toml").write_text(text)
    assert text != LOOP and main(["check", "sub/loop.toml"]) == 0
    capsys.readouterr()
    assert main(["simulate", "sub/loop.toml"]) == 0
    assert "does not read it" not in capsys.readouterr().out


def test_simulation_writes_parquet_and_only_what_it_can(folder, capsys):
    (folder / "loop.toml").write_text(LOOP)
    assert main(["simulate", "loop.toml", "--out", "r.parquet"]) == 0
    assert pl.read_parquet("r.parquet").height == 481
    assert main(["simulate", "loop.toml", "--out", "r.xlsx"]) == 2
    assert "r.xlsx" in capsys.readouterr().err
    assert not (folder / "r.xlsx").exists()


def test_simulation_takes_the_plant_of_another_project(folder):
    (folder / "plant.toml").write_text(LOOP.replace("2 exp(-2 s)", "4 exp(-2 s)"))
    (folder / "loop.toml").write_text(LOOP.replace('plant = "model"', 'plant = "plant.toml"').replace("0.02", "0"))
    assert main(["simulate", "loop.toml"]) == 0
    frame = pl.read_csv("loop-simulated.csv").filter(pl.col("t") == 59.5)
    # at rest PV = gain x OP
    assert frame["pv"].item() / frame["op"].item() == pytest.approx(4, rel=0.02)


def test_continuous_controllers_are_simulated_in_small_steps(folder):
    text = LOOP.replace("sample_time = 0.5\n[simulate]", "[simulate]").replace("0.02", "0")
    (folder / "loop.toml").write_text(text)
    assert main(["simulate", "loop.toml", "--out", "a.csv"]) == 0
    (folder / "loop.toml").write_text(text.replace("sample_time = 0.5", "sample_time = 0.05"))
    assert main(["simulate", "loop.toml", "--out", "b.csv"]) == 0
    coarse, fine = pl.read_csv("a.csv")["pv"].to_numpy(), pl.read_csv("b.csv")["pv"].to_numpy()[::10]
    assert abs(coarse - fine).max() < 2e-3


def test_init_writes_what_run_can_read(folder, capsys):
    _simulated(folder, LOOP)
    assert main(["init", "record.csv"]) == 0
    project = tp.Project.load("record.toml")
    assert project.experiments[0].path.resolve() == (folder / "record.csv").resolve()
    assert (project.outputs[0].pv, project.outputs[0].sp, project.inputs[0].op) == ("pv", "sp", "op")
    capsys.readouterr()
    (folder / "record.toml").write_text("mine")
    assert main(["init", "record.csv"]) == 2
    assert "--force" in capsys.readouterr().err
    assert (folder / "record.toml").read_text() == "mine"
    assert main(["init", "record.csv", "--force"]) == 0


def test_check_says_what_can_be_used(folder, capsys):
    _simulated(folder, LOOP)
    capsys.readouterr()
    assert main(["check", "loop.toml"]) == 0
    out, err = capsys.readouterr()
    assert "record.csv: 481 samples, 0 to 240 s" in out
    assert "y: 100 % of the samples can be used" in out
    assert err == ""


def test_run_finds_the_change_and_writes_everything(folder, capsys):
    _simulated(folder, CHANGED)
    capsys.readouterr()
    assert main(["run", "loop.toml", "--out", "out"]) == 0
    out, err = capsys.readouterr()
    assert out.startswith("Y answers 30 % stronger than the model says")
    assert out.splitlines()[1].startswith("The plant has changed: u -> y responds with a gain of 2.6")
    assert err == ""
    names = ["curves.json", "plant.toml", "report.html", "result.json"]
    assert sorted(p.name for p in (folder / "out").iterdir()) == names
    result = json.loads((folder / "out" / "result.json").read_text())
    gain = result["elements"][0]["parameters"][0]
    assert gain["ci"][0] < 2.6 < gain["ci"][1]
    assert gain["changed"] is True
    # plant.toml is a whole project: its model is the plant, its data are found from where it lies
    plant = tp.Project.load("out/plant.toml")
    assert plant.model_matrix().dc_gain[0, 0] == pytest.approx(2.6, rel=0.05)
    assert plant.experiments[0].path.resolve() == (folder / "record.csv").resolve()
    assert main(["run", "out/plant.toml", "--out", "again", "--fail-on-mismatch"]) == 0
    assert capsys.readouterr().out.splitlines()[1].startswith("No change was found")


def test_mismatch_fails_only_when_asked(folder, capsys):
    _simulated(folder, CHANGED)
    assert main(["run", "loop.toml", "--fail-on-mismatch"]) == 1
    assert (folder / "loop-result" / "result.json").exists()


def test_json_is_the_only_thing_on_standard_output(folder, capsys):
    _simulated(folder, LOOP)
    capsys.readouterr()
    assert main(["run", "loop.toml", "--json"]) == 0
    out, err = capsys.readouterr()
    assert json.loads(out) == json.loads((folder / "loop-result" / "result.json").read_text())
    assert err == ""


def test_refusal_has_a_status_of_its_own(folder, capsys):
    _simulated(folder, LOOP)
    still = pl.read_csv("record.csv").with_columns(sp=pl.lit(0.0))
    still.write_csv("record.csv")
    capsys.readouterr()
    assert main(["run", "loop.toml"]) == 3
    assert capsys.readouterr().out.splitlines()[1].startswith("No answer can be given: ")
    result = json.loads((folder / "loop-result" / "result.json").read_text())
    assert result["status"] == "refused"
    assert result["reasons"]
    assert not (folder / "loop-result" / "plant.toml").exists()


@pytest.mark.parametrize(("name", "changed"), [("splitter", {"top_temperature"}), ("wood-berry", {"top"})])
def test_demo_finds_what_it_says_was_changed(name, changed, folder, capsys):
    assert main(["demo", name]) == 0
    assert capsys.readouterr().out.splitlines()[1].startswith("The plant has changed")
    result = json.loads((folder / f"demo-{name}" / "result.json").read_text())
    found = {e["output"] for e in result["elements"] if e["verdict"] == "changed"}
    assert found == changed
    assert (folder / f"demo-{name}" / "project.toml").read_text() == demo_text(name)
