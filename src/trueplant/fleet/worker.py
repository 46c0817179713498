"""The audit of one loop, in whatever process it runs: from its project to its row in the store."""

from __future__ import annotations

import contextlib
import os
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from trueplant.connect import ensure
from trueplant.connect.fetching import Wanted
from trueplant.connect.snapshot import Snapshot
from trueplant.errors import Refused, TrueplantError
from trueplant.fleet import levels
from trueplant.fleet.deadline import PastDeadline, limited
from trueplant.fleet.key import key_of, key_without_data
from trueplant.fleet.row import LoopRow, Outcome, elements_of, findings_of
from trueplant.fleet.store import Store
from trueplant.output import write_results
from trueplant.project import Project
from trueplant.project.exclusions import all_but_usable
from trueplant.result import Check, Result, Status
from trueplant.version import __version__


@dataclass(frozen=True)
class Task:
    """What goes to a worker: names and numbers, never data."""

    name: str
    project: str
    out: str
    finds: bool
    deadline: float
    """Seconds."""
    version: str = __version__

    @property
    def key(self) -> str:
        """Of a row that is written before the data were read."""
        return key_without_data(self.name, Path(self.project))


@dataclass
class _Clock:
    """What a loop takes of the process."""

    cpu: float = field(default_factory=time.process_time)

    def __post_init__(self) -> None:
        with contextlib.suppress(OSError):  # Linux alone counts the peak anew
            Path("/proc/self/clear_refs").write_text("5")

    def used(self) -> dict[str, Any]:
        return {"cpu_s": round(time.process_time() - self.cpu, 3), "memory_mb": _peak()}


def _peak() -> float | None:
    try:
        status = Path("/proc/self/status").read_text()
        kilobytes = next(line.split()[1] for line in status.splitlines() if line.startswith("VmHWM"))
        return round(int(kilobytes) / 1024, 1)
    except (OSError, StopIteration):
        try:
            import resource
        except ImportError:
            return None
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        return round(peak / (1024**2 if sys.platform == "darwin" else 1024), 1)


def audit_loop(task: Task, may_end: bool = False) -> str:
    """Put the row of a loop into the store, unless it stands there already; its key.

    Whatever goes wrong with the loop is its row. `may_end`: this process may end itself where the loop does not even
    listen to its deadline; the row is written before that. Raises OutputError where the store cannot be written to.
    """
    store, clock = Store(Path(task.out)), _Clock()
    own = _Row(task, task.key, clock)
    earlier = store.read(own.key)
    if earlier is not None and earlier.outcome == Outcome.LATE and earlier.stands(task.deadline):
        return own.key
    if task.version != __version__:
        text = f"the worker runs trueplant {__version__} and the audit {task.version}: install the same on both"
        row: LoopRow | None = own.failed(text)
    else:
        try:
            with limited(task.deadline, _ending(store, own) if may_end else None):
                row = _audited(task, store, own)
        except PastDeadline:
            row = own.late()
        except TrueplantError as error:
            row = own.refused(str(error)) if isinstance(error, Refused) else own.failed(str(error))
        except Exception as error:  # one loop is never the end of an audit
            row = own.failed(f"internal error ({type(error).__name__}: {error}); trueplant run shows where")
    if row is not None:
        store.write(row)
    return own.key


def standing(task: Task) -> str | None:
    """The key of a loop whose row need not be computed, as far as that can be told without a historian."""
    store = Store(Path(task.out))
    try:
        project = Project.load(task.project)
        if not _at_hand(project):
            return None
        keys = (task.key, key_of(project, task.finds))
    except Exception:  # the worker finds it again, and makes a row of it
        return None
    return next((key for key in keys if (row := store.read(key)) is not None and row.stands(task.deadline)), None)


def _at_hand(project: Project) -> bool:
    """Are its data there, so that no historian would be asked?"""
    if project.data.source is None:
        return True
    return Snapshot(project.folder / project.snapshot).holds(Wanted.of(project).query)


@dataclass
class _Row:
    """The row of a loop as it comes to be; its key is known once its data are."""

    task: Task
    key: str
    clock: _Clock

    def made(self, outcome: Outcome, **said: Any) -> LoopRow:
        used = self.clock.used() | {"version": __version__, "deadline_s": self.task.deadline}
        return LoopRow(key=self.key, outcome=outcome, **used, **said)

    def failed(self, text: str) -> LoopRow:
        return self.made(Outcome.FAILED, text=text)

    def refused(self, text: str) -> LoopRow:
        return self.made(Outcome.REFUSED, text=text)

    def late(self) -> LoopRow:
        text = f"not done after {self.task.deadline:g} s: raise audit.deadline, or give it less data"
        return self.made(Outcome.LATE, text=text)


def _ending(store: Store, own: _Row) -> Callable[[], None]:
    def end() -> None:
        store.write(own.late())  # by the key that is known so far: the next worker looks there before it begins
        os._exit(levels.DIED)

    return end


def _audited(task: Task, store: Store, own: _Row) -> LoopRow | None:
    """The row of a loop; None where the store has it."""
    project = Project.load(task.project)
    ensure(project)
    own.key = key_of(project, task.finds)
    known = store.read(own.key)
    if known is not None and known.stands(task.deadline):
        return None
    from trueplant.study.pipeline import analyse

    used = ""
    if task.finds:
        from trueplant.tracking.find import find

        found = find(project)
        if found.status == Status.REFUSED:
            codes = tuple(str(reason.code) for reason in found.reasons)
            return own.made(Outcome.REFUSED, text=found.reasons[0].message, codes=codes, action="get data")
        entries = all_but_usable(project, found)
        project = project.with_exclusions(entries) if entries else project
        used = _used(found)
    result = analyse(project)
    write_results(result, project, store.results(own.key))
    return _analysed(own, result, used)


def _analysed(own: _Row, result: Result, used: str) -> LoopRow:
    refused = result.status == Status.REFUSED
    return own.made(
        Outcome.REFUSED if refused else Outcome.ANALYSED,
        text=result.headline,
        action=str(result.action),
        elements=elements_of(result),
        findings=findings_of(result),
        codes=tuple(dict.fromkeys(str(reason.code) for reason in (*result.reasons, *result.notes))),
        used=used,
    )


def _used(found: Check) -> str:
    """Which share of the record was analysed, in words."""
    usable = found.usable or ()
    whole = sum(one.span[1] - one.span[0] for one in found.data)
    part = sum(one.end - one.start for one in usable)
    moves = sum(one.moves for one in usable)
    return f"{len(usable)} stretches with {moves} moves, {100 * part / max(whole, 1e-300):.2g} % of the record"
