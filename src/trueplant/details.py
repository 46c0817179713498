"""Where the details of an internal error go: into a file, not onto a page or a terminal."""

from __future__ import annotations

import os
import sys
import tempfile
import traceback

from trueplant.version import __version__


def write_details(command: str = "") -> str:
    """Put the traceback of the present error into a file, below the command that met it; its name."""
    said = f"{command}\n" if command else ""
    text = f"trueplant {__version__}, Python {sys.version}\n{said}\n{traceback.format_exc()}"
    try:
        handle, name = tempfile.mkstemp(prefix="trueplant-error-", suffix=".txt")
        with os.fdopen(handle, "w", encoding="utf-8", errors="backslashreplace") as file:
            file.write(text)
    except OSError:
        return f"no file, since none could be written: {traceback.format_exc(limit=-1)}"
    return name
