"""The command ``app``: where the folder and its project are found, and what is said on the terminal."""

from __future__ import annotations

import sys
from pathlib import Path

from trueplant.errors import UsageError
from trueplant.printable import printable


def app(place: Path, port: int, browser: bool, address: str) -> int:
    """Run the local web application until it is told to end."""
    try:
        from trueplant.app.server import Asked, serve
    except ModuleNotFoundError as error:
        if error.name not in ("starlette", "uvicorn"):
            raise
        raise UsageError(f"{error.name} is not installed: pip install 'trueplant[app]'") from None
    if place.is_dir():
        folder, project = place, ""
    elif place.is_file() and place.suffix == ".toml":
        folder, project = place.parent, place.name
    else:
        raise UsageError(f"{place} is neither a folder nor a project file (.toml): name one that is there")
    return serve(Asked(folder.resolve(), project, port, browser, address), _show)


def _show(line: str) -> None:
    print(printable(line), file=sys.stdout, flush=True)
