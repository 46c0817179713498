"""The page: worst first, what is new, nothing that a name could turn into markup, and a policy that holds."""

from __future__ import annotations

import base64
import hashlib
import html
import re
from pathlib import Path

import polars as pl
import pytest

from trueplant.fleet.page import BADGES, Shown, draw_reports, fresh, headline, render
from trueplant.fleet.rank import News, Ranked, history, known_after, news, ranked, table
from trueplant.fleet.row import ElementRow, Finding, LoopRow, Outcome
from trueplant.fleet.store import Store
from trueplant.result import ElementVerdict

NOW = "2026-10-05T01-00-00Z"


def row(
    verdict: ElementVerdict | None = ElementVerdict.UNCHANGED,
    importance: float | None = 0.1,
    outcome: Outcome = Outcome.ANALYSED,
    findings: tuple[Finding, ...] = (),
) -> LoopRow:
    elements = () if verdict is None else (ElementRow("y", "u", verdict, "A", importance, "loop", "", None, None),)
    if verdict == ElementVerdict.CHANGED:
        findings = (Finding.PLANT, *findings)
    return LoopRow("k", outcome, "0", 1.0, 100.0, 60.0, "what is <known>", elements=elements, findings=findings)


LOOPS = {
    "well": row(),
    "unknown": row(ElementVerdict.NOT_IDENTIFIABLE),
    "refused": row(None, outcome=Outcome.REFUSED),
    "failed": row(None, outcome=Outcome.FAILED),
    "sticks": row(findings=(Finding.VALVE,)),
    "little": row(ElementVerdict.CHANGED, 0.2),
    "much": row(ElementVerdict.CHANGED, 1.5),
    "unsaid": row(ElementVerdict.CHANGED, None),
}


def placed(rows: dict[str, LoopRow]) -> list[Ranked]:
    since = history(rows, None, NOW)
    return ranked([Ranked(name, f"{name}.toml", one, since[name]) for name, one in rows.items()])


def test_worst_first() -> None:
    order = ["much", "little", "unsaid", "sticks", "failed", "refused", "unknown", "well"]
    assert [one.name for one in placed(LOOPS)] == order
    assert table("Site", placed(LOOPS))["loop"].to_list() == order


def test_what_is_new() -> None:
    last = table("Site", placed({**LOOPS, "old": row()}))
    now = {**LOOPS, "well": row(ElementVerdict.CHANGED), "much": row(), "failed": row(), "added": row()}
    now["refused"] = row(None, outcome=Outcome.LATE)
    found = news(now, last)
    assert found.changed == (("well", "y", "u"),) and found.recovered == (("much", "y", "u"),)
    assert found.failed == ("refused",) and found.working == ("failed",)
    assert found.added == ("added",) and found.gone == ("old",)
    assert [title for title, _ in fresh(found)] == [
        "Newly changed", "Not changed any more", "Newly failed", "Working again", "New loops", "Loops that are gone"
    ]  # fmt: skip
    assert news(now, None).first and fresh(news(now, None)) == []


def test_since_is_kept_while_it_stays_changed() -> None:
    last = table("Site", placed(LOOPS))
    later = history(LOOPS, last, "2026-10-06T01-00-00Z")
    assert later["much"] == {("y", "u"): NOW}
    assert history({"much": row()}, last, "2026-10-06T01-00-00Z")["much"] == {}


def test_what_was_not_answered_stays_as_it_was() -> None:
    first = table("Site", placed({"much": row(ElementVerdict.CHANGED), "well": row(), "other": row()}))
    only = table("Site", placed({"well": row()}))
    after = known_after(only, first, whole=False)
    assert sorted(after["loop"]) == ["much", "other", "well"]
    assert sorted(known_after(only, first, whole=True)["loop"]) == ["well"]
    refused = {"much": row(None, outcome=Outcome.FAILED), "well": row(), "other": row()}
    later = "2026-10-07T01-00-00Z"
    kept = known_after(table("Site", placed(refused)), after, whole=True)
    again = refused | {"much": row(ElementVerdict.CHANGED)}
    assert history(again, kept, later)["much"] == {("y", "u"): NOW}
    found = news(again, kept)
    assert not found.changed and found.working == ("much",)
    gone = known_after(table("Site", placed(refused | {"much": row()})), kept, whole=True)
    assert history(again, gone, later)["much"] == {("y", "u"): later}


def page(loops: dict[str, LoopRow], tmp_path: Path, known: dict[str, str] | None = None) -> str:
    return render(Shown("A & B", NOW, placed(loops), News(first=True), known or {}), Store(tmp_path))


def test_names_are_no_markup(tmp_path: Path) -> None:
    text = page({"<img src=x onerror=alert(1)>\x1b[31m": row()}, tmp_path)
    assert "<img" not in text and "&lt;img src=x" in text and "\x1b" not in text
    assert "what is &lt;known&gt;" in text and "A &amp; B" in text


def test_the_policy_names_the_script_that_is_there(tmp_path: Path) -> None:
    text = page(LOOPS, tmp_path)
    (script,) = re.findall(r"<script>(.*?)</script>", text, re.DOTALL)
    sum_of = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    assert f"script-src 'sha256-{sum_of}'" in html.unescape(text) and "default-src 'none'" in text
    assert not re.search(r'(src|href)="https?:', text)


def test_every_verdict_has_a_mark_of_its_own_where_colours_are_alike(tmp_path: Path) -> None:
    text = page(LOOPS, tmp_path, {"much": "2026-11-01"})
    assert "known until 2026-11-01" in text
    assert text.count('data-kind="') == len(LOOPS)
    marks = {str(kind): badge for kind, badge in BADGES.items()}
    for name in LOOPS:
        assert f">{name}<" in text
    changed = [mark for kind, (_, mark) in marks.items() if kind in set(Finding)]
    assert len(set(changed)) == len(changed)


def test_the_headline_counts() -> None:
    assert headline(placed(LOOPS)) == "of 8 loops 3 with a changed plant, 1 with a sticking valve"
    assert headline(placed({"well": row()})) == "no finding in 1 loop"


def test_reports_are_drawn_for_what_has_a_result(site: Path, tmp_path: Path) -> None:
    from trueplant.fleet import Options, Site, audit

    out = tmp_path / "out"
    plain = audit(Site.load(site), out, Options(workers=0))
    key = plain.loops[0].row.key
    assert f"trueplant report results/{key}" in (out / "index.html").read_text()
    drawn = audit(Site.load(site), out, Options(workers=0, pages=True))
    assert f'href="results/{key}/report.html"' in (out / "index.html").read_text()
    assert f'href="../results/{key}/report.html"' in (drawn.run / "index.html").read_text()
    assert (out / "results" / key / "report.html").is_file()
    (out / "results" / key / "result.json").write_text("{")
    draw_reports(drawn.loops, Store(out), lambda what: None)  # a result that was damaged is left out


def test_the_table_can_be_read_by_others(tmp_path: Path) -> None:
    table("Site", placed(LOOPS)).write_parquet(tmp_path / "audit.parquet")
    found = pl.scan_parquet(tmp_path / "audit.parquet").filter(pl.col("verdict") == "changed").collect()
    assert sorted(found["loop"]) == ["little", "much", "unsaid"]


@pytest.mark.parametrize("name", list(LOOPS))
def test_every_loop_has_a_verdict(name: str) -> None:
    assert Ranked(name, "", LOOPS[name]).verdict in {str(kind) for kind in BADGES}
