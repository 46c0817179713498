"""Changes of a project's text that the screen Model makes: elements of the model and controllers; comments stay."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
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
    without_entries,
)

Place = tuple[str, str]
"""(output, input)"""
AUTO = {"structure": "auto"}
"""Of an element that is to be found."""


def set_element(text: str, place: Place, keys: Mapping[str, Any] | None, places: Sequence[Place]) -> str:
    """The project with an element of the model that has these keys; None: there is no response.

    `places` are all elements that there are. A project without any [[model]] looks for all of them; as soon as one is
    declared, what is not is zero: the others are then written down as such that are to be found.
    """
    declared = _places(text, "model")
    after = text
    if not declared:
        if keys == AUTO:
            return text
        for other in places:
            if other != place:
                after = with_entry(after, "model", _element(other, AUTO))
        declared = [other for other in places if other != place]
    if keys is None and (place not in declared or len(declared) > 1):
        after = without_entries(after, "model", lambda one: (one.get("output"), one.get("input")) == place)
    elif place in declared:
        after = _with_keys(after, "model", place, {"tf": "0"} if keys is None else keys)
    elif keys is not None:
        after = with_entry(after, "model", _element(place, keys))
    return _checked(text, after, _wanted_elements(text, place, keys, places))


def set_controller(text: str, place: Place, keys: Mapping[str, Any] | None) -> str:
    """The project with a controller of this output and input that has these keys; None: without it."""
    after, there = text, place in _places(text, "controller")
    if keys is None:
        after = without_entries(after, "controller", lambda one: (one.get("output"), one.get("input")) == place)
    elif there:
        after = _with_keys(after, "controller", place, keys)
    else:
        after = with_entry(after, "controller", {"input": place[1], "output": place[0], **keys})
    wanted = tomllib.loads(text)
    laws = [dict(one) for one in wanted.get("controller", [])]
    mine = {"input": place[1], "output": place[0], **(keys or {})}
    laws = [mine if _place(one) == place else one for one in laws if keys is not None or _place(one) != place]
    _put(wanted, "controller", laws if there or keys is None else [*laws, mine])
    return _checked(text, after, wanted)


def set_analysis(text: str, keys: Mapping[str, Any]) -> str:
    """The project with other values in [analysis]; None takes a key out."""
    wanted = tomllib.loads(text)
    own = {**wanted.get("analysis", {}), **keys}
    _put(wanted, "analysis", {key: value for key, value in own.items() if value is not None})
    if "analysis" not in tomllib.loads(text):
        new = {key: value for key, value in keys.items() if value is not None}
        after = f"{text.rstrip()}\n\n{to_toml({'analysis': new})}" if new else text
    else:

        def change(tables: Tables) -> None:
            if isinstance(tables.get("analysis"), Mapping):
                _set(tables["analysis"], keys)

        after = edited(text, change)
        if not wanted.get("analysis"):
            wanted["analysis"] = {}
    return _checked(text, after, wanted)


def _wanted_elements(
    text: str, place: Place, keys: Mapping[str, Any] | None, places: Sequence[Place]
) -> dict[str, Any]:
    wanted = tomllib.loads(text)
    found = [dict(one) for one in wanted.get("model", [])] or [_element(p, AUTO) for p in places if p != place]
    there = any(_place(one) == place for one in found)
    if keys is None:
        left = [one for one in found if _place(one) != place]
        found = left or [_element(place, {"tf": "0"})]
    elif there:
        found = [_element(place, keys) if _place(one) == place else one for one in found]
    else:
        found.append(_element(place, keys))
    _put(wanted, "model", found)
    return wanted


def _element(place: Place, keys: Mapping[str, Any]) -> dict[str, Any]:
    return {"output": place[0], "input": place[1], **keys}


def _place(entry: Mapping[str, Any]) -> Place:
    return str(entry.get("output")), str(entry.get("input"))


def _places(text: str, table: str) -> list[Place]:
    return [_place(one) for one in entries(tomllib.loads(text), table)]


def _put(tables: dict[str, Any], name: str, value: Any) -> None:
    if value:
        tables[name] = value
    else:
        tables.pop(name, None)


def _with_keys(text: str, table: str, place: Place, keys: Mapping[str, Any]) -> str:
    """The entry with just these keys beside its place; those that stay keep their comments."""

    def change(tables: Tables) -> None:
        for entry in entries(tables, table):
            if _place(entry) == place:
                gone = {key: None for key in entry if key not in keys and key not in ("output", "input")}
                _set(entry, {**gone, **keys})

    return edited(text, change)


def _set(entry: Tables, keys: Mapping[str, Any]) -> None:
    for key, value in keys.items():
        if value is None:
            entry.pop(key, None)
        elif key in entry and entry[key] == value and isinstance(entry[key], bool) == isinstance(value, bool):
            continue  # as it stands, with its own way of writing it
        elif isinstance(old := entry.get(key), Item):
            new = tomlkit.item(value)
            new.trivia.comment, new.trivia.comment_ws = old.trivia.comment, old.trivia.comment_ws
            entry[key] = new
        else:
            entry[key] = value


def _checked(before: str, after: str, wanted: dict[str, Any]) -> str:
    """`after`, if it says just what is wanted. Raises ProjectError."""
    after = in_its_lines(before, after)
    if same_toml(after, wanted):
        return after
    shown: dict[str, Any] = {key: wanted[key] for key in ("model", "controller", "analysis") if key in wanted}
    raise ProjectError(
        "this cannot be written into the form that the project file has; make the change by hand, so that it says:\n"
        f"{to_toml(shown)}"
    )
