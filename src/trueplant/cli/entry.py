"""Where the command begins: every end of it, good or bad, with its exit status and one message.

It imports next to nothing before Ctrl-C is noticed.
"""

from __future__ import annotations

import atexit
import contextlib
import gc
import signal
import sys
import threading
from collections.abc import Iterator, Sequence
from types import FrameType

from trueplant.cli import levels
from trueplant.errors import OutputError, TrueplantError

INTERNAL_ERROR, INTERRUPTED = 70, 130


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command (that of the process, if None) and return its exit status; an error is one message."""
    with _noticed_interrupts() as interrupts:
        try:
            status = _command(None if arguments is None else list(arguments))
            sys.stdout.flush()
            return _interrupted(interrupts) if status == INTERRUPTED else status
        except TrueplantError as error:
            _say(str(error))
            return error.exit_status
        except KeyboardInterrupt:
            return _interrupted(interrupts)
        except BaseException as error:  # libraries that are not written in Python report their panics so
            if interrupts.seen:
                return _interrupted(interrupts)
            if hasattr(error, "format_message"):
                _say(f"{error.format_message().rstrip('.')}; see trueplant --help")
                return 2
            from trueplant.details import write_details

            details = write_details(" ".join(sys.argv))
            _say(f"internal error ({type(error).__name__}); the details were written to {details}")
            return INTERNAL_ERROR


def _command(arguments: list[str] | None) -> int:
    import warnings

    from trueplant.cli.streams import ready_streams
    from trueplant.threads import ask_for_one

    ready_streams()
    ask_for_one()
    if arguments is None and not sys.warnoptions:  # what libraries warn of is no message to a user: findings are
        warnings.simplefilter("ignore")

    import typer

    from trueplant.cli.app import app

    command = typer.main.get_command(app)
    try:
        return int(command.main(args=arguments, prog_name="trueplant", standalone_mode=False) or 0)
    except typer.Abort:  # some versions of typer make this of Ctrl-C, others the status
        return INTERRUPTED


class _Interrupts:
    """Whether there was one, and whether the end that it led to has begun: who presses Ctrl-C again waits for that."""

    def __init__(self) -> None:
        self.seen = self.ending = False
        self._again: threading.Timer | None = None

    def notice(self, number: int, frame: FrameType | None) -> None:
        self.seen = True
        if not self.ending:
            raise KeyboardInterrupt

    def come_again(self, lost: sys.UnraisableHookArgs) -> None:
        """What C code calls back (compiled functions as they are loaded) cannot raise: Python would drop it there."""
        if lost.exc_type is not KeyboardInterrupt:
            sys.__unraisablehook__(lost)
        elif not self.ending:
            self._again = threading.Timer(levels.AGAIN, signal.raise_signal, [signal.SIGINT])
            self._again.daemon = True
            self._again.start()

    def end(self) -> None:
        """None comes any more."""
        if self._again is not None:
            self._again.cancel()


@contextlib.contextmanager
def _noticed_interrupts() -> Iterator[_Interrupts]:
    """Every Ctrl-C meanwhile: a library that is being imported makes an ImportError of it."""
    found = _Interrupts()
    # not where somebody else handles it, or where it is ignored, as in the background
    if (
        signal.getsignal(signal.SIGINT) is not signal.default_int_handler
        or threading.current_thread() is not threading.main_thread()
    ):
        yield found
        return
    signal.signal(signal.SIGINT, found.notice)
    before, sys.unraisablehook = sys.unraisablehook, found.come_again
    try:
        yield found
    finally:
        found.end()
        sys.unraisablehook = before
        atexit.unregister(_leave)
        atexit.register(_leave)
        signal.signal(signal.SIGINT, signal.default_int_handler)


def _leave() -> None:
    """The end: too late for Ctrl-C, and no look through all objects, which would take most of a second."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    gc.freeze()


def _interrupted(interrupts: _Interrupts) -> int:
    interrupts.ending = True
    _say("interrupted; no file was left half written")
    return INTERRUPTED


def _say(message: str) -> None:
    from trueplant.cli.folding import folded
    from trueplant.printable import message_lines

    first, *shown = message_lines(f"trueplant: {message}")
    with contextlib.suppress(OSError, OutputError):  # nobody is left to be told
        print(folded(first, sys.stderr), *shown, sep="\n", file=sys.stderr)
