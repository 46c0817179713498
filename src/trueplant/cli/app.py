"""The command ``trueplant`` and its exit status."""

from __future__ import annotations

import typer

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None)


@app.callback()
def trueplant() -> None:
    """Find what changed in a plant from its closed-loop data, and how surely."""


def main() -> None:
    """Entry point of the console script."""
    app()
