"""A project as TOML text: written from its tables, or edited so that comments, order and formatting stay."""

from __future__ import annotations

import difflib
import re
import tomllib
from collections.abc import Callable, Iterator, Mapping, MutableMapping, Sequence
from typing import Any

import tomlkit
from tomlkit.items import Array, InlineTable

from trueplant.project.source_table import PATHS

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
        own, rest = _cut(section)
        document = tomlkit.parse(own)
        change(document)
        parts += [tomlkit.dumps(document), rest]
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


def same_toml(text: str, tables: Mapping[str, Any]) -> bool:
    """Is this TOML text, and does it say just this?"""
    try:
        return tomllib.loads(text) == tables
    except tomllib.TOMLDecodeError:
        return False


def with_moved_paths(text: str, move: Callable[[str], str], snapshot: str = "") -> str:
    """The project ``text`` with every path replaced by ``move(path)``, that of its ``snapshot`` too if it has one."""

    def change(tables: Tables) -> None:
        data, simulate = tables.get("data", {}), tables.get("simulate", {})
        if source := data.get("source"):
            source["snapshot"] = snapshot
            for key in [key for key in PATHS if key in source]:
                source[key] = move(source[key])
        files = data.get("files", [])
        for k, name in enumerate(files):
            files[k] = move(name)
        plant = simulate.get("plant")
        elements = (*entries(tables, "model"), *(plant if isinstance(plant, list) else ()))
        for entry in (*entries(tables, "experiment"), *data.get("exclude", []), *elements):
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
        for entry in entries(tables, "model"):
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


def with_entry(text: str, table: str, entry: Mapping[str, Any]) -> str:
    """The project ``text`` with one entry more in ``[[table]]``: behind its last one, else at the end."""
    held = [*sections(text)]
    if isinstance(tomllib.loads(text).get(table), list) and not _own(held, table):
        waiting = [entry]

        def change(tables: Tables) -> None:
            if waiting and table in tables:
                tables[table].append(_inline(waiting.pop()))

        return in_its_lines(text, edited(text, change))
    added = to_toml({table: [dict(entry)]})
    if not (own := _own(held, table)):
        return in_its_lines(text, f"{text.rstrip()}\n\n{added}")
    body, rest = _cut(held[own[-1]])
    held[own[-1]] = f"{body.rstrip()}\n\n{added}{rest}"
    return in_its_lines(text, "".join(held))


def without_entries(text: str, table: str, gone: Callable[[Mapping[str, Any]], bool]) -> str:
    """The project ``text`` without those entries of ``[[table]]`` (or ``[[data.exclude]]``), asked for one by one.

    Comments of the next entry stay; a list that becomes empty goes.
    """
    held = [*sections(text)]
    own = _own(held, table)
    if own:
        for k in own:
            found: Any = tomllib.loads(held[k])
            for part in table.split("."):
                found = found[part]
            if gone(found[0]):
                held[k] = _of_next(_cut(held[k])[1])
        return in_its_lines(text, "".join(held))
    *path, last = table.split(".")

    def change(tables: Tables) -> None:
        place = tables
        for part in path:
            place = place.get(part, {})
        if not isinstance(listed := place.get(last), list):
            return
        for k in reversed([k for k, entry in enumerate([*listed]) if gone(entry)]):
            del listed[k]
        if not listed:
            del place[last]

    return in_its_lines(text, edited(text, change))


def _own(held: Sequence[str], table: str) -> list[int]:
    """Places of the sections that are entries of ``[[table]]``."""
    header = re.compile(r"\s*\[\[\s*" + r"\s*\.\s*".join(map(re.escape, table.split("."))) + r"\s*\]\]")
    return [k for k, section in enumerate(held) if header.match(section)]


def _cut(section: str) -> tuple[str, str]:
    """A section up to its last entry, and the comments behind it, which belong to the next one."""
    lines = re.split(r"(?<=\n)", section)
    own = max((k for k, line in enumerate(lines, 1) if line.strip() and not line.lstrip().startswith("#")), default=0)
    return "".join(lines[:own]), "".join(lines[own:])


def _of_next(rest: str) -> str:
    """Of the comments behind an entry those that belong to the next one: below a blank line, if there is one."""
    lines = re.split(r"(?<=\n)", rest)
    blank = next((k for k, line in enumerate(lines) if not line.strip()), 0)
    return "".join(lines[blank:]).lstrip("\r\n")


def with_structures(text: str, structures: Mapping[tuple[str, str], str]) -> str:
    """The project ``text`` with other structures at the model elements (output, input) that name one.

    Pairs that the text does not declare are added at the end, as elements to be found.
    """
    missing = dict(structures)

    def change(tables: Tables) -> None:
        for entry in entries(tables, "model"):
            structure = missing.pop((entry["output"], entry["input"]), None)
            if structure is not None and entry.get("structure", "auto") != "auto":
                entry["structure"] = structure

    text = edited(text, change)
    more = [{"output": pair[0], "input": pair[1], "structure": structure} for pair, structure in missing.items()]
    return in_its_lines(text, f"{text.rstrip()}\n\n{to_toml({'model': more})}") if more else text


def with_old_lines(before: str, after: str, old: str, new: str) -> str:
    """The TOML text ``after`` with the lines of ``before`` that it lacks as comments where they were.

    Each begins with ``old``; what is added where nothing was is headed by the comment ``new``.
    """
    lines, changed = before.splitlines(keepends=True), after.splitlines(keepends=True)
    out: list[str] = []
    for kind, a, b, c, d in difflib.SequenceMatcher(None, lines, changed, autojunk=False).get_opcodes():
        added = changed[c:d]
        if kind == "insert":
            blank = next((k for k, line in enumerate(added) if line.strip()), 0)
            out += [*added[:blank], f"# {new}{_line_end(after)}", *added[blank:]]
            continue
        for line in lines[a:b] if kind != "equal" else ():
            indent = line[: len(line) - len(line.lstrip())] if line.strip() else ""
            out.append(f"{indent}# {old}: {line.strip()}{_line_end(before)}" if line.strip() else line)
        out += added
    return "".join(out)


def _line_end(text: str) -> str:
    return "\r\n" if "\r\n" in text else "\n"


def with_exclusions(text: str, entries: Sequence[Mapping[str, Any]]) -> str:
    """The project ``text`` with more entries in ``data.exclude``, in the form that it already has there."""
    data = tomllib.loads(text).get("data", {})
    if any(part.lstrip().startswith("[[data.exclude]]") for part in sections(text)) or not data:
        more = {"data": {"exclude": [dict(entry) for entry in entries]}}
        return in_its_lines(text, f"{text.rstrip()}\n\n{to_toml(more)}")

    waiting = list(entries)

    def change(tables: Tables) -> None:
        own = tables.get("data", {})
        if waiting and "exclude" in own:
            _add_lines(own["exclude"], waiting)
            waiting.clear()
        elif waiting and "exclude" not in data and own:
            own["exclude"] = _add_lines(tomlkit.array(), waiting, isinstance(own, InlineTable))
            waiting.clear()

    return in_its_lines(text, edited(text, change))


def _add_lines(array: Array, entries: Sequence[Mapping[str, Any]], one_line: bool = False) -> Array:
    """The array with each entry on a line of its own."""
    closed = "\n" in array.as_string()
    for entry in entries:
        if one_line:
            array.append(_inline(entry))
        else:
            array.add_line(_inline(entry))
    if not one_line and not closed:
        array.add_line(indent="")
    return array


def in_its_lines(before: str, after: str) -> str:
    """Line ends as they were."""
    return after.replace("\r\n", "\n").replace("\n", "\r\n") if "\r\n" in before else after


def _element(pair: tuple[str, str], formula: str) -> dict[str, str]:
    return {"output": pair[0], "input": pair[1], "tf": formula}


def _inline(entries: Mapping[str, Any]) -> InlineTable:
    table = tomlkit.inline_table()
    table.update(entries)
    return table


def entries(tables: Mapping[str, Any], name: str) -> list[Tables]:
    """The entries of ``[[name]]`` in a section; none in that of ``[name.key]``, where ``name`` is a table."""
    found = tables.get(name, [])
    return found if isinstance(found, list) else []
