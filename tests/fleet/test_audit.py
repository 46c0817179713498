"""An audit: a row a loop whatever becomes of it, and nothing computed twice."""

from __future__ import annotations

import time
from datetime import UTC, datetime
from pathlib import Path

import polars as pl
import pytest

from trueplant.fleet import Audited, Options, Site, audit
from trueplant.fleet import worker as worker_module
from trueplant.fleet.deadline import PastDeadline, limited
from trueplant.fleet.key import key_of
from trueplant.fleet.rank import COLUMNS
from trueplant.fleet.row import Outcome
from trueplant.fleet.store import Store
from trueplant.project import Project

TODAY, TOMORROW = datetime(2026, 10, 5, 1, tzinfo=UTC), datetime(2026, 10, 6, 1, tzinfo=UTC)


def run(site: Path, when: datetime = TODAY, **options: object) -> Audited:
    return audit(Site.load(site), site.parent / "out", Options(now=when, workers=0, **options))  # type: ignore[arg-type]


def outcomes(audited: Audited) -> dict[str, str]:
    return {one.name: one.row.outcome for one in audited.loops}


def test_a_changed_plant_comes_first_and_the_table_says_it(site: Path) -> None:
    audited = run(site)
    assert [one.name for one in audited.loops] == ["units/other", "units/same"]
    table = pl.read_parquet(audited.run / "audit.parquet", hive_partitioning=False)
    assert {name: str(kind) for name, kind in table.schema.items()} == COLUMNS
    first = table.to_dicts()[0]
    assert (first["loop"], first["verdict"], first["since"]) == ("units/other", "changed", "2026-10-05T01-00-00Z")
    assert first["change"].startswith("gain +") and first["cpu_s"] > 0 and first["memory_mb"] > 10
    assert audited.mismatch and (site.parent / "out" / "results" / first["key"] / "result.json").is_file()


def test_what_fails_is_a_row(site: Path) -> None:
    units = site.parent / "units"
    (units / "broken.toml").write_text("time_unit = 3", encoding="utf-8")
    (units / "gone.toml").write_text((units / "same.toml").read_text().replace("same.csv", "gone.csv"))
    historian = (units / "same.toml").read_text().replace('files = ["same.csv"]\ntime = "t"', "")
    stamps = "from = 2026-01-01T00:00:00Z\nto = 2026-01-02T00:00:00Z\n"
    text = f'{historian}\n[data.source]\nkind = "sqlite"\npath = "no.db"\nquery = "select 1"\n'
    (units / "silent.toml").write_text(text.replace("[data]\n", f"[data]\n{stamps}", 1))
    audited = run(site)
    found = outcomes(audited)
    assert found["units/same"] == Outcome.ANALYSED
    assert [found[f"units/{name}"] for name in ("broken", "gone", "silent")] == [Outcome.FAILED] * 3
    texts = {one.name: one.row.text for one in audited.loops}
    assert "time_unit" in texts["units/broken"] and "gone.csv does not exist" in texts["units/gone"]
    table = pl.read_parquet(audited.run / "audit.parquet", hive_partitioning=False)
    assert sorted(table["loop"]) == sorted(found) and table["error"].str.len_chars().gt(0).sum() == 3


def test_only_what_is_new_is_computed(site: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first = run(site)
    worked: list[str] = []
    real = worker_module._analysed
    monkeypatch.setattr(worker_module, "_analysed", lambda own, *rest: worked.append(own.task.name) or real(own, *rest))
    again = run(site, TOMORROW)
    assert not worked and outcomes(again) == outcomes(first)
    record = site.parent / "units" / "same.csv"
    record.write_bytes(b"\n".join(record.read_bytes().splitlines()[:-20]))
    run(site, TOMORROW)
    assert worked == ["units/same"]


def test_since_is_the_first_audit_that_found_it(site: Path) -> None:
    run(site)
    other = {one.name: one for one in run(site, TOMORROW).loops}["units/other"]
    assert dict(other.since) == {("y", "u"): "2026-10-05T01-00-00Z"}


def test_the_key_is_that_of_the_content(site: Path, tmp_path: Path) -> None:
    project = site.parent / "units" / "same.toml"
    key = key_of(Project.load(project), False)
    moved = tmp_path / "elsewhere" / "renamed.toml"
    moved.parent.mkdir()
    moved.write_text(project.read_text().replace('"same.csv"', '"record.csv"'))
    (moved.parent / "record.csv").write_bytes((project.parent / "same.csv").read_bytes())
    assert key_of(Project.load(moved), False) == key
    assert key_of(Project.load(moved), True) != key
    moved.write_text(moved.read_text().replace("Ti = 6.0", "Ti = 6.5"))
    assert key_of(Project.load(moved), False) != key


def test_a_loop_past_its_deadline_is_a_row_and_is_tried_again_with_more_time(
    site: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = worker_module.key_of

    def slow(project: Project, finds: bool) -> str:
        if "same" in project.source:
            end = time.monotonic() + 20
            while time.monotonic() < end:
                time.sleep(0.01)
        return real(project, finds)

    monkeypatch.setattr(worker_module, "key_of", slow)
    text = site.read_text()
    site.write_text(f'{text}\n[audit]\ndeadline = "1 s"\n')
    began = time.monotonic()
    audited = run(site, only="*/same")
    assert outcomes(audited) == {"units/same": Outcome.LATE} and time.monotonic() - began < 15
    assert "raise audit.deadline" in audited.loops[0].row.text
    run(site, only="*/same")
    monkeypatch.setattr(worker_module, "key_of", real)
    assert outcomes(run(site, only="*/same")) == {"units/same": Outcome.LATE}
    site.write_text(f'{text}\n[audit]\ndeadline = "5 min"\n')
    assert outcomes(run(site, only="*/same")) == {"units/same": Outcome.ANALYSED}


def test_a_limit_that_is_not_reached_raises_nothing_later() -> None:
    for _ in range(50):
        with limited(0.05):
            pass
    time.sleep(0.1)

    def endless() -> None:
        with limited(0.05):
            while True:
                time.sleep(0.001)

    with pytest.raises(PastDeadline):
        endless()


def test_a_limit_that_is_not_heard_is_told_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("trueplant.fleet.levels.AGAIN", 0.1)
    heard = 0

    def deaf() -> None:
        nonlocal heard
        with limited(0.05):
            while True:
                try:
                    time.sleep(0.001)
                except PastDeadline:
                    heard += 1
                    if heard == 3:
                        raise

    with pytest.raises(PastDeadline):
        deaf()
    assert heard == 3


def test_only_some_loops_leave_the_others_as_they_were(site: Path) -> None:
    run(site)
    some = run(site, TOMORROW, only="*/same")
    assert not some.news.gone and len(some.loops) == 1
    again = run(site, TOMORROW)
    assert again.run != some.run, "of two audits in one second both are kept"
    assert not again.news.added and not again.news.changed
    other = {one.name: one for one in again.loops}["units/other"]
    assert dict(other.since) == {("y", "u"): "2026-10-05T01-00-00Z"}


def test_a_row_that_is_not_whole_is_none(site: Path) -> None:
    audited = run(site)
    store, key = Store(site.parent / "out"), audited.loops[0].row.key
    assert store.read(key) == audited.loops[0].row
    place = store.folder / "loops" / f"{key}.json"
    place.write_text(place.read_text()[:50])
    assert store.read(key) is None and outcomes(run(site, TOMORROW)) == outcomes(audited)
