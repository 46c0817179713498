"""Files that are given to be read: regular ones only, each opened once."""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from trueplant.errors import TrueplantError

MISSING = "correct the path (in a project file it is relative to that file)"


def contents(file: Path, error: type[TrueplantError], missing: str = MISSING) -> bytes:
    """All of a regular file. Raises what `opened` raises."""
    with opened(file, error, missing) as handle:
        return handle.read()


@contextmanager
def opened(file: Path, error: type[TrueplantError], missing: str = MISSING) -> Iterator[BinaryIO]:
    """A regular file, opened once to be read. Raises `error` (what it is, what to do) for anything else.

    A pipe would be waited for, and a device might never end.
    """
    try:
        _check(file, os.stat(file), error)
        number = os.open(file, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
    except FileNotFoundError:
        raise error(f"{shortened(file)} does not exist; {missing}") from None
    except (OSError, ValueError) as failed:  # a path with a zero in it is a wrong value
        raise _unreadable(file, error, failed) from None
    with os.fdopen(number, "rb") as handle:
        _check(file, os.fstat(number), error)  # it may have been exchanged meanwhile
        try:
            yield handle
        except OSError as failed:
            raise _unreadable(file, error, failed) from None


def _unreadable(file: Path, error: type[TrueplantError], failed: Exception) -> TrueplantError:
    reason = getattr(failed, "strerror", None) or failed
    return error(f"{shortened(file)} cannot be read ({reason}); check the file and its permissions")


def _check(file: Path, status: os.stat_result, error: type[TrueplantError]) -> None:
    if not stat.S_ISREG(status.st_mode):
        kind = _KINDS.get(stat.S_IFMT(status.st_mode), "no file")
        raise error(f"{shortened(file)} is {kind} and cannot be read; name a file")


def shortened(path: Path, most: int = 200) -> str:
    """A path as it is shown: of a very long one the end, which tells files apart."""
    text = str(path)
    return text if len(text) <= most else f"...{text[-most:]}"


_KINDS = {stat.S_IFDIR: "a folder", stat.S_IFIFO: "a pipe", stat.S_IFSOCK: "a socket"} | dict.fromkeys(
    [stat.S_IFCHR, stat.S_IFBLK], "a device"
)


def runs(process: int) -> bool:
    """Is there a process of this number?"""
    if process == os.getpid():
        return True
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except OSError:
        return True
    return True
