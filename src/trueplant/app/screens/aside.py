"""Questions to the data that take longer than a page may wait: `check` and `find`, in a process of their own.

It is kept warm between questions, killed where one is not to be answered any more, and ends with the app.
"""

from __future__ import annotations

import contextlib
import pickle
import subprocess
import sys
import threading
import time
import weakref
from collections import OrderedDict
from collections.abc import Hashable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from trueplant.app.answering import Kind
from trueplant.result import Check

State = Literal["running", "done", "failed", "cancelled"]
KEPT = 16
"""Answers that are kept, of some MB each for a record with many struck stretches. Judgement."""


@dataclass(eq=False)
class Question:
    """One question, and its answer as soon as there is one."""

    kind: Kind
    path: Path
    state: State = "running"
    stage: str = "loading the program"
    answer: Check | None = None
    error: str = ""
    begun: float = field(default_factory=time.monotonic)
    ended: threading.Event = field(default_factory=threading.Event)

    @property
    def seconds(self) -> float:
        """Since it was asked."""
        return time.monotonic() - self.begun

    def end(self, state: State, error: str = "") -> None:
        """Only once."""
        if not self.ended.is_set():
            self.state, self.error = state, error
            self.ended.set()


class Aside:
    """The process, and what it was asked."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._asked: OrderedDict[Hashable, Question] = OrderedDict()
        self._current: Question | None = None
        self._process: subprocess.Popen[bytes] | None = None
        self._finalizer: weakref.finalize[..., Aside] | None = None

    def ask(self, kind: Kind, path: Path, version: Hashable) -> Question:
        """The question about a project of this version; one that runs for another is given up."""
        key = (kind, path, version)
        with self._lock:
            known = self._asked.get(key)
            if known is not None and known.state in ("running", "done"):
                self._asked.move_to_end(key)
                return known
            self._give_up()
            asked = self._asked[key] = self._current = Question(kind, path)
            while len(self._asked) > KEPT:
                self._asked.popitem(last=False)
            process = self._alive()
            assert process.stdin is not None
            process.stdin.write(pickle.dumps((kind, str(path))))
            process.stdin.flush()
            threading.Thread(target=self._listen, args=(process, asked), daemon=True).start()
            return asked

    def known(self, kind: Kind, path: Path, version: Hashable) -> Question | None:
        """What was asked before."""
        return self._asked.get((kind, path, version))

    def cancel(self, path: Path) -> None:
        """Give up what runs for this project."""
        with self._lock:
            if self._current is not None and self._current.path == path:
                self._give_up()

    def close(self) -> None:
        """End the process."""
        with self._lock:
            self._give_up()
            self._kill()

    def _give_up(self) -> None:
        if self._current is not None and not self._current.ended.is_set():
            self._current.end("cancelled")
            self._kill()

    def _kill(self) -> None:
        if self._process is not None:
            _end(self._process)
            self._process = None

    def _alive(self) -> subprocess.Popen[bytes]:
        if self._process is None or self._process.poll() is not None:
            self._kill()
            command = [sys.executable, "-m", "trueplant.app.answering"]
            self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
            if self._finalizer is not None:
                self._finalizer.detach()
            self._finalizer = weakref.finalize(self, _end, self._process)
        return self._process

    @staticmethod
    def _listen(process: subprocess.Popen[bytes], asked: Question) -> None:
        assert process.stdout is not None
        while not asked.ended.is_set():
            try:
                word, value = pickle.load(process.stdout)
            except (EOFError, OSError, ValueError, pickle.UnpicklingError):
                asked.end("failed", "the process that looks at the data was ended from outside, perhaps because "
                          "memory ran out: try again, or give it less data")  # fmt: skip
                return
            if word == "stage":
                asked.stage = value
            elif word == "done":
                asked.answer = value
                asked.end("done")
            else:
                asked.end("failed", value)


def _end(process: subprocess.Popen[bytes]) -> None:
    process.kill()
    process.wait()
    for pipe in (process.stdin, process.stdout):
        if pipe is not None:
            with contextlib.suppress(OSError):  # it may hold what the process was not to read any more
                pipe.close()
