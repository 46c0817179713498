"""The table of an audit: a row an element, worst first, beside what the audit before it said."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from trueplant.fleet.row import FAILURES, ElementRow, Finding, LoopRow, Outcome
from trueplant.result import ElementVerdict

if TYPE_CHECKING:
    import polars as pl

COLUMNS = {
    "rank": "Int64",
    "site": "String",
    "loop": "String",
    "output": "String",
    "input": "String",
    "status": "String",
    "verdict": "String",
    "grade": "String",
    "importance": "Float64",
    "basis": "String",
    "change": "String",
    "p_adjusted": "Float64",
    "detectable_change": "Float64",
    "since": "String",
    "findings": "String",
    "action": "String",
    "text": "String",
    "codes": "String",
    "used": "String",
    "error": "String",
    "cpu_s": "Float64",
    "memory_mb": "Float64",
    "key": "String",
    "project": "String",
    "version": "String",
}
"""The columns of audit.parquet and their types in polars; docs/audits.md says what each holds."""


@dataclass(frozen=True)
class Ranked:
    """A loop in its place."""

    name: str
    project: str
    row: LoopRow
    since: Mapping[tuple[str, str], str] = field(default_factory=dict)
    """Time of the first audit that found an element (output, input) changed, and none since that did not."""

    @property
    def verdict(self) -> str:
        """Of the loop as a whole, in a word or two."""
        if self.row.findings:
            return str(self.row.findings[0])
        if self.row.outcome != Outcome.ANALYSED:
            return str(self.row.outcome)
        verdicts = {one.verdict for one in self.row.elements}
        order = (ElementVerdict.UNCHANGED, ElementVerdict.FOUND, ElementVerdict.NOT_IDENTIFIABLE)
        return str(next((one for one in order if one in verdicts), ElementVerdict.NONE_FOUND))

    @property
    def importance(self) -> float:
        """Of the changed element that matters most; 0 where none is changed or known to."""
        changed = [one for one in self.row.elements if one.verdict == ElementVerdict.CHANGED]
        return max((one.importance or 0.0 for one in changed), default=0.0)

    @property
    def place(self) -> tuple[int, float, str]:
        """To sort by: what is wrong by how much it matters, what could not be said, what is well."""
        return _tier(self.row), -self.importance, self.name


def _tier(row: LoopRow) -> int:
    """What has changed and matters comes first, and an unchanged plant last."""
    if Finding.PLANT in row.findings:
        return 0
    if row.findings:
        return 1
    if row.outcome in FAILURES:
        return 2
    if row.outcome == Outcome.REFUSED:
        return 3
    answered = any(one.verdict != ElementVerdict.NOT_IDENTIFIABLE for one in row.elements)
    return 5 if answered else 4


def ranked(loops: Sequence[Ranked]) -> list[Ranked]:
    """Worst first."""
    return sorted(loops, key=lambda one: one.place)


def table(site: str, loops: Sequence[Ranked]) -> pl.DataFrame:
    """audit.parquet: a row an element in the order of the ranking; a loop without any element has one row too."""
    import polars as pl

    rows = [_cells(site, k, one, element) for k, one in enumerate(loops, 1) for element in one.row.elements or [None]]
    schema = {name: getattr(pl, kind) for name, kind in COLUMNS.items()}
    return pl.DataFrame(rows, schema=schema, orient="row")


def _cells(site: str, rank: int, loop: Ranked, element: ElementRow | None) -> list[Any]:
    row = loop.row
    known: dict[str, Any] = {
        "rank": rank,
        "site": site,
        "loop": loop.name,
        "status": str(row.outcome),
        "findings": ", ".join(row.findings),
        "action": row.action,
        "text": row.text if row.outcome not in FAILURES else "",
        "codes": ", ".join(row.codes),
        "used": row.used,
        "error": row.text if row.outcome in FAILURES else "",
        "cpu_s": row.cpu_s,
        "memory_mb": row.memory_mb,
        "key": row.key,
        "project": loop.project,
        "version": row.version,
    }
    if element is not None:
        known |= {
            "output": element.output,
            "input": element.input,
            "verdict": str(element.verdict),
            "grade": element.grade,
            "importance": element.importance if _finite(element.importance) else None,
            "basis": element.basis,
            "change": element.change,
            "p_adjusted": element.p_adjusted if _finite(element.p_adjusted) else None,
            "detectable_change": element.detectable_change if _finite(element.detectable_change) else None,
            "since": loop.since.get((element.output, element.input)),
        }
    return [known.get(name) for name in COLUMNS]


def _finite(value: float | None) -> bool:
    return value is not None and math.isfinite(value)


@dataclass(frozen=True)
class News:
    """What is not as the audit before it said."""

    changed: tuple[tuple[str, str, str], ...] = ()
    """(loop, output, input) of each element that is changed now."""
    recovered: tuple[tuple[str, str, str], ...] = ()
    """... of each that is not any more."""
    failed: tuple[str, ...] = ()
    """Loops that failed now."""
    working: tuple[str, ...] = ()
    """Loops that do not fail any more."""
    added: tuple[str, ...] = ()
    gone: tuple[str, ...] = ()
    first: bool = False
    """Is there no audit before it?"""


def history(rows: Mapping[str, LoopRow], last: pl.DataFrame | None, now: str) -> Mapping[str, dict[Any, str]]:
    """Since when each changed element is, by loop and (output, input)."""
    before = {} if last is None else {(r["loop"], r["output"], r["input"]): r["since"] or now for r in _changed(last)}
    return {
        name: {
            (one.output, one.input): before.get((name, one.output, one.input), now)
            for one in row.elements
            if one.verdict == ElementVerdict.CHANGED
        }
        for name, row in rows.items()
    }


def news(rows: Mapping[str, LoopRow], last: pl.DataFrame | None) -> News:
    """What differs from the last audit; a loop that was not in it is new, and what is wrong with it is, too."""
    changed = {
        (name, one.output, one.input)
        for name, row in rows.items()
        for one in row.elements
        if one.verdict == ElementVerdict.CHANGED
    }
    failed = {name for name, row in rows.items() if row.outcome in FAILURES}
    if last is None:
        return News(tuple(sorted(changed)), failed=tuple(sorted(failed)), first=True)
    known = set(last["loop"].to_list())
    was_changed = {(r["loop"], r["output"], r["input"]) for r in _changed(last)}
    was_failed = {r["loop"] for r in last.to_dicts() if r["status"] in FAILURES}
    answered = {(name, one.output, one.input) for name, row in rows.items() for one in row.elements}
    return News(
        changed=tuple(sorted(changed - was_changed)),
        recovered=tuple(sorted((was_changed - changed) & answered)),
        failed=tuple(sorted(failed - was_failed)),
        working=tuple(sorted((was_failed - failed) & set(rows))),
        added=tuple(sorted(set(rows) - known)),
        gone=tuple(sorted(known - set(rows))),
    )


def known_after(now: pl.DataFrame, last: pl.DataFrame | None, whole: bool) -> pl.DataFrame:
    """What the next audit is compared with: the table of this one, and what it left open of the last.

    A loop that was not looked at (`whole` is False with --only) stays as it was; an element that was changed stays so
    through audits that could not answer for it.
    """
    import polars as pl

    if last is None or list(last.columns) != list(now.columns):
        return now
    there = pl.col("loop").is_in(now["loop"].unique().to_list())
    said = now.filter(pl.col("verdict").is_not_null() & (pl.col("verdict") != str(ElementVerdict.NOT_IDENTIFIABLE)))
    open_ = last.filter(there & (pl.col("verdict") == str(ElementVerdict.CHANGED)))
    open_ = open_.join(said, on=["loop", "output", "input"], how="anti")
    analysed = now.filter(pl.col("status") == str(Outcome.ANALYSED))["loop"].unique().to_list()
    named = now.select("loop", "output", "input").unique()
    open_ = pl.concat(
        [
            open_.filter(~pl.col("loop").is_in(analysed)),
            open_.filter(pl.col("loop").is_in(analysed)).join(named, on=["loop", "output", "input"], how="semi"),
        ]
    )
    return pl.concat([now, open_, *([] if whole else [last.filter(~there)])])


def _changed(last: pl.DataFrame) -> list[dict[str, Any]]:
    return [row for row in last.to_dicts() if row["verdict"] == ElementVerdict.CHANGED]
