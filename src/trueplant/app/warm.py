"""The one process that answers what-ifs, seen from the app: asked from handlers, started again when it has died."""

from __future__ import annotations

import asyncio
import itertools
import threading
import weakref
from collections.abc import Mapping
from concurrent.futures import Future
from dataclasses import dataclass
from typing import Any

from starlette.applications import Starlette

from trueplant.app import levels
from trueplant.app.process import Process
from trueplant.errors import UsageError

MODULE = "trueplant.app.whatif_worker"


@dataclass(frozen=True)
class Answered:
    """What came back; `answer` is None where a newer question has overtaken this one."""

    answer: dict[str, Any] | None
    milliseconds: float = 0.0


class Warm:
    """Questions to the process. It ends with the app, whose end closes its input."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._process: Process | None = None
        self._finalizer: weakref.finalize[[], Warm] | None = None
        self._numbers = itertools.count(1)
        self._open: dict[int, Future[dict[str, Any]]] = {}

    def start(self) -> None:
        """Have it ready."""
        with self._lock:
            self._alive()

    async def ask(self, kind: str, page: str, what: Mapping[str, Any]) -> Answered:
        """Raises UsageError with the process's one message, also where it ends meanwhile or takes too long."""
        future: Future[dict[str, Any]] = Future()
        with self._lock:
            process, number = self._alive(), next(self._numbers)
            self._open[number] = future
            try:
                process.tell({**what, "kind": kind, "page": page, "id": number})
            except OSError:
                self._open.pop(number, None)
                raise UsageError("the process of the what-ifs has ended: try again") from None
        try:
            said = await asyncio.wait_for(asyncio.wrap_future(future), levels.WHATIF_LONGEST)
        except TimeoutError:
            self.close()
            raise UsageError("this what-if took too long and was given up: try again") from None
        if said.get("overtaken"):
            return Answered(None)
        if "error" in said:
            raise UsageError(said["error"])
        return Answered(said["answer"], said["milliseconds"])

    def close(self) -> None:
        """End the process; the next question starts another."""
        with self._lock:
            process, self._process = self._process, None
            if self._finalizer is not None:
                self._finalizer.detach()
        if process is not None:
            process.kill()

    def _alive(self) -> Process:
        if self._process is None or not self._process.alive:
            process = self._process = Process(MODULE)
            own = weakref.ref(self)  # so that an app that is forgotten takes its process along
            process.listen(lambda said: warm._heard(process, said) if (warm := own()) is not None else None)
            self._finalizer = weakref.finalize(self, process.kill)
        return self._process

    def _heard(self, process: Process, said: dict[str, Any] | None) -> None:
        with self._lock:
            if said is not None:
                futures = [future] if (future := self._open.pop(said.get("id", 0), None)) is not None else []
            elif self._process in (process, None):
                futures = list(self._open.values())
                self._open.clear()
                said = {"error": "the process of the what-ifs was ended from outside: try again"}
            else:
                return
        for future in futures:
            if not future.cancelled():
                future.set_result(said or {})


def warm_of(app: Starlette) -> Warm:
    """That of an app."""
    if not hasattr(app.state, "whatif"):
        app.state.whatif = Warm()
    warm: Warm = app.state.whatif
    return warm
