"""One thread for linear algebra: on several, OpenBLAS cuts sums where their number says, and the last digits follow it.

On matrices as small as those of a plant it is faster, too.
"""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Callable, Iterator
from functools import cache
from importlib import import_module
from itertools import product
from threading import Lock
from typing import Any

VARIABLES = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")
"""Read by the libraries when they are loaded."""

_LINKED = ("numpy.linalg._umath_linalg", "scipy.linalg.cython_blas")
"""Modules through which each OpenBLAS of the process is reached."""
_lock = Lock()
_inside = 0
_before: list[int] = []


def ask_for_one() -> None:
    """For the whole process and those it starts, as long as no such library is loaded."""
    if "numpy" not in sys.modules:
        os.environ.update(dict.fromkeys(VARIABLES, "1"))


@contextlib.contextmanager
def one_thread() -> Iterator[None]:
    """Meanwhile, in a process that others have set up; also where several such stretches of work overlap."""
    global _inside
    with _lock:
        if _inside == 0:
            _before[:] = [get() for get, _ in _switches()]
            for _, put in _switches():
                put(1)
        _inside += 1
    try:
        yield
    finally:
        with _lock:
            _inside -= 1
            if _inside == 0:
                for (_, put), number in zip(_switches(), _before, strict=True):
                    put(number)


@cache
def _switches() -> list[tuple[Callable[[], int], Callable[[int], Any]]]:
    """What reads and what sets the number of threads of each OpenBLAS; nothing for another library."""
    import ctypes

    found = []
    for module in _LINKED:
        with contextlib.suppress(OSError):
            library = ctypes.CDLL(import_module(module).__file__)
            for prefix, suffix in product(("scipy_", ""), ("64_", "")):
                get, put = (f"{prefix}openblas_{word}_num_threads{suffix}" for word in ("get", "set"))
                if hasattr(library, get) and hasattr(library, put):
                    found.append((getattr(library, get), getattr(library, put)))
    return found
