"""The demo site has every fault in it, the same each time, and an audit of it is judged by what is true."""

from __future__ import annotations

from collections import Counter
from datetime import timedelta
from pathlib import Path

import polars as pl
import pytest

from trueplant.fleet import Site
from trueplant.fleet.demo import END, SITE, judge, write_site
from trueplant.fleet.demo.judge import lines
from trueplant.fleet.demo.site import TRUTH
from trueplant.fleet.demo.truth import FINDABLE, KINDS, WITHOUT, Fault, Truth, loops
from trueplant.fleet.jobs import jobs_of
from trueplant.fleet.rank import Ranked
from trueplant.fleet.row import ElementRow, Finding, LoopRow, Outcome
from trueplant.project import Project
from trueplant.result import ElementVerdict


def row(name: str, *findings: Finding, outcome: Outcome = Outcome.ANALYSED, open_: bool = False) -> Ranked:
    verdict = ElementVerdict.NOT_IDENTIFIABLE if open_ else ElementVerdict.UNCHANGED
    element = ElementRow("pv", "op", verdict, "A", 0.1, "loop", "", None, None)
    return Ranked(name, "", LoopRow("k", outcome, "0", 1.0, None, 60.0, elements=(element,), findings=findings))


def test_every_loop_is_accounted_for() -> None:
    faults = {
        "step": Fault.STEP, "drift": Fault.DRIFT, "valve": Fault.STICKING, "retuned": Fault.RETUNED,
        "well": Fault.NONE, "alarm": Fault.NONE, "thin": Fault.COMPRESSED, "bad": Fault.BAD, "still": Fault.STILL,
        "hands": Fault.MANUAL,
    }  # fmt: skip
    truths = [Truth(name, KINDS[0], fault, 0) for name, fault in faults.items()]
    ranking = [
        row("step", Finding.PLANT, Finding.CONTROLLER),
        row("alarm", Finding.PLANT),
        row("valve", Finding.PLANT),
        row("retuned", Finding.CONTROLLER),
        row("bad", outcome=Outcome.FAILED),
        row("still", outcome=Outcome.REFUSED),
        row("thin", open_=True),
        row("drift"),
        row("well"),
    ]
    found = judge(truths, ranking)
    said = {fault: dict(counts) for fault, counts in found.counts.items()}
    assert said == {
        Fault.STEP: {"found": 1}, Fault.STICKING: {"something else": 1}, Fault.RETUNED: {"found": 1},
        Fault.DRIFT: {"nothing found": 1}, Fault.NONE: {"nothing found": 1, "something else": 1},
        Fault.COMPRESSED: {"not identifiable": 1}, Fault.BAD: {"failed": 1}, Fault.STILL: {"refused": 1},
        Fault.MANUAL: {"no row": 1},
    }  # fmt: skip
    assert (found.false_alarms, found.missed, found.mistaken) == (("alarm",), ("drift",), ("valve",))
    assert found.false_share == pytest.approx(1 / 5)
    # step above all five, valve and retuned above all but one, drift above one
    assert found.auc == pytest.approx((5 + 4 + 4 + 1) / 20)
    assert "false alarms: 20.0 %" in "\n".join(lines(found))


@pytest.mark.parametrize(("per_kind", "number"), [(10, 60), (4, 24)])
def test_every_fault_is_there(per_kind: int, number: int) -> None:
    found = loops(per_kind)
    assert len({one.name for one in found}) == len({one.seed for one in found}) == number
    assert Counter(one.kind.name for one in found) == dict.fromkeys((kind.name for kind in KINDS), per_kind)
    there = {one.fault for one in found}
    assert set(FINDABLE) | {Fault.STILL, Fault.MANUAL} <= there and (per_kind < 10 or there == set(Fault))
    assert not set(FINDABLE) & set(WITHOUT)


def test_the_files_are_an_ordinary_site_and_the_same_each_time(tmp_path: Path) -> None:
    start = END - timedelta(days=2)
    for folder in ("one", "two"):
        write_site(tmp_path / folder, 10, start)
    files = {file.relative_to(tmp_path / "one") for file in (tmp_path / "one").rglob("*") if file.is_file()}
    assert all((tmp_path / "one" / file).read_bytes() == (tmp_path / "two" / file).read_bytes() for file in files)
    truth = dict(pl.read_csv(tmp_path / "one" / TRUTH).select("loop", "fault").rows())
    jobs = jobs_of(Site.load(tmp_path / "one" / SITE), tmp_path / "out")
    assert [job.problem for job in jobs] == [""] * 60 and {job.name for job in jobs} == truth.keys()
    assert Project.load(jobs[0].project).window == (start, END)
    events = pl.read_parquet(tmp_path / "one" / "lake" / "**" / "*.parquet")
    stored = {tag: number for tag, number in events.group_by("tag").len().rows() if tag.endswith(".PV")}
    bad = set(events.filter(pl.col("quality") == "bad")["tag"])
    assert {name for name, fault in truth.items() if f"{name}.PV" in bad} == {
        "FC106",
        "PC206",
        "LC306",
        "TC406",
        "TCC606",
    }
    assert stored["FC105.PV"] < 0.5 * stored["FC101.PV"]
    still = events.filter(pl.col("tag") == "FC110.SP")["value"]
    assert still.n_unique() == 1 and truth["FC110"] == Fault.STILL
