"""Every kind of historian, in one table: another one is a file of its own and a line here."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from typing import cast

from trueplant.connect.settings import Settings
from trueplant.connect.source import Source

Opener = Callable[[Settings], Source]

KINDS: dict[str, str] = {
    "parquet": "trueplant.connect.lake:Lake",
    "sqlite": "trueplant.connect.sqlite:Sqlite",
    "postgresql": "trueplant.connect.postgresql:PostgreSql",
    "opcua": "trueplant.connect.opcua:OpcUa",
    "pi": "trueplant.connect.pi:PiWebApi",
}
"""Module and class by `data.source.kind`. They are imported when they are used: some need packages of an extra."""


def open_source(settings: Settings) -> Source:
    """The historian of a project. Raises UsageError where its package is not installed, and what opening raises."""
    module, _, name = KINDS[settings.table.kind].partition(":")
    opener = cast(Opener, getattr(importlib.import_module(module), name))
    return opener(settings)
