"""Who does the work: something that takes tasks and says which row of the store each came to."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Protocol

from trueplant.fleet.worker import Task, audit_loop


class Executor(Protocol):
    """Does the tasks in any order."""

    def run(self, tasks: Iterable[Task]) -> Iterator[tuple[Task, str | None]]:
        """Each task with the key of its row, as it is done; None where the process that worked on it died."""
        ...


class Inline:
    """One loop after the other, in this process: a loop that kills its process kills this one."""

    def run(self, tasks: Iterable[Task]) -> Iterator[tuple[Task, str | None]]:
        for task in tasks:
            yield task, audit_loop(task)
