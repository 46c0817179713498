"""The process that answers questions to the data, one after the other, until its input is closed."""

from __future__ import annotations

import os
import pickle
import queue
import sys
import threading
import warnings
from pathlib import Path
from typing import IO, Any, Literal

from trueplant.app import levels
from trueplant.errors import TrueplantError

Kind = Literal["check", "find"]


def main() -> None:
    """Of ``python -m trueplant.app.answering``."""
    out = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # whatever else prints must not stand among the answers
    if hasattr(os, "nice"):
        os.nice(levels.NICE)
    warnings.simplefilter("ignore")  # as the command line has it: what is to be known are findings
    asked: queue.SimpleQueue[tuple[Kind, str]] = queue.SimpleQueue()
    threading.Thread(target=_read, args=(sys.stdin.buffer, asked), daemon=True).start()
    while True:
        kind, path = asked.get()
        word, value = _answered(kind, Path(path), out)
        _tell(out, word, value)


def _read(given: IO[bytes], asked: queue.SimpleQueue[tuple[Kind, str]]) -> None:
    while True:
        try:
            asked.put(pickle.load(given))
        except EOFError:
            os._exit(0)


def _answered(kind: Kind, path: Path, out: IO[bytes]) -> tuple[str, Any]:
    from trueplant.details import write_details
    from trueplant.project import Project

    def say(stage: str) -> None:
        _tell(out, "stage", stage)

    try:
        project = Project.load(path)
        if kind == "check":
            from trueplant.study.check import check

            return "done", check(project, say)
        from trueplant.tracking.find import find

        return "done", find(project, say)
    except TrueplantError as error:
        return "failed", str(error)
    except Exception as error:
        return "failed", f"internal error ({type(error).__name__}); the details were written to {write_details()}"


def _tell(out: IO[bytes], word: str, value: Any) -> None:
    try:
        pickle.dump((word, value), out)
        out.flush()
    except OSError:  # nobody listens any more
        os._exit(1)


if __name__ == "__main__":
    main()
