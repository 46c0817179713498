"""The command line: thin commands over the other rooms."""

from trueplant.cli.app import main

__all__ = ["main"]
