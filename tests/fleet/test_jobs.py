"""The loops of a site are ordinary projects, whether they are files of their own or rows of a table."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

import pytest

from trueplant.errors import ProjectError, UsageError
from trueplant.fleet import Site
from trueplant.fleet.jobs import Job, jobs_of
from trueplant.project import Project

TEMPLATE = """
time_unit = "min"  # of the whole site
[data]
files = ["data/{{file}}"]
[[output]]
name = "y"
pv = "{{tag}}.PV"
sp = "{{tag}}.SP"
[[input]]
name = "u"
op = "{{tag}}.OP"
[[controller]]
input = "u"
output = "y"
form = "ideal"
Kc = {{Kc}}
Ti = {{ Ti }}
"""
SOURCE = (
    TEMPLATE.replace('files = ["data/{{file}}"]', "") + '[data.source]\nkind = "parquet"\npath = "lake/*.parquet"\n'
)
STAMPS = "from = 2020-01-01T00:00:00Z\nto = 2020-01-02T00:00:00Z\n"
NOW = datetime(2026, 10, 5, 12, tzinfo=UTC)


def made(folder: Path, table: str, template: str = TEMPLATE, rest: str = "") -> list[Job]:
    (folder / "pid.toml").write_text(template, encoding="utf-8")
    (folder / "loops.csv").write_text(table, encoding="utf-8")
    site = folder / "site.toml"
    site.write_text(f'name = "x"\n[[loops]]\ntemplate = "pid.toml"\ntable = "loops.csv"\n{rest}', encoding="utf-8")
    return jobs_of(Site.load(site), folder / "out", NOW)


def test_each_row_is_a_project_that_can_be_opened(tmp_path: Path) -> None:
    jobs = made(tmp_path, "name,tag,file,Kc,Ti\nFC 1/2,FC1,a.csv,-2.5,8\nLC2,LC2,b.csv,1,\n")
    assert [job.name for job in jobs] == ["FC 1/2", "LC2"] and not any(job.problem for job in jobs)
    first, second = (Project.load(job.project) for job in jobs)
    assert first.outputs[0].pv == "FC1.PV" and first.controllers[0].Kc == -2.5
    assert first.experiments[0].path.resolve() == (tmp_path / "data" / "a.csv").resolve()
    assert second.controllers[0].Ti is None  # the line of an empty cell is left out
    assert "# of the whole site" in jobs[0].project.read_text(encoding="utf-8")


def test_semicolons_and_spaces(tmp_path: Path) -> None:
    jobs = made(tmp_path, "name; tag ;file;Kc;Ti\n A ; FC1;a.csv;1;2\n\n")
    assert jobs[0].name == "A" and Project.load(jobs[0].project).outputs[0].pv == "FC1.PV"


def test_a_row_without_a_sound_project_is_a_problem_of_its_own(tmp_path: Path) -> None:
    jobs = made(tmp_path, "name,tag,file,Kc,Ti\nA,FC1,a.csv,fast,8\nB,FC2,b.csv,1,8\n")
    assert not jobs[1].problem and jobs[1].project.is_file()
    assert "loops.csv, line 2" in jobs[0].problem and str(tmp_path / "project.toml") not in jobs[0].problem


def test_a_cell_cannot_write_toml(tmp_path: Path) -> None:
    jobs = made(tmp_path, 'name,tag,file,Kc,Ti\nA,"x""\nevil = ""1",a.csv,1,8\n')
    assert "quote" in jobs[0].problem and not jobs[0].project.exists()


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ("name,tag,file,Kc\nA,F,a.csv,1\n", ["no column 'Ti'", "pid.toml asks for it", "name, tag, file, Kc"]),
        ("tag,file,Kc,Ti\nF,a.csv,1,1\n", ["no column 'name'"]),
        ("name,tag,file,Kc,Ti\nA,F,a.csv,1,1\nA,G,a.csv,1,1\n", ["two loops are called 'A'"]),
        ("name,tag,file,Kc,Ti\nA b,F,a.csv,1,1\nA_b,G,a.csv,1,1\n", ["would share a file"]),
        ("name,tag,file,Kc,Ti\n,F,a.csv,1,1\n", ["line 2", "no name"]),
        ("name,tag,file,Kc,Ti\nA,F,a.csv,1,1,9\n", ["line 2", "more cells"]),
        ("name,tag,file,Kc,Ti\n", ["has no rows"]),
    ],
)
def test_mistakes_of_a_table(tmp_path: Path, table: str, words: list[str]) -> None:
    with pytest.raises(ProjectError) as error:
        made(tmp_path, table)
    assert all(word in str(error.value) for word in words), str(error.value)


def test_a_pattern_without_files(tmp_path: Path) -> None:
    (tmp_path / "site.toml").write_text('name = "x"\n[[loops]]\nprojects = "units/*.toml"\n', encoding="utf-8")
    with pytest.raises(ProjectError, match="no file fits 'units"):
        jobs_of(Site.load(tmp_path / "site.toml"), tmp_path / "out")


def test_what_an_audit_wrote_is_no_loop(tmp_path: Path, site: Path) -> None:
    out = site.parent / "site-audit"
    for name in ("projects/made.toml", "results/0/plant.toml"):
        (out / name).parent.mkdir(parents=True, exist_ok=True)
        (out / name).write_text((site.parent / "units" / "same.toml").read_text())
    site.write_text(site.read_text().replace("units/*.toml", "**/*.toml"))
    assert [job.name for job in jobs_of(Site.load(site), out)] == ["units/other", "units/same"]


def test_only_some(tmp_path: Path, site: Path) -> None:
    assert [job.name for job in jobs_of(Site.load(site), tmp_path / "out", only="*/s*")] == ["units/same"]
    with pytest.raises(UsageError, match="correct --only"):
        jobs_of(Site.load(site), tmp_path / "out", only="FC*")


@pytest.mark.parametrize(
    "data", ["", '[data]\ntime_zone = "Europe/Oslo"\n', f"[data]\n{STAMPS}"], ids=["none", "zone", "its own window"]
)
def test_the_window_goes_to_historians(tmp_path: Path, data: str) -> None:
    template = SOURCE.replace("[data]\n", data)
    (job,) = made(tmp_path, "name,tag,Kc,Ti\nA,FC1,1,8\n", template, '[audit]\nwindow = "30 d"\n')
    project = Project.load(job.project)
    assert project.window == (datetime(2026, 9, 5, tzinfo=UTC), datetime(2026, 10, 5, tzinfo=UTC))
    assert project.data.source is not None and project.data.source.path == "../../lake/*.parquet"
    assert project.snapshot == "A-snapshot.parquet"
    if "time_zone" in data:
        assert project.data.time_zone == "Europe/Oslo"


def test_a_project_of_its_own_gets_the_window_too(tmp_path: Path) -> None:
    text = SOURCE.replace("{{tag}}", "FC1").replace("{{Kc}}", "1").replace("{{ Ti }}", "2")
    text = text.replace("[data]\n", f"[data]\n{STAMPS}")
    (tmp_path / "units").mkdir()
    own = tmp_path / "units" / "fc1.toml"
    own.write_text(text, encoding="utf-8")
    site = tmp_path / "site.toml"
    site.write_text('name = "x"\n[[loops]]\nprojects = "units/*.toml"\n[audit]\nwindow = "30 d"\n', encoding="utf-8")
    (job,) = jobs_of(Site.load(site), tmp_path / "out", NOW)
    assert job.project != own and own.read_text(encoding="utf-8") == text
    assert Project.load(job.project).window[1] == datetime(2026, 10, 5, tzinfo=UTC)
