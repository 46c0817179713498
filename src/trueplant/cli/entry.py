"""Where the command begins: every end of it, good or bad, with its exit status and one message.

It imports next to nothing itself, so that Ctrl-C is noticed from its first moments on.
"""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import threading
from collections.abc import Sequence
from types import FrameType

from trueplant.cli.streams import ready_streams
from trueplant.errors import OutputError, TrueplantError
from trueplant.printable import printable
from trueplant.threads import ask_for_one
from trueplant.version import __version__

INTERNAL_ERROR, INTERRUPTED = 70, 130


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command and return its exit status; an error is one message on standard error."""
    ready_streams()
    interrupted = _noticed_interrupts()
    ask_for_one()
    try:
        status = _command(None if arguments is None else list(arguments))
        sys.stdout.flush()
        return _interrupted() if status == INTERRUPTED else status
    except TrueplantError as error:
        _say(str(error))
        return error.exit_status
    except KeyboardInterrupt:
        return _interrupted()
    except BaseException as error:  # libraries that are not written in Python report their panics so
        if interrupted:
            return _interrupted()
        if hasattr(error, "format_message"):
            _say(f"{error.format_message().rstrip('.')}; see trueplant --help")
            return 2
        _say(f"internal error ({type(error).__name__}); the details were written to {_write_details()}")
        return INTERNAL_ERROR


def _command(arguments: list[str] | None) -> int:
    import typer

    from trueplant.cli.app import app

    command = typer.main.get_command(app)
    try:
        return int(command.main(args=arguments, prog_name="trueplant", standalone_mode=False) or 0)
    except typer.Abort:  # some versions of typer make this of Ctrl-C, others the status
        return INTERRUPTED


def _noticed_interrupts() -> list[int]:
    """A list that every Ctrl-C from now on is added to: a library that is being imported makes an ImportError of it."""
    seen: list[int] = []

    def notice(number: int, frame: FrameType | None) -> None:
        seen.append(number)
        signal.default_int_handler(number, frame)

    # not where somebody else handles it, or where it is ignored, as in the background
    if (
        signal.getsignal(signal.SIGINT) is signal.default_int_handler
        and threading.current_thread() is threading.main_thread()
    ):
        signal.signal(signal.SIGINT, notice)
    return seen


def _interrupted() -> int:
    _say("interrupted; no result was written")
    return INTERRUPTED


def _say(message: str) -> None:
    with contextlib.suppress(OSError, OutputError):  # nobody is left to be told
        print(printable(f"trueplant: {message}"), file=sys.stderr)


def _write_details() -> str:
    import tempfile
    import traceback

    text = f"trueplant {__version__}, Python {sys.version}\n{' '.join(sys.argv)}\n\n{traceback.format_exc()}"
    try:
        handle, name = tempfile.mkstemp(prefix="trueplant-error-", suffix=".txt")
        with os.fdopen(handle, "w", encoding="utf-8", errors="backslashreplace") as file:
            file.write(text)
    except OSError:
        return f"no file, since none could be written: {traceback.format_exc(limit=-1)}"
    return name
