"""Results as plain Python for JSON, and back: one set of rules that writes, reads and describes (`schema`) them.

A field goes by its name; `key` gives it another (such as "from", which Python reserves), `absent` leaves it out where
it is None or empty, `spread` puts the entries of a mapping beside the other fields, and `none_as` writes something else
for None. A class whose fields depend on what it is says by `json_fields` which of them it has.
"""

from __future__ import annotations

import dataclasses
import math
import types
import typing
from collections.abc import Collection, Mapping
from datetime import date, datetime
from enum import Enum
from functools import cache
from pathlib import PurePath
from typing import Any, TypeAlias, TypeVar

import numpy as np

T = TypeVar("T")
FOR_THE_SHIFT = ("shift", "action")
"""What a result has beside its headline."""
Json: TypeAlias = "dict[str, Json] | list[Json] | str | float | int | bool | None"
"""What JSON can hold."""


def key(name: str) -> dict[str, str]:
    """Metadata of a field that has another name in JSON."""
    return {"key": name}


ABSENT: dict[str, bool] = {"absent": True}
SPREAD: dict[str, bool] = {"spread": True}


@cache
def hints(cls: type) -> dict[str, Any]:
    """The types of a class's fields."""
    return typing.get_type_hints(cls)


def json_key(field: dataclasses.Field[object]) -> str:
    """What a field is called in JSON."""
    return str(field.metadata.get("key", field.name))


def plain(value: object) -> Json:
    """``value`` as what JSON can hold: classes and mappings as dicts, arrays as lists, non-finite numbers as None.

    Raises TypeError for anything else, rather than write what nobody can read back.
    """
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return fields_of(value)
    if isinstance(value, Enum):
        return str(value.value)
    if isinstance(value, Mapping):
        return {str(name): plain(entry) for name, entry in value.items()}
    if isinstance(value, np.ndarray):
        if np.iscomplexobj(value):
            return {"re": plain(value.real), "im": plain(value.imag)}
        return plain(value.tolist())
    if isinstance(value, np.generic):
        return plain(value.item())
    if isinstance(value, (list, tuple)):
        return [plain(entry) for entry in value]
    if isinstance(value, (set, frozenset)):
        return sorted((plain(entry) for entry in value), key=str)
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, complex):
        return {"re": plain(value.real), "im": plain(value.imag)}
    if value is None or isinstance(value, (bool, int, str)):
        return value
    if isinstance(value, (datetime, date)):
        return value.isoformat()
    if isinstance(value, PurePath):
        return value.as_posix()
    raise TypeError(f"a {type(value).__name__} has no place in result.json")


def fields_of(value: object, left_out: Collection[str] = ()) -> dict[str, Json]:
    """The fields of a dataclass as plain Python, without some of them."""
    return {name: plain(entry) for name, entry in entries_of(value, left_out).items()}


def entries_of(value: object, left_out: Collection[str] = ()) -> dict[str, object]:
    """The fields of a dataclass by their names in JSON, without some of them; each entry is still as it was."""
    out: dict[str, object] = {}
    wanted = value.json_fields() if hasattr(value, "json_fields") else None
    for field in dataclasses.fields(typing.cast(Any, value)):
        entry = getattr(value, field.name)
        if field.name in left_out or (wanted is not None and field.name not in wanted):
            continue
        if field.metadata.get("spread"):
            out |= {str(name): one for name, one in entry.items()}
        elif entry is None and "none_as" in field.metadata:
            out[json_key(field)] = field.metadata["none_as"]
        elif not (field.metadata.get("absent") and _is_nothing(entry)):
            out[json_key(field)] = entry
    return out


def _is_nothing(entry: Any) -> bool:
    """None or empty; a number that is 0 is something."""
    return entry is None or (isinstance(entry, str | tuple | Mapping) and not entry)


def document(outcome: object, left_out: Collection[str] = ()) -> dict[str, Json]:
    """An outcome as plain Python (schema 1), without some of its fields; first what happened, then what was found."""
    found = fields_of(outcome, left_out)
    first = ("status", "headline", *(name for name in FOR_THE_SHIFT if hasattr(outcome, name)), "reasons", "notes")
    return {"schema": 1} | {name: found.get(name, plain(getattr(outcome, name))) for name in first} | found


def build(cls: type[T], data: object) -> T:
    """An object of a class from its plain form. What is not there takes its default; numbers that are None are NaN.

    Raises TypeError or ValueError where the data do not fit the class.
    """
    return typing.cast(T, _built(cls, data))


def _built(hint: Any, data: Any) -> Any:
    origin, arguments = typing.get_origin(hint), typing.get_args(hint)
    if origin in (typing.Union, types.UnionType):
        if data is None and type(None) in arguments:
            return None
        return _first_that_fits([a for a in arguments if a is not type(None)], data)
    if hint is Any:
        return data
    if origin is tuple:
        kinds = [arguments[0]] * len(data) if arguments[-1] is Ellipsis else arguments
        return tuple(_built(kind, entry) for kind, entry in zip(kinds, data, strict=True))
    if origin is not None and issubclass(origin, Mapping):
        return {name: _built(arguments[1], entry) for name, entry in data.items()}
    if origin is np.ndarray:
        return _array(arguments[1], data)
    if dataclasses.is_dataclass(hint) and isinstance(hint, type):
        return _object(hint, data)
    if isinstance(hint, type) and issubclass(hint, Enum):
        return hint(data)
    if hint is float:
        return math.nan if data is None else float(data)
    if isinstance(hint, type) and not isinstance(data, hint):
        raise TypeError(f"{data!r} is no {hint.__name__}")
    return data


def _first_that_fits(kinds: list[Any], data: Any) -> Any:
    for kind in kinds[:-1]:
        try:
            return _built(kind, data)
        except (TypeError, ValueError, AttributeError):
            continue
    return _built(kinds[-1], data)


def _array(dtype: Any, data: Any) -> np.ndarray[Any, Any]:
    kind = typing.get_args(dtype)[0]
    kind = typing.get_origin(kind) or kind  # NDArray[np.integer[Any]] names its width, too
    if issubclass(kind, np.complexfloating):
        return np.array(data["re"], dtype=float) + 1j * np.array(data["im"], dtype=float)
    number = float if issubclass(kind, np.floating) else int if issubclass(kind, np.integer) else bool
    return np.array(data, dtype=number)


def _object(cls: type, data: Any) -> Any:
    if not isinstance(data, Mapping):
        raise TypeError(f"{data!r} is no {cls.__name__}")
    known, given = hints(cls), {}
    fields = [f for f in dataclasses.fields(cls) if f.init]
    names = {json_key(f) for f in fields}
    for field in fields:
        if field.metadata.get("spread"):
            rest = {name: entry for name, entry in data.items() if name not in names}
            given[field.name] = _built(known[field.name], rest)
        elif json_key(field) in data:
            entry = data[json_key(field)]
            nothing = "none_as" in field.metadata and entry == field.metadata["none_as"]
            given[field.name] = None if nothing else _built(known[field.name], entry)
        elif field.default is dataclasses.MISSING and field.default_factory is dataclasses.MISSING:
            raise ValueError(f"{cls.__name__} has no {json_key(field)}")
    return cls(**given)
