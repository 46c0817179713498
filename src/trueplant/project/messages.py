"""One clear message for a mistake in a project file: the file, the line, the key, and what to do."""

from __future__ import annotations

import difflib
import re
import types
import typing
from collections.abc import Sequence
from typing import Any

from pydantic import BaseModel, ValidationError

from trueplant.project.levels import ALIKE, SHOWN_CHARACTERS

Where = tuple[str | int, ...]

_HEADER = re.compile(r"^\s*(\[\[?)\s*([^\[\]]+?)\s*\]\]?\s*(#.*)?$")
_KEY = re.compile(r"""^\s*((?:[A-Za-z0-9_-]+|"[^"]*"|'[^']*')(?:\s*\.\s*(?:[A-Za-z0-9_-]+|"[^"]*"|'[^']*'))*)\s*=""")


def message(
    error: ValidationError, model: type[BaseModel], source: str, text: str = "", file: str = "the project file"
) -> str:
    """The first mistake of ``error`` (by line where ``text``, the file's, is given), and how many more there are.

    A key that is missing comes last: one that is written wrongly may be it.

    ``file`` is what the file is called where a key stands in no table.
    """
    lines = line_numbers(text)
    found = [(_locate(item, model), item) for item in error.errors(include_url=False)]
    # A value that fits no member of a union yields one error a member: the last of the deepest says most.
    merged: dict[Where, Any] = {}
    for where, item in found:
        merged.setdefault(where, item)
    deepest = {
        where: item
        for where, item in merged.items()
        if not any(other != where and other[: len(where)] == where for other in merged)
    }
    ordered = sorted(
        deepest.items(), key=lambda entry: (entry[1]["type"] == "missing", _line(entry[0], lines) or 10**9)
    )
    where, item = ordered[0]
    line = _line(where, lines)
    place = f"{source}, line {line}" if line else source
    key = path(where)
    more = f" ({len(ordered) - 1} more after this one)" if len(ordered) > 1 else ""
    said, end, shown = _words(item, where, model, file).partition("\n")
    return f"{place}: {f'{key}: ' if key else ''}{said}{more}{end}{shown}"


def path(where: Sequence[str | int]) -> str:
    """``("model", 0, "tf")`` as ``model[1].tf``: entries are counted from 1, as people do."""
    text = ""
    for part in where:
        text += f"[{part + 1}]" if isinstance(part, int) else f".{part}" if text else part
    return text


def line_numbers(text: str) -> dict[Where, int]:
    """The line of each table header and key of a TOML text (keys of inline tables are not looked into)."""
    lines: dict[Where, int] = {}
    count: dict[Where, int] = {}
    table: Where = ()
    in_string = False
    for number, line in enumerate(text.split("\n"), 1):
        quotes = line.count('"""') + line.count("'''")
        inside, in_string = in_string, in_string != bool(quotes % 2)
        if inside:
            continue
        header = _HEADER.match(line)
        if header:
            names: Where = ()
            for name in header[2].split("."):
                names = (*names, name.strip().strip("\"'"))
                if names != _plain(header[2]) and names in count:
                    names = (*names, count[names] - 1)
            if header[1] == "[[":
                count[names] = count.get(names, 0) + 1
                table = (*names, count[names] - 1)
                lines.setdefault(names, number)
            else:
                table = names
            lines[table] = number
        elif key := _KEY.match(line):
            lines.setdefault((*table, *_plain(key[1])), number)
    return lines


def _plain(dotted: str) -> Where:
    return tuple(part.strip().strip("\"'") for part in dotted.split("."))


def line_of(where: Where, text: str) -> int | None:
    """The line of a key in a TOML text, or of the innermost table around it that has one."""
    return _line(where, line_numbers(text))


def _line(where: Where, lines: dict[Where, int]) -> int | None:
    for end in range(len(where), 0, -1):
        if where[:end] in lines:
            return lines[where[:end]]
    return None


def _locate(item: Any, model: type[BaseModel]) -> Where:
    """The path of keys at fault: pydantic's, without the names of union members and with a validator's own."""
    where: list[str | int] = []
    place: Any = model
    for part in item["loc"]:
        inner = _descend(place, part)
        if inner is not None:
            where.append(part)
            place = inner
        elif item["type"] in ("extra_forbidden", "missing") and part == item["loc"][-1]:
            where.append(part)
    return (*where, *item.get("ctx", {}).get("where", ()))


def _descend(annotation: Any, part: str | int) -> Any:
    """The annotation of what lies under the key or index ``part``, None if there is no such thing."""
    for member in _members(annotation):
        origin, arguments = typing.get_origin(member), typing.get_args(member)
        if isinstance(part, int):
            if origin in (list, tuple):
                return arguments[0]
        elif origin is dict:
            return arguments[1]
        elif isinstance(member, type) and issubclass(member, BaseModel):
            for name, info in member.model_fields.items():
                if part in (name, info.alias):
                    return info.annotation
    return None


def _members(annotation: Any) -> list[Any]:
    if typing.get_origin(annotation) in (typing.Union, types.UnionType):
        return [inner for member in typing.get_args(annotation) for inner in _members(member)]
    if typing.get_origin(annotation) is typing.Annotated:
        return _members(typing.get_args(annotation)[0])
    return [annotation]


def keys_of(model: type[BaseModel]) -> list[str]:
    """The keys that a table may have."""
    return [info.alias or name for name, info in model.model_fields.items()]


def _words(item: Any, where: Where, model: type[BaseModel], file: str) -> str:
    kind, given, context = item["type"], item["input"], item.get("ctx", {})
    if kind == "project":
        return str(item["msg"])
    if kind == "extra_forbidden":
        return f"is not a key of {_table(where, file)}: {_nearest(where, model)}"
    if kind == "missing" and isinstance(where[-1], int):
        return "is missing: a pair of numbers is needed here, as in [0, 100]"
    if kind == "missing":
        return f"is missing: add it to {_table(where, file)}"
    shown = _shown(given)
    if kind == "literal_error":
        choices = str(context.get("expected", "")).replace("'", '"')
        close = difflib.get_close_matches(str(given).lower(), re.findall(r'"([^"]+)"', choices), n=1)
        return f"must be {choices}, not {shown}" + (f': did you mean "{close[0]}"?' if close else "")
    limits = {
        "greater_than": ("gt", "above"),
        "greater_than_equal": ("ge", "at least"),
        "less_than": ("lt", "below"),
        "less_than_equal": ("le", "at most"),
    }
    if kind in limits:
        name, word = limits[kind]
        return f"must be {word} {context[name]:g}, not {shown}"
    expected = {
        "float_type": "a number",
        "int_type": "a whole number",
        "int_from_float": "a whole number",
        "bool_type": "true or false",
        "string_type": 'text in quotes, as in "name"',
        "finite_number": "a finite number",
        "list_type": "a list in brackets",
        "tuple_type": "a pair of numbers, as in [0, 100]",
        "dict_type": "a table",
        "model_type": "a table",
        "too_long": "a pair of numbers, as in [0, 100]",
        "too_short": "a list with at least one entry",
        "string_too_short": "some text",
        "datetime_type": "a number or a timestamp",
    }
    if kind in expected:
        return f"must be {expected[kind]}, not {shown}"
    return f"cannot be {shown}: {item['msg']}"


def _table(where: Where, file: str) -> str:
    above = where[:-1]
    if not above:
        return file
    if isinstance(above[-1], int):
        return f"[[{above[0]}]]" if len(above) == 2 else path(above)
    return f"[{path(above)}]"


def _nearest(where: Where, model: type[BaseModel]) -> str:
    place: Any = model
    for part in where[:-1]:
        place = _descend(place, part)
    keys = [
        key
        for member in _members(place)
        if isinstance(member, type) and issubclass(member, BaseModel)
        for key in keys_of(member)
    ]
    lowered = {key.lower(): key for key in reversed(keys)}
    close = difflib.get_close_matches(str(where[-1]).lower(), lowered, n=1, cutoff=ALIKE)
    return f'did you mean "{lowered[close[0]]}"?' if close else f"its keys are {', '.join(keys)}"


def _shown(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    text = f'"{value}"' if isinstance(value, str) else str(value)
    return text if len(text) <= SHOWN_CHARACTERS else f"{text[: SHOWN_CHARACTERS - 3]}..."
