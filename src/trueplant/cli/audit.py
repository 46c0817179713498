"""The command ``audit``."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from datetime import timedelta
from pathlib import Path

from trueplant.cli import levels
from trueplant.cli.analyse import MISMATCH, saying
from trueplant.cli.layout import blocks, console, say_lines, text
from trueplant.fleet import Audited, Options, Site
from trueplant.fleet import audit as audit_site
from trueplant.fleet.page import fresh
from trueplant.output import prepare_output
from trueplant.result.numbers import counted


@dataclass(frozen=True)
class Asked:
    """The options of the command."""

    workers: int | None
    dask: str | None
    only: str | None
    pages: bool
    fail_on_mismatch: bool


def audit(path: Path, out: Path | None, asked: Asked) -> int:
    """Audit a site, and say what came out."""
    site = Site.load(path)
    folder = prepare_output(out or Path(f"{path.stem}-audit"))
    with saying() as say:
        found = audit_site(site, folder, Options(asked.workers, asked.dask, asked.only, asked.pages), say)
    show(found)
    return MISMATCH if asked.fail_on_mismatch and found.mismatch else 0


def demo_site(out: Path | None, workers: int, small: bool) -> int:
    """Simulate the demo site, audit it, and say how that compares with what is wrong with its loops."""
    from trueplant.fleet.demo import END, SITE, START, judge, write_site
    from trueplant.fleet.demo.judge import lines

    folder = prepare_output(out or Path("demo-site"))
    with saying() as say:
        per_kind, start = (levels.SMALL, END - timedelta(days=levels.SMALL_DAYS)) if small else (levels.WHOLE, START)
        truths = write_site(folder, per_kind, start, say)
        found = audit_site(Site.load(folder / SITE), folder / "audit", Options(workers=workers), say)
    show(found)
    say_lines("", "beside what is wrong with each loop (truth.csv):", *lines(judge(truths, found.loops)))
    return 0


def show(found: Audited) -> None:
    """How many loops came to what, the worst of them, what is new, and where the files are."""
    out = console()
    counts = Counter(one.verdict for one in found.loops)
    said = ", ".join(f"{number} {verdict}" for verdict, number in counts.most_common())
    out.print(text(f"{counted(len(found.loops), 'loop')}: {said}", style="bold"))
    worst = [one for one in found.loops if one.row.findings][: levels.WORST]
    rows = [[text(one.name), text(one.verdict), text(one.row.text)] for one in worst]
    for line in blocks(("loop", "verdict", ""), [(None, rows)], (), out.width) if rows else ():
        out.print(line)
    hidden = sum(bool(one.row.findings) for one in found.loops) - len(worst)
    if hidden:
        out.print(text(f"and {hidden} more with findings"))
    for title, names in fresh(found.news):
        more = f" and {len(names) - levels.WORST} more" if len(names) > levels.WORST else ""
        out.print(text(f"{title.lower()}: {', '.join(names[: levels.WORST])}{more}"))
    for note in found.notes:
        out.print(text(f"note: {note}"))
    say_lines(*found.files)
