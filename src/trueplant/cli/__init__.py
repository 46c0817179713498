"""The command line: thin commands over the other rooms."""

from trueplant.cli.entry import main

__all__ = ["main"]
