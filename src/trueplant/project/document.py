"""A project as TOML text: written from its tables, or edited so that comments, order and formatting stay."""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Iterator, Mapping, MutableMapping, Sequence
from typing import Any

import tomlkit
from tomlkit.items import Array, InlineTable

OF_FILES = ("step", "column", "time", "sample_time", "kind", "ramp", "state_space", "gain_unit")
"""Keys of a model element that a formula in engineering units takes the place of."""
Tables = MutableMapping[str, Any]
"""A TOML document or a part of one; a tomlkit document changes its text with its values."""


def to_toml(tables: Mapping[str, Any]) -> str:
    """TOML text of nested mappings, lists and scalars; entries that are None are left out."""
    return tomlkit.dumps(_ordered(tables))


def _ordered(value: Any) -> Any:
    """Plain dictionaries and lists; in a table scalars come first, since a key after a sub-table would belong to it."""
    if isinstance(value, Mapping):
        entries = [(key, _ordered(entry)) for key, entry in value.items() if entry is not None]
        return dict(sorted(entries, key=lambda entry: _is_table(entry[1])))
    if isinstance(value, (list, tuple)):
        return [_ordered(entry) for entry in value]
    return value


def _is_table(value: Any) -> bool:
    return isinstance(value, dict) or (isinstance(value, list) and any(isinstance(entry, dict) for entry in value))


def edited(text: str, change: Callable[[Tables], None]) -> str:
    """The TOML ``text`` after ``change``, which is given the tables of each section in turn.

    Sections are edited one by one because tomlkit, given a whole file, gathers the entries of ``[[output]]`` that
    stand between those of ``[[input]]``, and the user's order would be lost.
    """
    parts = []
    for section in sections(text):
        document = tomlkit.parse(section)
        change(document)
        parts.append(tomlkit.dumps(document))
    return "".join(parts)


def sections(text: str) -> Iterator[str]:
    """The TOML ``text`` cut before each table header; joined they are the text again.

    A line inside a list or a long string may begin with ``[`` too. It is told from a header by what comes before it,
    which is not TOML by itself as long as a list or a string is open.
    """
    held = ""
    for line in text.split("\n"):
        if line.lstrip().startswith("[") and _is_toml(held):
            yield held
            held = ""
        held += f"{line}\n"
    yield held[:-1]


def _is_toml(text: str) -> bool:
    try:
        tomllib.loads(text)
    except tomllib.TOMLDecodeError:
        return False
    return True


def with_moved_paths(text: str, move: Callable[[str], str]) -> str:
    """The project ``text`` with every path replaced by ``move(path)``."""

    def change(tables: Tables) -> None:
        data, simulate = tables.get("data", {}), tables.get("simulate", {})
        files = data.get("files", [])
        for k, name in enumerate(files):
            files[k] = move(name)
        plant = simulate.get("plant")
        elements = (*_entries(tables, "model"), *(plant if isinstance(plant, list) else ()))
        for entry in (*_entries(tables, "experiment"), *data.get("exclude", []), *elements):
            for key in ("file", "step", "state_space"):
                if isinstance(entry.get(key), str):
                    entry[key] = move(entry[key])
        if isinstance(simulate.get("plant"), str) and simulate["plant"] != "model":
            simulate["plant"] = move(simulate["plant"])

    return edited(text, change)


def with_formulas(text: str, formulas: Mapping[tuple[str, str], str]) -> str:
    """The project ``text`` with other formulas at the model elements (output, input), by name.

    Elements that the text does not declare are added: at the end, or to its list where it has ``model = [...]``.
    """
    missing = dict(formulas)

    def change(tables: Tables) -> None:
        for entry in _entries(tables, "model"):
            if formula := missing.pop((entry["output"], entry["input"]), None):
                for key in OF_FILES:
                    entry.pop(key, None)
                entry["tf"] = formula
        if isinstance(model := tables.get("model"), Array):
            # model = [...] is the whole list: TOML allows no [[model]] after it
            for pair, formula in missing.items():
                model.append(_inline(_element(pair, formula)))
            missing.clear()

    text = edited(text, change)
    if missing:
        added = to_toml({"model": [_element(pair, formula) for pair, formula in missing.items()]})
        line_end = "\r\n" if "\r\n" in text else "\n"
        text = text.rstrip() + f"\n\n{added}".replace("\n", line_end)
    return text


def _element(pair: tuple[str, str], formula: str) -> dict[str, str]:
    return {"output": pair[0], "input": pair[1], "tf": formula}


def _inline(entries: Mapping[str, str]) -> InlineTable:
    table = tomlkit.inline_table()
    table.update(entries)
    return table


def _entries(tables: Tables, name: str) -> Sequence[Tables]:
    """The entries of ``[[name]]`` in a section; none in that of ``[name.key]``, where ``name`` is a table."""
    found = tables.get(name, [])
    return found if isinstance(found, list) else []
