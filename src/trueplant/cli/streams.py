"""Standard streams that nobody reads, that are closed or full: none of them changes how a command ends."""

from __future__ import annotations

import io
import os
import sys
from typing import TYPE_CHECKING

from trueplant.errors import OutputError

if TYPE_CHECKING:
    from _typeshed import ReadableBuffer


def ready_streams() -> None:
    """Put streams that can bear anything in place of those that Python has opened; others are left as they are."""
    _occupy_closed()
    for name in ("stdout", "stderr"):
        given = getattr(sys, name)
        if given is None:
            setattr(sys, name, io.TextIOWrapper(io.FileIO(os.devnull, "w"), "utf-8"))
        elif given is getattr(sys, f"__{name}__"):
            given.flush()
            raw = _Patient(given.fileno(), "w", closefd=False)
            line_by_line = given.line_buffering or name == "stderr"
            wrapped = io.TextIOWrapper(
                io.BufferedWriter(raw), given.encoding, errors="backslashreplace", line_buffering=line_by_line
            )
            setattr(sys, name, wrapped)


def _occupy_closed() -> None:
    """Open what is closed of the three: a file would get its number, and what is printed would be written into it."""
    while (number := os.open(os.devnull, os.O_RDWR)) <= 2:
        os.set_inheritable(number, True)
    os.close(number)


class _Patient(io.FileIO):
    """A stream that goes on in silence where its reader has seen enough, and says once that it is full."""

    def write(self, content: ReadableBuffer) -> int:
        try:
            return super().write(content)
        except OSError as error:
            os.dup2(os.open(os.devnull, os.O_WRONLY), self.fileno())
            if isinstance(error, BrokenPipeError):
                return memoryview(content).nbytes
            raise OutputError(f"standard output cannot be written to ({error.strerror})") from None
