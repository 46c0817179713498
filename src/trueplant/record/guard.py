"""Libraries that are not written in Python: what they do with damaged files becomes one message."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager

from trueplant.errors import DataError, TrueplantError


@contextmanager
def foreign(what: str, remedy: str) -> Iterator[None]:
    """Make a DataError of whatever goes wrong inside, panics of Rust among it, which are no `Exception`.

    A panic also prints on the standard error stream of the process, past Python: that is kept back.
    """
    try:
        with _kept_back():
            yield
    except (TrueplantError, KeyboardInterrupt, GeneratorExit, SystemExit):
        raise
    except BaseException as error:
        reason = next(iter(str(error).splitlines()), "") or type(error).__name__
        raise DataError(f"{what} ({reason[:200]}); {remedy}") from None


@contextmanager
def _kept_back() -> Iterator[None]:
    """Nothing is printed on the standard error stream of the process meanwhile."""
    try:
        number, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    except OSError:  # there is no such stream
        yield
        return
    if sys.stderr is not None:
        sys.stderr.flush()
    os.dup2(nowhere, 2)
    os.close(nowhere)
    try:
        yield
    finally:
        os.dup2(number, 2)
        os.close(number)
