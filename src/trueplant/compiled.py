"""Functions that numba turns into machine code, which is kept for the next process where there is a place for it."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from typing import Any

from numba import njit
from numba.core import event
from numba.core.caching import FunctionCache


class _Forgiving(FunctionCache):  # type: ignore[misc]
    """A store that cannot be read or written (damaged, full, taken away) is as good as none: it costs time only."""

    def load_overload(self, *key: Any) -> Any:
        try:
            return super().load_overload(*key)
        except Exception:  # whatever unpickling a damaged file leads to
            with contextlib.suppress(Exception):
                self.flush()
            return None

    def save_overload(self, *entry: Any) -> None:
        with contextlib.suppress(Exception):
            super().save_overload(*entry)


def compiled(function: Callable[..., Any] | None = None, **options: Any) -> Any:
    """Decorator like `numba.njit(cache=True)`; where nothing can be stored, each process compiles for itself."""
    if function is None:
        return lambda given: compiled(given, **options)
    dispatcher = njit(**options)(function)
    with contextlib.suppress(RuntimeError):  # neither the package's folder nor the user's can be written to
        dispatcher._cache = _Forgiving(function)
    return dispatcher


class _Telling(event.Listener):  # type: ignore[misc]
    def __init__(self, tell: Callable[[bool], None]) -> None:
        self.tell = tell

    def on_start(self, event: Any) -> None:
        self.tell(True)

    def on_end(self, event: Any) -> None:
        self.tell(False)


@contextlib.contextmanager
def compiling(tell: Callable[[bool], None]) -> Iterator[None]:
    """Call `tell` with True whenever a function begins to be compiled, which takes seconds, and with False after it.

    What is loaded from the store is not told.
    """
    with event.install_listener("numba:compile", _Telling(tell)):
        yield
