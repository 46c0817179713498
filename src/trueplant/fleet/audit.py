"""The audit of a site as one straight line: its loops, the work, the ranking, the page, the alarm."""

from __future__ import annotations

import io
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from fnmatch import fnmatchcase
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from trueplant.fleet.alarm import acknowledged, sound
from trueplant.fleet.cluster import on_cluster, on_this_machine
from trueplant.fleet.execute import Executor, Inline
from trueplant.fleet.jobs import Job, jobs_of
from trueplant.fleet.key import key_without_data
from trueplant.fleet.page import Shown, draw_reports, write_index
from trueplant.fleet.rank import News, Ranked, history, known_after, news, ranked, table
from trueplant.fleet.row import Finding, LoopRow, Outcome
from trueplant.fleet.site import Site, seconds_of
from trueplant.fleet.store import LAST, TABLE, Store, write_whole
from trueplant.fleet.worker import Task, standing
from trueplant.version import __version__

if TYPE_CHECKING:
    import polars as pl

Say = Callable[[str], None]


@dataclass(frozen=True)
class Options:
    """What is asked of one audit beyond its site file."""

    workers: int | None = None
    """0: one loop after the other in this process."""
    dask: str | None = None
    """Address of a cluster that is there already."""
    only: str | None = None
    """A pattern for the names of loops."""
    pages: bool = False
    """Is the report of every loop drawn, too?"""
    now: datetime | None = None


@dataclass(frozen=True)
class Audited:
    """What came of an audit."""

    run: Path
    """The folder run=<time>."""
    loops: list[Ranked]
    """Worst first."""
    news: News
    files: list[Path]
    notes: list[str]
    """What else there is to say, such as of an alarm."""

    @property
    def mismatch(self) -> bool:
        """Has the plant of any loop changed?"""
        return any(Finding.PLANT in one.row.findings for one in self.loops)


def audit(site: Site, out: Path, options: Options | None = None, say: Say = lambda what: None) -> Audited:
    """Audit every loop of a site into the folder `out`; loops whose rows stand there already are not computed again.

    Raises ProjectError for a site file whose loops cannot be listed, UsageError for a cluster that cannot be used, and
    OutputError where the folder cannot be written to. What is wrong with a loop is its row.
    """
    options = options or Options()
    began = (options.now or datetime.now(UTC)).astimezone(UTC)
    store = Store(out)
    store.clean()
    jobs = jobs_of(site, out, began, options.only)
    rows = _rows(site, store, jobs, options, say)
    say("ranking the loops")
    before, time = store.last(), _free(out, began)
    last = before
    if before is not None and options.only is not None:
        fits = [name for name in before["loop"].unique().to_list() if fnmatchcase(name, options.only)]
        last = before.filter(before["loop"].is_in(fits))
    since = history(rows, last, time)
    loops = ranked([Ranked(job.name, str(job.project), rows[job.name], since[job.name]) for job in jobs])
    run, new, known = out / f"run={time}", news(rows, last), acknowledged(site, loops, began.date())
    if options.pages:
        draw_reports(loops, store, say)
    found = table(site.name, loops)
    pages = write_index(Shown(site.name, time, loops, new, known), store, run, write_whole)
    write_whole(run / TABLE, _parquet(found))
    write_whole(out / LAST, _parquet(known_after(found, before, whole=options.only is None)))
    notes = sound(site, store, loops, known, time)
    return Audited(run, loops, new, [run / TABLE, *pages], notes)


def _free(out: Path, began: datetime) -> str:
    """The time that a run is called by; of two that began in one second each has a name of its own."""
    while (out / f"run={began:%Y-%m-%dT%H-%M-%SZ}" / TABLE).exists():
        began += timedelta(seconds=1)
    return f"{began:%Y-%m-%dT%H-%M-%SZ}"


def _parquet(table: pl.DataFrame) -> bytes:
    buffer = io.BytesIO()
    table.write_parquet(buffer)
    return buffer.getvalue()


def _rows(site: Site, store: Store, jobs: Sequence[Job], options: Options, say: Say) -> dict[str, LoopRow]:
    """The row of every job, by its name."""
    deadline = seconds_of(site.audit.deadline)
    rows: dict[str, LoopRow] = {}

    def lost(name: str, project: Path, outcome: Outcome, text: str) -> LoopRow:
        row = LoopRow(key_without_data(name, project), outcome, __version__, 0.0, None, deadline, text)
        store.write(row)
        return row

    def keep(name: str, row: LoopRow) -> None:
        rows[name] = row
        say(f"{len(rows)} of {len(jobs)} loops, the last {name}: {row.outcome}")

    tasks = []
    for job in jobs:
        task = Task(job.name, str(job.project.resolve()), str(store.folder.resolve()), site.audit.finds, deadline)
        if job.problem:
            keep(job.name, lost(job.name, job.project, Outcome.FAILED, job.problem))
        elif (row := _known(store, task)) is not None:
            keep(job.name, row)
        else:
            tasks.append(task)
    if not tasks:
        return rows
    say("starting the workers")
    with executor_of(site, options, len(tasks)) as executor:
        for task, key in executor.run(tasks):
            row = None if key is None else store.read(key)
            outcome = Outcome.KILLED if key is None else Outcome.FAILED
            keep(task.name, row or lost(task.name, Path(task.project), outcome, _NO_ROW[outcome]))
    return rows


_NO_ROW = {
    Outcome.KILLED: "the process that worked on it died, more than once: run it alone to see why (trueplant run)",
    Outcome.FAILED: "its row is not in the folder of this audit: do the workers share that folder?",
}


def _known(store: Store, task: Task) -> LoopRow | None:
    """The row of a loop that stands already."""
    key = standing(task) if store.used else None
    return None if key is None else store.read(key)


@contextmanager
def executor_of(site: Site, options: Options, tasks: int) -> Iterator[Executor]:
    """Who does the work, as the options say, or else the site; without either as many workers as there are cores.

    Raises UsageError where Dask is asked for and cannot be used.
    """
    workers = site.audit.workers if options.workers is None else options.workers
    if options.dask is not None or (site.cluster is not None and options.workers is None):
        with on_cluster(site, options.dask) as cluster:
            yield cluster
    elif workers == 0 or (workers is None and find_spec("distributed") is None):
        yield Inline()
    else:
        with on_this_machine(min(workers or os.cpu_count() or 1, tasks)) as cluster:
            yield cluster
