"""Analyses that run beside the app, each in a process of its own that can be killed; the next one is kept warm."""

from __future__ import annotations

import asyncio
import contextlib
import json
import secrets
import threading
import time
from collections.abc import AsyncIterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from trueplant.app import levels
from trueplant.app.folder import ProjectFile
from trueplant.app.process import Process
from trueplant.errors import UsageError

FINISHED = ("done", "refused", "failed", "cancelled")
LOADING = "loading the program"
STAGES = ".stages.json"
"""Beside a result: how long its stages took, from which the next run's time left is told."""


@dataclass(eq=False)
class Job:
    """One analysis: what it is at, and how it ended."""

    id: str
    project: str
    out: Path
    """Where its result is written."""
    state: str = "waiting"
    """waiting, running; then done, refused (the result says why), failed (`error` says why) or cancelled."""
    stage: str = LOADING
    stages: list[tuple[str, float]] = field(default_factory=list)
    """Those that are done, with the seconds that each took."""
    compiling: bool = False
    """Functions are being compiled, which happens the first time only."""
    started: float = field(default_factory=time.time)
    """Seconds since 1970."""
    ended: float | None = None
    error: str = ""
    headline: str = ""
    known: dict[str, float] = field(default_factory=dict)
    """Seconds of the stages of the last analysis of this project."""
    leaving: bool = False
    """The app is ending: nobody is told any more."""
    _since: float = field(default_factory=time.time)
    _process: Process | None = None
    _changed: list[tuple[asyncio.AbstractEventLoop, asyncio.Event]] = field(default_factory=list)
    _lock: threading.Lock = field(default_factory=threading.Lock)

    @property
    def finished(self) -> bool:
        return self.state in FINISHED

    @property
    def seconds(self) -> float:
        """That it has taken so far."""
        return (time.time() if self.ended is None else self.ended) - self.started

    @property
    def left(self) -> float | None:
        """Seconds that it will still take if its stages take what they took last; None without a last time."""
        if self.finished or not self.known:
            return None
        done = {name for name, _ in self.stages}
        ahead = sum(took for name, took in self.known.items() if name not in done and name != self.stage)
        return ahead + max(self.known.get(self.stage, 0.0) - (time.time() - self._since), 0.0)

    def told(self) -> dict[str, Any]:
        """All of it as JSON."""
        return {
            "id": self.id,
            "project": self.project,
            "state": self.state,
            "finished": self.finished,
            "stage": self.stage,
            "stages": [{"name": name, "seconds": round(took, 3)} for name, took in self.stages],
            "compiling": self.compiling,
            "started": self.started,
            "seconds": round(self.seconds, 3),
            "left": None if self.left is None else round(self.left, 1),
            "error": self.error,
            "headline": self.headline,
        }

    async def events(self) -> AsyncIterator[dict[str, Any]]:
        """`told` now and at every change, and at least every `HEARTBEAT`; ends when the job has."""
        changed = asyncio.Event()
        entry = (asyncio.get_running_loop(), changed)
        with self._lock:
            self._changed.append(entry)
        try:
            while True:
                changed.clear()
                told = self.told()
                yield told
                if told["finished"] or self.leaving:
                    return
                with contextlib.suppress(TimeoutError):
                    await asyncio.wait_for(changed.wait(), levels.HEARTBEAT)
        finally:
            with self._lock:
                self._changed.remove(entry)

    # -- what the process says -------------------------------------------------------------------------------------

    def at(self, stage: str) -> None:
        now = time.time()
        if self.state == "waiting":
            self.state = "running"
        self.stages.append((self.stage, now - self._since))
        self.stage, self._since = stage, now
        self.tell()

    def end(self, state: str, error: str = "", headline: str = "") -> None:
        """The first end counts."""
        with self._lock:
            if self.finished:
                return
            self.ended = time.time()
            self.stages.append((self.stage, self.ended - self._since))
            self.state, self.error, self.headline, self.compiling = state, error, headline, False
        self.tell()

    def tell(self) -> None:
        with self._lock:
            waiting = list(self._changed)
        for loop, changed in waiting:
            with contextlib.suppress(RuntimeError):  # the page is closed, and its loop too
                loop.call_soon_threadsafe(changed.set)


class Jobs:
    """The analyses of an app. At most one runs of each project."""

    def __init__(self, warm: bool = True) -> None:
        self._jobs: dict[str, Job] = {}
        self._lock = threading.RLock()
        self._keeps_warm = warm
        self._warm: Process | None = None
        self._closed = False

    def warm(self) -> None:
        """Have a process ready for the next analysis."""
        with self._lock:
            if self._keeps_warm and not self._closed and (self._warm is None or not self._warm.alive):
                self._warm = Process()

    def start(self, project: ProjectFile, force: bool = False) -> Job:
        """Raises UsageError where one of this project runs already, ProjectError and Outside."""
        project.load()  # what is wrong with it is said at once, and nothing outside of the folder is read
        out = project.out
        with self._lock:
            if self._closed:
                raise UsageError("the app is ending")
            last = self.of(project)
            if last is not None and not last.finished:
                raise UsageError(f"an analysis of {project.name} is running already: wait for it, or cancel it first")
            job = Job(secrets.token_hex(8), project.name, out, known=_took(last) or _known(out))
            self._jobs[job.id] = job
            for old in [one.id for one in self._jobs.values() if one.finished][: -levels.KEPT_JOBS]:
                del self._jobs[old]
            process = self._warm if self._warm is not None and self._warm.alive else Process()
            self._warm = None
            job._process = process
        process.listen(lambda said: self._heard(job, said))
        with contextlib.suppress(OSError):  # it has died: its end is heard
            folder = str(project.path.parent)
            process.tell({"folder": folder, "project": project.path.name, "out": out.name, "force": force})
        return job

    def get(self, id: str) -> Job | None:
        """A job by its id."""
        return self._jobs.get(id)

    def of(self, project: ProjectFile) -> Job | None:
        """The last one of a project."""
        return next((job for job in reversed(self._jobs.values()) if job.project == project.name), None)

    def cancel(self, id: str) -> None:
        """Kill it. A result that was there stays as it was."""
        job = self._jobs.get(id)
        if job is None or job.finished:
            return
        job.end("cancelled")
        if job._process is not None:
            job._process.kill()
        self.warm()

    def leave(self) -> None:
        """End all streams of events."""
        for job in list(self._jobs.values()):
            job.leaving = True
            job.tell()

    def close(self) -> None:
        """End all processes."""
        with self._lock:
            self._closed = True
            processes = [job._process for job in self._jobs.values() if job._process is not None]
            if self._warm is not None:
                processes.append(self._warm)
            for job in self._jobs.values():
                job.end("cancelled")
        for process in processes:
            process.kill()

    def _heard(self, job: Job, said: dict[str, Any] | None) -> None:
        if said is None:
            self._ended(job)
        elif "stage" in said:
            job.at(said["stage"])
        elif "compiling" in said:
            job.compiling = bool(said["compiling"])
            job.tell()
        elif "done" in said:
            job.end("refused" if said["done"] == "refused" else "done", headline=said["headline"])
        elif "failed" in said:
            job.end("failed", said["failed"])

    def _ended(self, job: Job) -> None:
        assert job._process is not None
        status = job._process.ended_with or 0
        how = f"signal {-status}" if status < 0 else f"exit status {status}"
        job.end(
            "failed",
            f"the process of this analysis was ended from outside ({how}), perhaps because memory ran out: "
            "an earlier result is as it was; run it again, or give it less data",
        )
        if job.state in ("done", "refused"):
            _keep(job)
        self.warm()


def _known(out: Path) -> dict[str, float]:
    try:
        found = json.loads((out / STAGES).read_text(encoding="utf-8"))
        return {str(name): float(took) for name, took in found.items()}
    except (OSError, ValueError, TypeError, AttributeError):
        return {}


def _took(job: Job | None) -> dict[str, float]:
    """Seconds of each stage of one that came to its end."""
    took: dict[str, float] = {}
    for name, seconds in job.stages if job is not None and job.state in ("done", "refused") else ():
        took[name] = round(took.get(name, 0.0) + seconds, 3)
    return took


def _keep(job: Job) -> None:
    with contextlib.suppress(OSError):
        (job.out / STAGES).write_text(json.dumps(_took(job)), encoding="utf-8")
