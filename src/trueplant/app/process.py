"""Processes beside the app that can be killed: spawned, never forked, since a fork would keep the server's socket."""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
import threading
import weakref
from collections.abc import Callable
from typing import Any

from trueplant.app import levels
from trueplant.threads import VARIABLES

_started: weakref.WeakSet[Process] = weakref.WeakSet()


class Process:
    """A spawned process that speaks in lines of JSON. `heard` is called with each, in a thread, and with None last."""

    def __init__(self, module: str = "trueplant.app.worker") -> None:
        environment = os.environ | dict.fromkeys(VARIABLES, "1")
        # a session of its own: Ctrl-C on the terminal is for the app, which ends it
        self._process = subprocess.Popen(
            [sys.executable, "-m", module],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env=environment,
            text=True,
            encoding="utf-8",
            start_new_session=True,
        )
        self.pid = self._process.pid
        self._heard = False
        _started.add(self)

    @property
    def alive(self) -> bool:
        return self._process.poll() is None

    def listen(self, heard: Callable[[dict[str, Any] | None], None]) -> None:
        """Once."""

        self._heard = True

        def lines() -> None:
            assert self._process.stdout is not None
            with self._process.stdout as said:
                for line in said:
                    with contextlib.suppress(ValueError):
                        heard(json.loads(line))
            self._process.wait()
            self._close()
            heard(None)

        threading.Thread(target=lines, daemon=True).start()

    def tell(self, task: dict[str, Any]) -> None:
        """Raises OSError where it has died."""
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(json.dumps(task) + "\n")
            self._process.stdin.flush()
        except ValueError:  # closed, since it was killed
            raise BrokenPipeError("the process has ended") from None

    @property
    def ended_with(self) -> int | None:
        return self._process.poll()

    def kill(self) -> None:
        """At once, and waited for."""
        with contextlib.suppress(OSError):
            self._process.kill()
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(levels.KILLED_WITHIN)
        self._close()

    def _close(self) -> None:
        """The pipes; that which is listened to is closed by who listens."""
        for pipe in (self._process.stdin, None if self._heard else self._process.stdout):
            with contextlib.suppress(OSError):
                if pipe is not None:
                    pipe.close()


def end_all() -> None:
    """Kill every process that still runs, when the app ends."""
    for process in list(_started):
        process.kill()
