"""A limit of time for one loop, in whatever thread it is worked on."""

from __future__ import annotations

import ctypes
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from trueplant.fleet import levels


class PastDeadline(BaseException):
    """The time is up; no `except Exception` on the way takes it for an error of its own."""


@contextmanager
def limited(seconds: float, stuck: Callable[[], None] | None = None) -> Iterator[None]:
    """Raise PastDeadline in this thread after so many seconds; call `stuck` where it does not listen to that."""
    done, guard, thread = threading.Event(), threading.Lock(), threading.get_ident()

    def raise_there(error: type[BaseException] | None) -> None:
        given = None if error is None else ctypes.py_object(error)
        ctypes.pythonapi.PyThreadState_SetAsyncExc(ctypes.c_ulong(thread), given)

    def watch() -> None:
        if done.wait(seconds):
            return
        end = time.monotonic() + levels.GRACE
        while not done.is_set():
            with guard:
                if not done.is_set():
                    raise_there(PastDeadline)
            if done.wait(levels.AGAIN):  # what is raised in a callback or a finalizer is lost
                return
            if stuck is not None and time.monotonic() >= end:
                stuck()
                return

    def finish() -> None:
        with guard:
            done.set()
            raise_there(None)  # one that was on its way would come later, to somebody else

    watcher = threading.Thread(target=watch, name="deadline", daemon=True)
    watcher.start()
    try:
        yield
    finally:
        try:
            finish()
        except PastDeadline:  # raised while the work was done: it comes no second time within AGAIN
            finish()
