"""The libraries of others that the pages draw with: packed in an installed package, in node_modules of a checkout."""

from __future__ import annotations

import json
from importlib.resources import files
from pathlib import Path

from trueplant.errors import UsageError

ROOM = Path(str(files("trueplant.app")))
VENDOR: dict[str, str] = json.loads((ROOM / "vendor.json").read_text(encoding="utf-8"))
"""Name in the app's addresses: where the file lies in node_modules. hatch_build.py packs them by the same list."""


def vendored(name: str) -> Path:
    """The file of one of `VENDOR`. Raises UsageError where it is not installed."""
    for place in (ROOM / "vendor" / name, ROOM.parents[2] / "node_modules" / VENDOR[name]):
        if place.is_file():
            return place
    raise UsageError(
        f"{name}, which the app draws with, is not installed: in a checkout run `make app` or `npm ci`; else install "
        "trueplant again from a wheel"
    )


def check_vendored() -> None:
    """Raises UsageError where one is missing."""
    for name in VENDOR:
        vendored(name)
