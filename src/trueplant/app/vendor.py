"""The libraries of others that the pages draw with: packed in an installed package, in node_modules of a checkout."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path

from trueplant.errors import UsageError

VENDOR = {
    "plotly-basic.min.js": "plotly.js-basic-dist-min/plotly-basic.min.js",
    "uPlot.iife.min.js": "uplot/dist/uPlot.iife.min.js",
    "uPlot.min.css": "uplot/dist/uPlot.min.css",
}
"""Name in the app's addresses: where the file lies in node_modules."""


def vendored(name: str) -> Path:
    """The file of one of `VENDOR`. Raises UsageError where it is not installed."""
    for place in _places(name):
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


def _places(name: str) -> tuple[Path, Path]:
    room = Path(str(files("trueplant.app")))
    return room / "vendor" / name, room.parents[2] / "node_modules" / VENDOR[name]
