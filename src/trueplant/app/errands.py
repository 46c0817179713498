"""Tracks and bundles that run beside the app, each in a process that can be killed."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Literal

from starlette.requests import Request

from trueplant.app.folder import ProjectFile
from trueplant.app.process import Process
from trueplant.errors import UsageError

Kind = Literal["track", "bundle"]
OUT = {"track": "-track", "bundle": "-bundle.zip"}
"""What the command line calls them, put after the project's name."""


@dataclass(eq=False)
class Errand:
    """One, and what came of it."""

    kind: Kind
    project: str
    out: str
    """Beside the project."""
    state: str = "running"
    """running, done, failed or cancelled."""
    stage: str = "loading the program"
    answer: dict[str, Any] = field(default_factory=dict)
    error: str = ""
    begun: float = field(default_factory=time.time)
    ended: float | None = None
    process: Process | None = None

    def told(self, plain: Callable[[str], str]) -> dict[str, Any]:
        """As JSON; `plain` takes this machine's folders out of messages."""
        return {
            "kind": self.kind,
            "state": self.state,
            "stage": self.stage,
            "seconds": round((self.ended or time.time()) - self.begun, 1),
            "error": plain(self.error),
            **self.answer,
        }

    def end(self, state: str, error: str = "") -> None:
        """The first end counts."""
        if self.state == "running":
            self.state, self.error, self.ended = state, error, time.time()


class Errands:
    """The last errand of each kind of each project; one of a kind runs at a time."""

    def __init__(self) -> None:
        self._last: dict[tuple[Kind, str], Errand] = {}
        self._lock = threading.Lock()

    def start(self, kind: Kind, project: ProjectFile, **asked: Any) -> Errand:
        """Raises UsageError where one of the kind runs already."""
        with self._lock:
            running = self.of(kind, project)
            if running is not None and running.state == "running":
                raise UsageError(f"the {kind} of {project.name} is being made already: wait for it, or cancel it")
            errand = Errand(kind, project.name, f"{project.path.stem}{OUT[kind]}")
            self._last[kind, project.name] = errand
            errand.process = process = Process("trueplant.app.errand_worker")
        process.listen(lambda said: _heard(errand, said))
        task = {"kind": kind, "folder": str(project.path.parent), "project": project.path.name, "out": errand.out}
        with contextlib.suppress(OSError):  # it has died: its end is heard
            process.tell(task | asked)
        return errand

    def of(self, kind: Kind, project: ProjectFile) -> Errand | None:
        """The last one."""
        return self._last.get((kind, project.name))

    def cancel(self, kind: Kind, project: ProjectFile) -> None:
        """Kill it; what was there stays as it was."""
        errand = self.of(kind, project)
        if errand is not None and errand.state == "running":
            errand.end("cancelled")
            if errand.process is not None:
                errand.process.kill()


def errands_of(request: Request) -> Errands:
    """Those of this app. Their processes end with it, since their input is then closed."""
    state = request.app.state
    if not hasattr(state, "errands"):
        state.errands = Errands()
    errands: Errands = state.errands
    return errands


def _heard(errand: Errand, said: dict[str, Any] | None) -> None:
    if said is None:
        errand.end(
            "failed", "its process was ended from outside, perhaps because memory ran out: try again with less data"
        )
    elif "stage" in said:
        errand.stage = said["stage"]
    elif "done" in said:
        errand.answer = said["done"]
        errand.end("done")
    elif "failed" in said:
        errand.end("failed", said["failed"])
