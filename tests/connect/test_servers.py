"""The same for every kind of historian: what it holds is what the analysis gets, and its answer or none."""

from __future__ import annotations

import json
from datetime import timedelta
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from support import historians
from trueplant import connect
from trueplant.cli import main
from trueplant.project import Project
from trueplant.record import read_record

KINDS = ("parquet", "sqlite", "postgresql", "opcua", "pi")
each = pytest.mark.parametrize("kind", KINDS)
"""OPC UA takes some seconds each time, for its server to start."""
most = pytest.mark.parametrize("kind", [*KINDS[:3], pytest.param("opcua", marks=pytest.mark.slow), "pi"])


@each
def test_the_record_is_that_of_the_file(kind: str, serve, tmp_path: Path):
    served = serve(kind, historians.events())
    project = Project.load(historians.written(tmp_path, served.source))
    connect.ensure(project)
    (tmp_path / "record.csv").write_bytes(historians.record())
    from_file = read_record("record.csv", Project.from_toml(historians.demo_text("splitter")).layout())
    fetched = read_record(project.experiments[0].path, project.layout())
    np.testing.assert_allclose(fetched.t, from_file.t, atol=1e-9)
    for key in ("r", "u", "y"):
        np.testing.assert_array_equal(getattr(fetched, key), getattr(from_file, key))


@most
def test_qualities_arrive_as_words(kind: str, serve, tmp_path: Path):
    """All bad is all bad: from numbers 0, 0, 0 somebody else would guess good."""
    words = historians.events().with_columns(
        quality=pl.when(pl.col("tag") == "pv1").then(pl.lit("bad"))
        .when(pl.col("tag") == "pv2").then(pl.lit("uncertain")).otherwise(pl.lit("good"))
    )  # fmt: skip
    served = serve(kind, words)
    connect.fetch(Project.load(historians.written(tmp_path, served.source)))
    told = json.loads((tmp_path / "project-snapshot.parquet.json").read_text())
    counts = {tag["tag"]: {word: tag[word] for word in ("good", "uncertain", "bad")} for tag in told["tags"]}
    assert counts["pv1"] == {"good": 0, "uncertain": 0, "bad": 3001}
    assert counts["pv2"] == {"good": 0, "uncertain": 3001, "bad": 0}
    assert counts["op1"] == {"good": 3001, "uncertain": 0, "bad": 0}


@most
def test_a_window_is_kept_to(kind: str, serve, tmp_path: Path):
    served = serve(kind, historians.events())
    start, end = historians.START + timedelta(minutes=60), historians.START + timedelta(minutes=90)
    project = Project.load(historians.written(tmp_path, served.source, start=start, end=end))
    connect.fetch(project)
    found = pl.read_parquet(tmp_path / "project-snapshot.parquet")
    inside = historians.events().filter(pl.col("time").is_between(start, end, closed="left"))
    own = found.filter(pl.col("time") >= start)
    assert own.drop("quality").equals(inside.sort("tag", "time"))
    assert found.height - own.height == 4


@most
def test_an_unknown_tag_is_named(kind: str, serve, tmp_path: Path, capsys):
    served = serve(kind, historians.events())
    place = historians.written(tmp_path, served.source)
    place.write_text(place.read_text().replace('"op2"', '"op9"'))
    before = historians.leaves(tmp_path)
    assert main(["fetch", "project.toml"]) == 2
    err = capsys.readouterr().err
    assert "op9" in err and err.count("\n") == 1
    assert historians.leaves(tmp_path) == before


@pytest.mark.slow
def test_the_elements_are_those_of_the_file(serve, tmp_path: Path, capsys):
    """The whole way for all kinds, each compared with the run of the CSV file."""
    (tmp_path / "record.csv").write_bytes(historians.record())
    (tmp_path / "csv.toml").write_text(historians.demo_text("splitter"))
    assert main(["run", "csv.toml", "--out", "csv"]) == 0
    expected, printed = _elements(tmp_path / "csv"), [""]
    assert len(expected) == 3
    for kind in KINDS:
        served = serve(kind, historians.events())
        historians.written(tmp_path, served.source)
        assert main(["run", "project.toml", "--out", kind, "--refresh"]) == 0, capsys.readouterr().err
        printed.append("".join(capsys.readouterr()))
        found = _elements(tmp_path / kind)
        assert found.keys() == expected.keys()
        for place, parameters in expected.items():
            np.testing.assert_allclose(found[place], parameters, rtol=1e-6, err_msg=f"{kind}: {place}")
    everything = [text.encode() for text in printed]
    everything += [path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()]
    assert not any(secret in content for content in everything for secret in _spellings())


def _elements(folder: Path) -> dict[tuple[str, str], list[float]]:
    """Value and standard error of every parameter, by element."""
    document = json.loads((folder / "result.json").read_text())
    return {
        (one["output"], one["input"]): [number for p in one["parameters"] for number in (p["plant"], p["std_error"])]
        for one in document["elements"]
        if one["parameters"]
    }


def _spellings() -> list[bytes]:
    from urllib.parse import quote

    return [spelling.encode() for spelling in (historians.SECRET, quote(historians.SECRET, safe=""))]
