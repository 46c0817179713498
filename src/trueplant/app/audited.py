"""A saved audit of a site, read again from its table: its loops, worst first."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from trueplant.app.folder import Folder, Outside
from trueplant.app.saved import files_named
from trueplant.errors import UsageError
from trueplant.fleet.page import BADGES, headline, spoken
from trueplant.fleet.rank import COLUMNS, Ranked
from trueplant.fleet.row import FAILURES, ElementRow, Finding, LoopRow, Outcome
from trueplant.fleet.store import RESULTS, TABLE
from trueplant.output import RESULT
from trueplant.report.numbers import number
from trueplant.result import ElementVerdict

if TYPE_CHECKING:
    import polars as pl


@dataclass(frozen=True)
class Audit:
    """One audit: ``run=<time>`` in the folder of a site's audits."""

    name: str
    """Of its folder, relative to the one that was opened."""
    site: str
    when: str


@dataclass(frozen=True)
class LoopLine:
    """One loop as the page shows it."""

    name: str
    kind: str
    badge: tuple[str, str]
    matters: str
    grade: str
    since: str
    action: str
    text: str
    used: str
    project: str
    """Its file in the folder that was opened; empty where it lies elsewhere."""
    result: str
    """Folder of its result, likewise."""


def audits(folder: Folder) -> list[Audit]:
    """Those in the folder, the newest first."""
    found = [place.parent for place in files_named(folder, TABLE)]
    return sorted((_audit(folder, run) for run in found), key=lambda one: (one.when, one.name), reverse=True)


def _audit(folder: Folder, run: Path) -> Audit:
    time = run.name.removeprefix("run=")
    return Audit(folder.name(run), folder.name(run.parent), spoken(time) if run.name.startswith("run=") else run.name)


def audit_loops(folder: Folder, name: str) -> tuple[str, list[LoopLine]]:
    """What the audit says in a sentence, and its loops in their order.

    Raises Outside where there is none of that name, and UsageError for a table that is not of this version.
    """
    run = folder.path(name)
    if not (run / TABLE).is_file():
        raise Outside(f"there is no audit in {name}")
    frame = _table(run / TABLE)
    rows: dict[str, list[dict[str, Any]]] = {}
    for row in frame.sort("rank", maintain_order=True).to_dicts():
        rows.setdefault(row["loop"], []).append(row)
    loops = [_ranked(of) for of in rows.values()]
    return headline(loops), [_line(folder, run, one) for one in loops]


def _table(place: Path) -> pl.DataFrame:
    import polars as pl

    try:
        frame = pl.read_parquet(place, hive_partitioning=False)
    except (OSError, pl.exceptions.PolarsError) as error:
        raise UsageError(f"{place} cannot be read ({error}): audit the site again") from None
    if missing := [column for column in COLUMNS if column not in frame.columns]:
        raise UsageError(f"{place} is no audit of this version (it has no {', '.join(missing)}): audit the site again")
    return frame


def _ranked(rows: list[dict[str, Any]]) -> Ranked:
    """A loop from its rows, one an element."""
    first = rows[0]
    named = [row for row in rows if row["verdict"] is not None]
    row = LoopRow(
        key=first["key"],
        outcome=Outcome(first["status"]),
        version=first["version"],
        cpu_s=first["cpu_s"] or 0.0,
        memory_mb=first["memory_mb"],
        deadline_s=0.0,
        text=first["text"] or first["error"] or "",
        action=first["action"] or "",
        elements=tuple(_element(one) for one in named),
        findings=tuple(Finding(one) for one in (first["findings"] or "").split(", ") if one),
        used=first["used"] or "",
    )
    since: Mapping[tuple[str, str], str] = {
        (one["output"], one["input"]): one["since"] for one in named if one["since"]
    }
    return Ranked(first["loop"], first["project"] or "", row, since)


def _element(row: dict[str, Any]) -> ElementRow:
    return ElementRow(
        output=row["output"],
        input=row["input"],
        verdict=ElementVerdict(row["verdict"]),
        grade=row["grade"] or "",
        importance=row["importance"],
        basis=row["basis"] or "",
        change=row["change"] or "",
        p_adjusted=row["p_adjusted"],
        detectable_change=row["detectable_change"],
    )


def _line(folder: Folder, run: Path, one: Ranked) -> LoopLine:
    results = run.parent / RESULTS / one.row.key
    grades = sorted({element.grade for element in one.row.elements if element.grade})
    badges = {str(kind): badge for kind, badge in BADGES.items()}
    return LoopLine(
        name=one.name,
        kind=one.verdict,
        badge=badges.get(one.verdict, ("absent", "–")),
        matters=number(one.importance, 2) if Finding.PLANT in one.row.findings else "",
        grade=", ".join(grades),
        since=spoken(min(one.since.values()))[:10] if one.since else "",
        action="" if one.row.action == "none" else one.row.action,
        text=one.row.text,
        used=one.row.used,
        project="" if one.row.outcome in FAILURES and not one.project else _inside(folder, run, one.project),
        result=folder.name(results) if (results / RESULT).is_file() else "",
    )


def _inside(folder: Folder, run: Path, project: str) -> str:
    """The project file relative to the folder; an audit names it from where it was called."""
    for start in (folder.root, run.parent, run.parent.parent):
        place = (start / project).resolve()
        if place.is_relative_to(folder.root) and place.is_file() and place.suffix == ".toml":
            return folder.name(place)
    return ""
