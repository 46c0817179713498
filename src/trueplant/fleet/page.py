"""The page of an audit: worst first, what is new, what failed; one file that needs no network."""

from __future__ import annotations

import base64
import hashlib
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

from trueplant.errors import TrueplantError
from trueplant.fleet import levels
from trueplant.fleet.rank import News, Ranked
from trueplant.fleet.row import FAILURES, Finding, Outcome
from trueplant.fleet.store import RESULTS, Store
from trueplant.output import REPORT, read_results, write_page
from trueplant.printable import printable
from trueplant.result import ElementVerdict
from trueplant.result.numbers import counted, number
from trueplant.version import __version__

BADGES = {
    Finding.PLANT: ("changed", "▲"),
    Finding.VALVE: ("changed", "◆"),
    Finding.END: ("changed", "◇"),
    Finding.CONTROLLER: ("changed", "■"),
    ElementVerdict.UNCHANGED: ("unchanged", "●"),
    ElementVerdict.FOUND: ("found", "+"),
    ElementVerdict.NONE_FOUND: ("absent", "–"),
    ElementVerdict.NOT_IDENTIFIABLE: ("unknown", "?"),
    Outcome.REFUSED: ("unknown", "?"),
    Outcome.FAILED: ("absent", "✕"),
    Outcome.LATE: ("absent", "✕"),
    Outcome.KILLED: ("absent", "✕"),
}
"""Colour and mark of each verdict of a loop: the mark tells them apart without any colour."""


@dataclass(frozen=True)
class Shown:
    """What a page is made of."""

    site: str
    time: str
    """Of the audit, as in the name of its folder."""
    loops: Sequence[Ranked]
    """Worst first."""
    news: News
    known: Mapping[str, str]
    """Until when findings of a loop are acknowledged, by its name."""


def render(shown: Shown, store: Store, up: str = "") -> str:
    """The page as HTML text. `up` leads from where it lies to the folder of the audits, as in ``../``."""
    from markupsafe import Markup

    from trueplant.report.frame import Book, frame
    from trueplant.report.page import environment

    room = files("trueplant.fleet")
    script = room.joinpath("index.js").read_text(encoding="utf-8")
    rows = [_row(one, shown, store, up) for one in shown.loops]
    counts = Counter(row["kind"] for row in rows)
    grades = Counter(element.grade for one in shown.loops for element in one.row.elements if element.grade)
    most = max(counts.values(), default=1)
    page = frame(Book()) | {
        "script": Markup(script),
        "script_hash": f"'sha256-{base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()}'",
        "own_style": Markup(room.joinpath("index.css").read_text(encoding="utf-8")),
    }
    template = environment("trueplant.fleet", "trueplant.report").get_template("index.html.j2")
    text = template.render(
        site=shown.site,
        headline=headline(shown.loops),
        when=spoken(shown.time),
        changed=any(one.row.findings for one in shown.loops),
        tally=[(kind, n, round(100 * n / most)) for kind, n in counts.items()],
        grades=sorted(grades.items()),
        badges={str(kind): badge for kind, badge in BADGES.items()},
        first=shown.news.first,
        fresh=fresh(shown.news),
        rows=rows,
        failed=[row for row in rows if row["failed"]],
        most=levels.SHOWN_NEW,
        version=__version__,
        **page,
    )
    return f"{text}\n"


def headline(loops: Sequence[Ranked]) -> str:
    """How many loops have which finding."""
    findings = Counter(finding for one in loops for finding in one.row.findings)
    said = [f"{n} with {_WORDS[finding]}" for finding in Finding if (n := findings[finding])]
    return (
        f"of {counted(len(loops), 'loop')} {', '.join(said)}"
        if said
        else f"no finding in {counted(len(loops), 'loop')}"
    )


_WORDS = {
    Finding.PLANT: "a changed plant",
    Finding.VALVE: "a sticking valve",
    Finding.END: "a valve at its end",
    Finding.CONTROLLER: "another controller than declared",
}


def fresh(news: News) -> list[tuple[str, list[str]]]:
    """What is new, by what it is; nothing of it for a first audit."""
    if news.first:
        return []
    told = [
        ("Newly changed", [f"{loop}: {one} → {output}" for loop, output, one in news.changed]),
        ("Not changed any more", [f"{loop}: {one} → {output}" for loop, output, one in news.recovered]),
        ("Newly failed", list(news.failed)),
        ("Working again", list(news.working)),
        ("New loops", list(news.added)),
        ("Loops that are gone", list(news.gone)),
    ]
    return [(title, names) for title, names in told if names]


def spoken(time: str) -> str:
    """``2026-10-05T01-00-00Z`` as ``2026-10-05 01:00 UTC``."""
    day, _, clock = time.partition("T")
    return f"{day} {clock[:5].replace('-', ':')} UTC"


def _row(one: Ranked, shown: Shown, store: Store, up: str) -> dict[str, Any]:
    grades = dict.fromkeys(element.grade for element in one.row.elements if element.grade)
    results = store.results(one.row.key)
    link = f"{up}{RESULTS}/{one.row.key}/{REPORT}" if (results / REPORT).is_file() else ""
    there = bool(link) or not results.is_dir()
    return {
        "name": printable(one.name),
        "kind": one.verdict,
        "importance": number(one.importance, 2) if Finding.PLANT in one.row.findings else "",
        "grade": ", ".join(sorted(grades)),
        "since": spoken(min(one.since.values()))[:10] if one.since else "",
        "action": "" if one.row.action == "none" else one.row.action,
        "text": printable(one.row.text).replace("->", "→"),
        "used": one.row.used,
        "known": f"known until {shown.known[one.name]}" if one.name in shown.known else "",
        "failed": one.row.outcome in FAILURES,
        "link": link,
        "command": "" if there else f"trueplant report {RESULTS}/{one.row.key}",
    }


def draw_reports(loops: Sequence[Ranked], store: Store, say: Callable[[str], None]) -> None:
    """The report of every loop that has a result and none yet; one that cannot be drawn is left out."""
    from trueplant.report import render as report

    for one in loops:
        folder = store.results(one.row.key)
        if (folder / "result.json").is_file() and not (folder / REPORT).is_file():
            say(f"drawing the report of {one.name}")
            try:
                write_page(folder, REPORT, report(read_results(folder)))
            except TrueplantError:
                continue


def write_index(shown: Shown, store: Store, run: Path, write: Callable[[Path, bytes], None]) -> list[Path]:
    """The page in the folder of its audit, and the same in the folder of all audits, where a bookmark leads to."""
    places = {run / "index.html": "../", store.folder / "index.html": ""}
    for place, up in places.items():
        write(place, render(shown, store, up).encode("utf-8"))
    return list(places)
