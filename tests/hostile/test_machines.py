"""Machines, users and names that are out of the ordinary: each run is done whole, or says in one message why not."""

from __future__ import annotations

import ctypes
import importlib.util
import json
import os
import random
import re
import signal
import subprocess
import sys
import time
import tomllib
from collections import Counter
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import polars as pl
import pytest
import tomlkit
from numba.core import caching

import trueplant
from support import ROOT
from support.command import ENVIRONMENT, PROJECT, contents, refused
from support.old_excel import old_workbook
from trueplant import output, threads
from trueplant.cli import main
from trueplant.compiled import compiled
from trueplant.record import levels, read_table


def apart(folder: Path, *arguments: str, options: tuple[str, ...] = (), **environment: str) -> tuple[int, str, str]:
    """Status, standard output and standard error of a command in a process of its own; "" takes a variable away."""
    variables = {name: value for name, value in (ENVIRONMENT | environment).items() if value}
    line = [sys.executable, *options, "-m", "trueplant", *arguments]
    done = subprocess.run(line, cwd=folder, env=variables, capture_output=True, timeout=300)
    return done.returncode, done.stdout.decode(), done.stderr.decode()


# -- kills and Ctrl-C ----------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_runs_that_are_killed_leave_the_old_result_or_the_new_one(tmp_path):
    line = [sys.executable, str(ROOT / "benchmarks" / "kills.py"), "--kills", "12", "--seed", "1"]
    done = subprocess.run(line, cwd=tmp_path, env=ENVIRONMENT, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "old" in done.stdout and "mended" in done.stdout and "broken" not in done.stdout


@pytest.mark.slow
def test_ctrl_c_ends_a_command_with_one_message(folder):
    assert main(["run", "project.toml", "--out", "out"]) == 0
    before, rng, ends = contents(folder), random.Random(0), Counter[str]()
    # what runs in the background, as these tests may, ignores Ctrl-C
    begun = (
        "import signal; signal.signal(signal.SIGINT, signal.default_int_handler); from trueplant.cli import main; "
        "print('begun', flush=True); raise SystemExit(main())"
    )
    for k in range(12):
        arguments = ["run", "project.toml", "--out", "out"] if k % 2 else ["check", "project.toml"]
        line = [sys.executable, "-c", begun, *arguments]
        with subprocess.Popen(line, cwd=folder, env=ENVIRONMENT, stdout=-1, stderr=-1, text=True) as process:
            assert process.stdout.readline() == "begun\n"
            time.sleep(rng.uniform(0.1, 4 if k % 2 else 2))
            process.send_signal(signal.SIGINT)
            _, err = process.communicate()
        if process.returncode == 0:  # it had done its work
            assert err == ""
        else:
            # where the signal meets code that a library runs, Python ends by the signal: shells call that 130 too
            assert process.returncode in (130, -signal.SIGINT)
            assert err == "trueplant: interrupted; no file was left half written\n"
            ends["interrupted"] += 1
    assert contents(folder) == before
    assert ends["interrupted"] >= 6


def test_ctrl_c_where_c_code_calls_back_comes_again(capsys, folder, monkeypatch):
    """Python drops what is raised there, and says so at length; numba's compiled functions are loaded so."""
    back = ctypes.CFUNCTYPE(None)(lambda: signal.raise_signal(signal.SIGINT))

    def loads(*_):
        back()
        time.sleep(20)

    monkeypatch.setattr("trueplant.cli.data.init", loads)
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    hook = sys.unraisablehook
    try:
        assert main(["init", "record.csv"]) == 130
    finally:
        signal.signal(signal.SIGINT, before)
    assert sys.unraisablehook is hook
    assert capsys.readouterr().err == "trueplant: interrupted; no file was left half written\n"


def test_ctrl_c_while_files_are_moved_waits_until_all_are(tmp_path, monkeypatch):
    output.write_files(tmp_path, {"a": "old", "b": "old"})
    moved = Path.replace

    def interrupted(self, target):
        signal.raise_signal(signal.SIGINT)
        return moved(self, target)

    monkeypatch.setattr(Path, "replace", interrupted)
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with pytest.raises(KeyboardInterrupt):
            output.write_files(tmp_path, {"a": "new", "b": "new"})
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    finally:
        signal.signal(signal.SIGINT, before)
    assert sorted((p.name, p.read_text()) for p in tmp_path.iterdir()) == [("a", "new"), ("b", "new")]


def test_who_presses_ctrl_c_again_gets_one_message_too(capsys, folder, monkeypatch):
    said = []

    def impatient(message):
        signal.raise_signal(signal.SIGINT)
        said.append(message)

    monkeypatch.setattr("trueplant.cli.entry._say", impatient)
    monkeypatch.setattr("trueplant.cli.data.init", lambda *_: signal.raise_signal(signal.SIGINT))
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        assert main(["init", "record.csv"]) == 130
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    finally:
        signal.signal(signal.SIGINT, before)
    assert said == ["interrupted; no file was left half written"]


def test_a_demo_that_was_interrupted_can_be_repeated(tmp_path, monkeypatch):
    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("trueplant.cli.analyse._analyse", interrupted)
    for _ in range(2):
        assert main(["demo", "splitter", "--out", "demo"]) == 130
    assert sorted(contents(tmp_path)) == ["demo/project.toml", "demo/record.csv"]


# -- threads -------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_result_is_the_same_with_1_and_with_16_threads(tmp_path):
    for count in ("1", "16"):
        (tmp_path / count).mkdir()
        names = (*threads.VARIABLES, "NUMBA_NUM_THREADS", "POLARS_MAX_THREADS")
        status, _, err = apart(tmp_path / count, "demo", "splitter", **dict.fromkeys(names, count))
        assert (status, err) == (0, "")
    assert len(contents(tmp_path / "1")) == 6
    assert contents(tmp_path / "1") == contents(tmp_path / "16")


def test_the_libraries_of_a_notebook_get_their_threads_back():
    (get, put), *_ = threads._switches()
    before = get()
    try:
        put(2)
        first, second = threads.one_thread(), threads.one_thread()
        with first:
            assert get() == 1
            second.__enter__()
        assert get() == 1  # the second is still at work
        second.__exit__(None, None, None)
        assert get() == 2
    finally:
        put(before)


# -- places and environments ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "environment"),
    [
        ((), {"HOME": "", "XDG_CACHE_HOME": "", "TMPDIR": "/nonexistent"}),
        ((), {"HOME": "/nonexistent", "XDG_CACHE_HOME": "/proc/nonexistent"}),
        ((), {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0", "PYTHONIOENCODING": "ascii"}),
        (("-W", "error"), {}),
        pytest.param(("-O",), {}, marks=pytest.mark.slow),  # compiled code of their own
        pytest.param(("-OO",), {}, marks=pytest.mark.slow),
    ],
)
def test_environments_make_no_difference(options, environment, folder):
    status, out, err = apart(folder, "check", "project.toml", options=options, **environment)
    assert (status, err) == (0, "")
    assert "601 samples" in out


def test_a_full_disk_is_one_message_and_leaves_nothing_behind(folder):
    before = contents(folder)
    line = f"ulimit -f 100; exec {sys.executable} -m trueplant run project.toml --out new/out"
    done = subprocess.run(["bash", "-c", line], cwd=folder, env=ENVIRONMENT, capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == "trueplant: cannot write to new/out (File too large): name another folder with --out\n"
    assert contents(folder) == before and not (folder / "new").exists()


def module(path: Path):
    """A module with a compiled function, read anew."""
    path.write_text("from trueplant.compiled import compiled\n\n@compiled\ndef twice(x):\n    return 2 * x\n")
    spec = importlib.util.spec_from_file_location(path.stem, path)
    found = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(found)
    return found


def test_compiled_functions_are_kept_and_bear_damage_to_where_they_are_kept(tmp_path, monkeypatch):
    assert module(tmp_path / "one.py").twice(2) == 4
    again = module(tmp_path / "one.py")
    assert again.twice(2) == 4 and sum(again.twice.stats.cache_hits.values()) == 1
    stored = [*tmp_path.rglob("*.nbi"), *tmp_path.rglob("*.nbc")]
    assert len(stored) == 2
    for place in stored:
        place.write_bytes(b"")
        assert module(tmp_path / "one.py").twice(2) == 4
    mended = module(tmp_path / "one.py")
    assert mended.twice(2) == 4 and sum(mended.twice.stats.cache_hits.values()) == 1

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(caching.IndexDataCacheFile, "save", full)
    assert mended.twice(2.5) == 5


def test_functions_are_compiled_where_nothing_can_be_kept(monkeypatch):
    monkeypatch.setattr(caching.CacheImpl, "_locator_classes", [])
    assert compiled(lambda x: x + 1)(2) == 3
    assert compiled(fastmath=True)(lambda x: x + 1)(2) == 3


# -- names ---------------------------------------------------------------------------------------------------------

MARKUP = """</script><script>document.title='pwned'</script><img id=pwned src=x onerror="document.title='pwned'">"""
NAME = MARKUP + "&amp;'\"`\\ \n\t]]>--><svg onload=x>\u202e\x1b[2J\u2028 = [[output]] %{x} ${y} {{z}}" + 100 * "long"


class Page(HTMLParser):
    """What a browser would make of a page, as far as it can be steered by names."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags, self.found = Counter[str](), []
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        self.tags[tag] += 1
        self.found += [
            (tag, key, value)
            for key, value in attributes
            if key.startswith("on") or value == "pwned" or "javascript:" in (value or "")
        ]


def named(folder: Path, name: str) -> None:
    """The record and project again, with columns, signals and files that hold the name."""
    frame = pl.read_csv(folder / "record.csv").rename({"pv": f"{name}.PV", "op": f"{name}.OP", "sp": f"{name}.SP"})
    file = "r<img src=x onerror=x>&amp;\u202e.parquet"
    frame.write_parquet(folder / file)
    text = PROJECT.split("[simulate]")[0].replace("record.csv", file)
    for key in ("pv", "op", "sp"):
        text = text.replace(f'{key} = "{key}"', f"{key} = {tomlkit.item(f'{name}.{key.upper()}').as_string()}")
    for key, old in (("output", "y"), ("input", "u"), ("name", "y"), ("name", "u")):
        text = text.replace(f'{key} = "{old}"', f"{key} = {tomlkit.item(name + old).as_string()}")
    (folder / "project.toml").write_text(text)


def test_names_become_neither_markup_nor_steering(folder, capsys):
    plain = {}
    for name in ("name", NAME):
        named(folder, name)
        for command in (["check"], ["run", "--out", "out"], ["track", "--out", "track"]):
            assert main([command[0], "project.toml", *command[1:]]) in (0, 3)
        pages = {name: Page(Path(name).read_text("utf-8")) for name in ("out/report.html", "track/track.html")}
        plain = plain or {name: page.tags for name, page in pages.items()}
        assert {name: page.tags for name, page in pages.items()} == plain
        assert [page.found for page in pages.values()] == [[], []]
    out, err = capsys.readouterr()
    assert not re.search("[\x00-\x08\x0b-\x1f\x7f\u202e\u2028]", out + err)
    assert tomllib.loads(Path("out/plant.toml").read_text("utf-8"))["output"][0]["pv"] == f"{NAME}.PV"
    assert json.loads(Path("track/track.json").read_text("utf-8"))["elements"][0]["output"] == NAME + "y"
    assert main(["init", "r<img src=x onerror=x>&amp;\u202e.parquet", "--out", "new.toml"]) == 0
    assert tomllib.loads(Path("new.toml").read_text("utf-8"))["output"][0]["pv"] == f"{NAME}.PV"


def test_a_name_with_a_line_end_makes_no_second_message(folder, capsys):
    refused(["run", "no\ntrueplant: all is well.toml"], capsys, "no\\ntrueplant: all is well.toml does not exist")


def test_paths_that_are_not_utf_8(folder, capsys):
    strange = Path(os.fsdecode(b"d\xff"))
    strange.mkdir()
    (strange / "project.toml").write_text(PROJECT)
    (strange / "record.csv").write_text((folder / "record.csv").read_text())
    (strange / "project.toml").rename(strange / os.fsdecode(b"p\xff.toml"))
    project = str(strange / os.fsdecode(b"p\xff.toml"))
    refused(["run", project, "--out", "out"], capsys, "d\\udcff/record.csv", "not Unicode", "--out")
    refused(["init", str(strange / "record.csv"), "--out", "new.toml"], capsys, "d\\udcff/record.csv", "not Unicode")
    assert main(["run", project, "--out", str(strange / os.fsdecode(b"o\xff"))]) == 0
    assert "d\\udcff/o\\udcff/report.html" in capsys.readouterr().out
    written = [p.read_text("utf-8") for p in (strange / os.fsdecode(b"o\xff")).iterdir()]
    assert len(written) == 4
    assert trueplant.load(strange / os.fsdecode(b"o\xff")).status == "ok"


# -- old workbooks -------------------------------------------------------------------------------------------------

CELLS = {(row, column): row + column / 7 for row in range(1, 50) for column in range(2)}


def test_an_old_workbook_is_read(folder):
    Path("record.xls").write_bytes(old_workbook(["t", "pv"], CELLS))
    table = read_table("record.xls")
    assert table.names == ("t", "pv")
    np.testing.assert_array_equal(table.frame[:, 1].cast(pl.Float64), [CELLS[k, 1] for k in range(1, 50)])


def test_an_old_workbook_that_ends_the_process_that_reads_it_is_refused(folder, capsys, monkeypatch):
    (folder / "project.toml").write_text(PROJECT.replace("record.csv", "record.xls"))
    Path("record.xls").write_bytes(old_workbook(["t", "pv"], CELLS | {(65535, 65535): 1.0}))
    refused(["check", "project.toml"], capsys, "record.xls", "the library fails on it", "save it as XLSX")
    monkeypatch.setattr(levels, "MOST_SECONDS_APART", 0.01)
    refused(["check", "project.toml"], capsys, "record.xls", "cannot be read in 0.01 s")
