"""Changes of a project's text that the screens Tags and Trends make: comments, order and line ends stay.

Each is checked against the same change of the tables alone, so that nothing else of the project moves.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import tomlkit
from tomlkit.items import Item

from trueplant.errors import ProjectError
from trueplant.project.document import (
    Tables,
    edited,
    entries,
    in_its_lines,
    same_toml,
    to_toml,
    with_entry,
    with_exclusions,
    without_entries,
)

Change = Callable[[dict[str, Any]], None]

REFERS = {"output": ("model", "controller", "unmeasured"), "input": ("model", "controller")}
"""Tables whose entries name an output or an input."""


def set_keys(text: str, table: str, name: str, keys: Mapping[str, Any]) -> str:
    """The project with other values at the entry of [[table]] that bears this name; None takes a key out."""

    def change(tables: Tables) -> None:
        for entry in entries(tables, table):
            if entry.get("name") == name:
                _set(entry, keys)

    _there(text, table, name)
    return _checked(text, edited(text, change), change)


def set_data(text: str, keys: Mapping[str, Any]) -> str:
    """The project with other values in [data]; None takes a key out."""
    made = text if "data" in tomllib.loads(text) else f"{text.rstrip()}\n\n[data]\n"

    def change(tables: Tables) -> None:
        if "data" in tables:
            _set(tables["data"], keys)

    waiting = [True]

    def first(tables: Tables) -> None:
        # [data.source] and [[data.exclude]] are sections of their own, which hold a table data, too
        own = tables.get("data")
        if waiting and own is not None and set(own) - {"source", "exclude"}:
            _set(own, keys)
            waiting.clear()

    return _checked(made, edited(made, first), change)


def add_loop(text: str, output: Mapping[str, Any], input_: Mapping[str, Any]) -> str:
    """The project with one loop more, behind those that there are."""

    def change(tables: dict[str, Any]) -> None:
        tables.setdefault("output", []).append(dict(output))
        tables.setdefault("input", []).append(dict(input_))

    return _checked(text, with_entry(with_entry(text, "output", output), "input", input_), change)


def remove_loop(text: str, output: str | None, input_: str | None) -> str:
    """The project without an output and an input, and without what is said of them elsewhere."""
    gone = {"output": output, "input": input_}

    def leaves(table: str, entry: Mapping[str, Any]) -> bool:
        if table in gone:
            return gone[table] is not None and entry.get("name") == gone[table]
        return any(name is not None and table in REFERS[key] and entry.get(key) == name for key, name in gone.items())

    tables = ("output", "input", "model", "controller", "unmeasured")

    def change(found: dict[str, Any]) -> None:
        for table in tables:
            if isinstance(found.get(table), list):
                found[table] = [entry for entry in found[table] if not leaves(table, entry)]
                if not found[table]:
                    del found[table]

    after = text
    for table in tables:
        after = without_entries(after, table, lambda entry, table=table: leaves(table, entry))  # type: ignore[misc]
    return _checked(text, after, change)


def add_disturbance(text: str, entry: Mapping[str, Any]) -> str:
    """The project with one measured disturbance more."""

    def change(tables: dict[str, Any]) -> None:
        tables.setdefault("disturbance", []).append(dict(entry))

    return _checked(text, with_entry(text, "disturbance", entry), change)


def remove_disturbance(text: str, name: str) -> str:
    """The project without a measured disturbance, and without the model elements from it."""

    def change(tables: dict[str, Any]) -> None:
        tables["disturbance"] = [entry for entry in tables["disturbance"] if entry.get("name") != name]
        if "model" in tables:
            tables["model"] = [entry for entry in tables["model"] if entry.get("input") != name]
        for table in ("disturbance", "model"):
            if table in tables and not tables[table]:
                del tables[table]

    _there(text, "disturbance", name)
    after = without_entries(text, "disturbance", lambda entry: entry.get("name") == name)
    return _checked(text, without_entries(after, "model", lambda entry: entry.get("input") == name), change)


def exclude(text: str, stretches: Sequence[Mapping[str, Any]]) -> str:
    """The project with more stretches in data.exclude."""

    def change(tables: dict[str, Any]) -> None:
        data = tables.setdefault("data", {})
        data["exclude"] = [*data.get("exclude", []), *map(dict, stretches)]

    return _checked(text, with_exclusions(text, stretches), change)


def include(text: str, place: int) -> str:
    """The project without the stretch at this place of data.exclude."""
    listed = tomllib.loads(text).get("data", {}).get("exclude", [])
    if not 0 <= place < len(listed):
        raise ProjectError("this stretch is not excluded any more: load the page again")

    def change(tables: dict[str, Any]) -> None:
        del tables["data"]["exclude"][place]
        if not tables["data"]["exclude"]:
            del tables["data"]["exclude"]

    count = iter(range(len(listed)))
    after = without_entries(text, "data.exclude", lambda entry: next(count) == place)
    return _checked(text, after, change)


def _set(entry: Tables, keys: Mapping[str, Any]) -> None:
    for key, value in keys.items():
        if value is None:
            entry.pop(key, None)
        elif isinstance(old := entry.get(key), Item):
            new = tomlkit.item(list(value) if isinstance(value, tuple) else value)
            new.trivia.comment, new.trivia.comment_ws = old.trivia.comment, old.trivia.comment_ws
            entry[key] = new
        else:
            entry[key] = list(value) if isinstance(value, tuple) else value


def _there(text: str, table: str, name: str) -> None:
    if all(entry.get("name") != name for entry in entries(tomllib.loads(text), table)):
        raise ProjectError(f"the project has no [[{table}]] with name = {name!r} any more: load the page again")


def _checked(before: str, after: str, change: Change) -> str:
    """`after`, if it says just what `change` makes of the tables of `before`. Raises ProjectError."""
    after = in_its_lines(before, after)
    wanted = tomllib.loads(before)
    change(wanted)
    if same_toml(after, wanted):
        return after
    raise ProjectError(
        f"this cannot be written into the form that the project file has; make the change by hand, so that it says:\n"
        f"{to_toml(wanted)}"
    )
