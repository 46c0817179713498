"""The snapshot of a historian: fetched where it is missing, whole or not there at all, and told of beside it."""

from __future__ import annotations

import hashlib
import json
import signal
import subprocess
import sys
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from support import historians
from support.command import ENVIRONMENT
from trueplant import connect
from trueplant.cli import main
from trueplant.connect import levels, sources
from trueplant.connect.settings import Settings
from trueplant.connect.source import Lost, TagInfo
from trueplant.errors import DataError, OutputError, ProjectError, SourceError
from trueplant.project import Project
from trueplant.record import read_record

LAKE = {"kind": "parquet", "path": "lake.parquet"}
SNAPSHOT = "project-snapshot.parquet"


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """One with the demo's events in a lake of one file, and a project of them."""
    monkeypatch.chdir(tmp_path)
    historians.events().write_parquet(tmp_path / "lake.parquet")
    historians.written(tmp_path, LAKE)
    return tmp_path


class Scripted:
    """A source that does what a test says, one entry for each read."""

    server = "scripted"

    def __init__(self, script):
        self.script, self.windows = script, []

    def describe(self, tags):
        return [TagInfo(tag, unit="degC", span=(0.0, 200.0), states={0: "MAN"}) for tag in tags]

    def read(self, tags, window):
        self.windows.append((tuple(tags), window.start, window.end))
        if self.script:
            step = self.script.pop(0)
            if isinstance(step, BaseException):
                raise step
        own = historians.events().filter(
            pl.col("tag").is_in(list(tags)) & pl.col("time").is_between(window.start, window.end, closed="left")
        )
        for k in range(0, own.height, 5000):
            yield own[k : k + 5000].with_columns(pl.lit("good").alias("quality"))

    def close(self):
        pass


@pytest.fixture
def scripted(monkeypatch: pytest.MonkeyPatch):
    """Every source that is opened does what is said."""

    def install(*script):
        source = Scripted(list(script))
        monkeypatch.setattr("trueplant.connect.fetching.open_source", lambda settings: source)
        monkeypatch.setattr(levels, "PAUSE", 0.001)
        return source

    return install


def test_the_snapshot_holds_the_events_and_tells_of_them(folder: Path):
    found = connect.fetch(Project.load("project.toml"))
    events = pl.read_parquet(folder / SNAPSHOT)
    assert events.columns == ["tag", "time", "value", "quality"]
    assert events.schema["time"] == pl.Datetime("us", "UTC") and events.schema["value"] == pl.Float64
    expected = historians.events().sort("tag", "time")
    assert events.select("tag", "time", "value").equals(expected) and set(events["quality"]) == {"good"}
    about = json.loads((folder / f"{SNAPSHOT}.json").read_text())
    assert found.new and found.about == about
    assert about["sha256"] == hashlib.sha256((folder / SNAPSHOT).read_bytes()).hexdigest()
    assert about["query"]["from"] == historians.START.isoformat() and about["events"] == expected.height
    assert {tag["tag"]: tag["events"] for tag in about["tags"]} == dict(expected.group_by("tag").len().rows())
    assert historians.leaves(folder) == {"project.toml", "lake.parquet", SNAPSHOT, f"{SNAPSHOT}.json"}


def test_the_record_is_that_of_the_file(folder: Path):
    (folder / "record.csv").write_bytes(historians.record())
    project = Project.load("project.toml")
    connect.ensure(project)
    from_file = read_record(folder / "record.csv", Project.from_toml(DEMO).layout())
    fetched = read_record(project.experiments[0].path, project.layout())
    np.testing.assert_allclose(fetched.t, from_file.t, atol=1e-9)
    for key in ("r", "u", "y"):
        np.testing.assert_array_equal(getattr(fetched, key), getattr(from_file, key))


DEMO = historians.demo_text("splitter")


def test_fetched_once_and_again_on_request(folder: Path, scripted, capsys):
    source = scripted()
    assert main(["fetch", "project.toml"]) == 0
    asked = len(source.windows)
    first = (folder / SNAPSHOT).read_bytes()
    assert main(["fetch", "project.toml"]) == 0 and len(source.windows) == asked
    assert "there already" in capsys.readouterr().out
    assert main(["check", "project.toml"]) == 0 and len(source.windows) == asked
    assert main(["check", "project.toml", "--refresh"]) == 0 and len(source.windows) == 2 * asked
    assert (folder / SNAPSHOT).read_bytes() == first
    # another window is another question
    historians.written(folder, LAKE, end=historians.END - timedelta(hours=3))
    assert main(["check", "project.toml"]) == 0 and len(source.windows) == 3 * asked
    # and one that was damaged is no answer
    (folder / SNAPSHOT).write_bytes(first[:-10])
    assert main(["fetch", "project.toml"]) == 0 and len(source.windows) == 4 * asked
    capsys.readouterr()


def test_what_was_before_the_window_is_looked_for_of_held_tags_only(folder: Path, scripted):
    begin = historians.START + timedelta(minutes=60)
    historians.written(folder, LAKE, start=begin)
    source = scripted()
    connect.fetch(Project.load("project.toml"))
    lead, *rest = source.windows
    assert set(lead[0]) == {"sp1", "sp2", "op1", "op2"}
    assert (lead[1], lead[2]) == (begin - timedelta(seconds=levels.LEADS[0]), begin)
    events = pl.read_parquet(folder / SNAPSHOT)
    early = events.filter(pl.col("time") < begin)
    assert sorted(early["tag"]) == ["op1", "op2", "sp1", "sp2"]
    assert set(early["time"]) == {begin - timedelta(seconds=6)}
    assert [window[1:] for window in rest] == [(begin, historians.END)]


def test_a_set_point_that_rests_is_looked_for_further_back(folder: Path):
    events, begin = historians.events(), historians.START + timedelta(minutes=60)
    rested = (pl.col("tag") == "sp1") & pl.col("time").is_between(historians.START + timedelta(minutes=10), begin)
    events.filter(~rested).write_parquet(folder / "lake.parquet")
    historians.written(folder, LAKE, start=begin)
    connect.fetch(Project.load("project.toml"))
    early = pl.read_parquet(folder / SNAPSHOT).filter(pl.col("time") < begin)
    stamps = dict(early.select("tag", "time").rows())
    assert stamps.pop("sp1") == historians.START + timedelta(minutes=10) - timedelta(seconds=6)
    assert stamps == dict.fromkeys(("sp2", "op1", "op2"), begin - timedelta(seconds=6))


def test_long_windows_are_read_slice_by_slice(folder: Path, scripted, monkeypatch):
    monkeypatch.setattr(levels, "SLICE", 3600.0)
    source = scripted()
    connect.fetch(Project.load("project.toml"))
    assert len(source.windows) == 2 + 6
    assert pl.read_parquet(folder / SNAPSHOT).height == historians.events().height


def test_a_lost_connection_is_tried_again(folder: Path, scripted):
    source = scripted(Lost("gone"), TimeoutError("slow"), ConnectionResetError(), None, Lost("gone", pause=0.001))
    connect.fetch(Project.load("project.toml"))
    assert len(source.windows) == 3 + 4
    assert pl.read_parquet(folder / SNAPSHOT).height == historians.events().height


@pytest.mark.parametrize("error", [Lost("gone"), RuntimeError(f"user:{historians.SECRET}@host broke"), SystemError()])
def test_a_source_that_does_not_answer_leaves_nothing(folder: Path, scripted, capsys, error):
    before = historians.leaves(folder)
    scripted(None, *[error] * levels.ATTEMPTS)
    assert main(["run", "project.toml"]) == 4
    err = capsys.readouterr().err
    assert err.count("\n") == 1 and "nothing was written" in err
    assert historians.leaves(folder) == before


def test_an_old_snapshot_survives_a_failure(folder: Path, scripted):
    scripted()
    project = Project.load("project.toml")
    connect.fetch(project)
    before = (folder / SNAPSHOT).read_bytes()
    scripted(None, *[Lost("gone")] * levels.ATTEMPTS)
    with pytest.raises(SourceError):
        connect.fetch(project, refresh=True)
    assert (folder / SNAPSHOT).read_bytes() == before
    assert not connect.fetch(project).new


def test_interrupted_leaves_nothing(folder: Path, scripted, monkeypatch, capsys):
    before = historians.leaves(folder)
    scripted(None, KeyboardInterrupt())
    assert main(["fetch", "project.toml"]) == 130
    monkeypatch.setattr("trueplant.connect.snapshot.os.fsync", lambda number: (_ for _ in ()).throw(KeyboardInterrupt))
    scripted()
    assert main(["fetch", "project.toml"]) == 130
    assert historians.leaves(folder) == before
    capsys.readouterr()


def test_a_kill_while_it_is_written_leaves_nothing_that_counts(folder: Path, capsys):
    """A process is killed between both moves: the next one reads again and removes what is left."""
    kill = (
        "import os, signal, sys; from pathlib import Path; from trueplant.cli import main\n"
        "move = Path.replace\n"
        "def once(self, target):\n"
        "    move(self, target); os.kill(os.getpid(), signal.SIGKILL)\n"
        "Path.replace = once; main(['fetch', 'project.toml'])"
    )
    ended = subprocess.run([sys.executable, "-c", kill], env=ENVIRONMENT, check=False)
    assert ended.returncode == -signal.SIGKILL
    left = [path.name for path in folder.glob(".*.part")]
    assert left and not (folder / SNAPSHOT).exists()
    assert main(["fetch", "project.toml"]) == 0
    assert historians.leaves(folder) == {"project.toml", "lake.parquet", SNAPSHOT, f"{SNAPSHOT}.json"}
    capsys.readouterr()


def test_what_a_running_process_writes_is_left_alone(folder: Path):
    other = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)"])
    try:
        waiting = folder / f".{SNAPSHOT}.{other.pid}-0123.part"
        waiting.touch()
        connect.fetch(Project.load("project.toml"))
        assert waiting.exists()
    finally:
        other.kill()
        other.wait()
    connect.fetch(Project.load("project.toml"), refresh=True)
    assert not waiting.exists()


def test_a_file_of_somebody_else_is_not_replaced(folder: Path):
    (folder / SNAPSHOT).write_bytes(b"mine")
    with pytest.raises(OutputError, match=r"data\.source\.snapshot"):
        connect.fetch(Project.load("project.toml"))
    assert (folder / SNAPSHOT).read_bytes() == b"mine"


def test_a_tag_without_events_is_named(folder: Path):
    historians.events().filter(pl.col("tag") != "op2").write_parquet(folder / "lake.parquet")
    with pytest.raises(DataError, match="no event of tag 'op2'"):
        connect.fetch(Project.load("project.toml"))
    assert historians.leaves(folder) == {"project.toml", "lake.parquet"}


def test_too_many_events_are_refused(folder: Path):
    historians.written(folder, LAKE, data="max_samples = 1000")
    with pytest.raises(DataError, match=r"more than 1,000 events"):
        connect.fetch(Project.load("project.toml"))


def test_names_of_the_source_follow_the_template(folder: Path):
    renamed = historians.events().with_columns(pl.format("Site.{}.Value", "tag").alias("tag"))
    renamed.write_parquet(folder / "lake.parquet")
    historians.written(folder, LAKE | {"tag": "Site.{}.Value"})
    connect.fetch(Project.load("project.toml"))
    assert set(pl.read_parquet(folder / SNAPSHOT)["tag"]) == set(historians.TAGS)


def test_plant_toml_goes_on_with_the_same_snapshot(folder: Path, monkeypatch):
    project = Project.load("project.toml")
    out = folder / "out"
    out.mkdir()
    (out / "plant.toml").write_text(project.to_toml(out))
    connect.fetch(project)
    (folder / "lake.parquet").rename(folder / "gone.parquet")
    moved = Project.load(out / "plant.toml")
    assert not connect.fetch(moved).new
    assert moved.experiments[0].path.samefile(folder / SNAPSHOT)
    assert moved.data.source is not None and moved.data.source.path == "../lake.parquet"


def test_a_project_without_a_historian_has_nothing_to_fetch(folder: Path):
    with pytest.raises(ProjectError, match=r"add \[data.source\]"):
        connect.fetch(Project.from_toml(DEMO))


def test_a_missing_package_is_said_in_one_sentence(folder: Path, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "asyncua", None)
    sys.modules.pop("trueplant.connect.opcua", None)
    source = {"kind": "opcua", "url": "opc.tcp://127.0.0.1:1"}
    historians.written(folder, source)
    assert main(["fetch", "project.toml"]) == 2
    assert "pip install 'trueplant[opcua]'" in capsys.readouterr().err


def test_a_bundle_has_no_address_in_it(folder: Path, capsys):
    import zipfile

    assert main(["bundle", "project.toml"]) == 0
    with zipfile.ZipFile("bundle.zip") as archive:
        texts = {name: archive.read(name).decode() for name in archive.namelist()}
    assert "lake.parquet" not in "".join(texts.values()) and "[data.source]" not in texts["project.toml"]
    Path("other").mkdir()
    for name, text in texts.items():
        (Path("other") / name).write_text(text)
    assert main(["check", "other/project.toml"]) == 0
    capsys.readouterr()


# -- what the project file may say ---------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("source", "words"),
    [
        (LAKE | {"password": "abc"}, "data.source.password: a secret must not stand in a project file"),
        (LAKE | {"api_key": "abc"}, "a secret must not stand"),
        ({"kind": "postgresql", "url": "postgresql://u:abc@h/db", "query": "x"}, "url: holds a password"),
        ({"kind": "postgresql", "url": "postgresql://h/db?user=u&password=abc", "query": "x"}, "url: holds a password"),
        ({"kind": "postgresql", "query": "x"}, "data.source.url_env: is needed"),
        ({"kind": "parquet"}, "data.source.path: is needed"),
        (LAKE | {"url": "x"}, 'has no meaning with kind = "parquet"'),
        (LAKE | {"tag": "x"}, "must hold {} where"),
        (LAKE | {"kind": "influx"}, "data.source.kind: must be"),
        (LAKE | {"hve": True}, 'did you mean "hive"?'),
        ({"kind": "pi", "url": "http://pi", "server": "s"}, "must begin with https://"),
        ({"kind": "pi", "url": "https://pi", "server": "s", "auth": "basic", "user": "u"}, "password_env: is needed"),
        ({"kind": "opcua", "url": "opc.tcp://h", "user": "u", "password_env": "X"}, "sign and encrypt"),
        ({"kind": "opcua", "url": "opc.tcp://h", "security": "sign"}, "certificate: is needed"),
        ({"kind": "opcua", "url": "opc.tcp://h", "password_env": "X"}, "data.source.user: is needed"),
    ],
    ids=lambda value: str(value)[:40],
)
def test_mistakes_in_the_source_are_named(source, words):
    with pytest.raises(ProjectError) as raised:
        Project.from_toml(historians.project(source))
    assert words.replace("{}", "") in str(raised.value).replace("{}", "").replace("()", "")
    assert "abc" not in str(raised.value)


@pytest.mark.parametrize(
    ("data", "words"),
    [
        ("sample_time = 5", "data.max_gap: sample_time and max_gap go together"),
        ("sample_time = 5\nmax_gap = 2", "at least sample_time"),
        ('files = ["a.csv"]', "data.files: says how files are read"),
        ('tag = "name"', "data.tag: says how files are read"),
    ],
)
def test_mistakes_beside_the_source_are_named(data, words):
    with pytest.raises(ProjectError, match=words):
        Project.from_toml(historians.project(LAKE, data=data))


def test_ends_of_the_window():
    def text(start: str, end: str, data: str = "") -> str:
        said = historians.project(LAKE, data=data)
        lines = [line for line in said.splitlines() if not line.startswith(("from =", "to ="))]
        k = lines.index("[data]")
        return "\n".join([*lines[: k + 1], f"from = {start}", f"to = {end}", *lines[k + 1 :]])

    with pytest.raises(ProjectError, match="bears no offset from UTC"):
        Project.from_toml(text("2026-10-01T00:00:00", "2026-10-02T00:00:00"))
    oslo = 'time_zone = "Europe/Oslo"'
    project = Project.from_toml(text("2026-10-01T00:00:00", "2026-10-02T00:00:00", oslo))
    assert project.window[0] == datetime(2026, 9, 30, 22, tzinfo=UTC)
    with pytest.raises(ProjectError, match="the clock skips that hour"):
        Project.from_toml(text("2026-03-29T02:30:00", "2026-10-02T00:00:00", oslo))
    with pytest.raises(ProjectError, match="must come after from"):
        Project.from_toml(text("2026-10-02T00:00:00Z", "2026-10-01T00:00:00Z"))
    with pytest.raises(ProjectError, match="goes with .data.source."):
        Project.from_toml(DEMO.replace("[data]\n", "[data]\nfrom = 2026-10-01T00:00:00Z\n"))


def test_secrets_come_from_the_environment_or_a_file_and_go_nowhere(tmp_path: Path, monkeypatch):
    from trueplant.project.source_table import Historian

    table = Historian(kind="postgresql", url="postgresql://reader@host/db", query="x", user="reader", password_env="PW")
    monkeypatch.delenv("PW", raising=False)
    with pytest.raises(ProjectError, match="the environment variable PW is not set"):
        Settings(table, tmp_path).password()
    monkeypatch.setenv("PW", historians.SECRET)
    settings = Settings(table, tmp_path)
    assert settings.address() == "postgresql://reader:s3cr3t%21%2Fp%C3%A4ss@host/db"
    assert (
        settings.clean(f"no {historians.SECRET} at {settings.address()}") == "no *** at postgresql://reader:***@host/db"
    )
    assert historians.SECRET not in repr(settings)
    (tmp_path / "pw").write_text(f"{historians.SECRET}\n", encoding="utf-8")
    from_file = table.model_copy(update={"password_env": None, "password_file": "pw"})
    assert Settings(from_file, tmp_path).password() == historians.SECRET


def test_every_kind_has_its_module():
    from typing import get_args

    from trueplant.project.source_table import NEEDED, Kind

    assert set(get_args(Kind)) == sources.KINDS.keys() == NEEDED.keys()
