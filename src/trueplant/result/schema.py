"""JSON Schema of the results, made from their classes."""

from __future__ import annotations

import dataclasses
import inspect
import json
import types
import typing
from collections.abc import Mapping
from enum import Enum
from importlib.resources import files
from typing import Any

import numpy as np

from trueplant.result.codec import FOR_THE_SHIFT, Json, hints, json_key

DIALECT = "https://json-schema.org/draft/2020-12/schema"
VERSION = 1
"""Of result.json and the other documents; a change that breaks a reader raises it, with a changelog entry."""


def schema(cls: type, title: str, left_out: tuple[str, ...] = ()) -> dict[str, Json]:
    """The schema of a document (`codec.document`) of this class, without the fields left out of it."""
    definitions: dict[str, Any] = {}
    top = _object(cls, definitions, left_out)
    headline: dict[str, Any] = {"schema": {"const": VERSION}, "headline": {"type": "string"}}
    for name in FOR_THE_SHIFT if hasattr(cls, "shift") else ():
        kind = typing.get_type_hints(getattr(cls, name).fget)["return"]
        headline[name] = _described(kind, definitions)
    return {
        "$schema": DIALECT,
        "title": title,
        **top,
        "properties": headline | top["properties"],
        "required": [*headline, *top["required"]],
        "$defs": definitions,
    }


def _object(cls: type, definitions: dict[str, Any], left_out: tuple[str, ...] = ()) -> dict[str, Any]:
    known = hints(cls)
    properties: dict[str, Any] = {}
    required: list[str] = []
    others: Any = True  # documents may grow
    for field in dataclasses.fields(cls):
        if field.name in left_out:
            continue
        described = _described(known[field.name], definitions)
        if field.metadata.get("spread"):
            others = described["additionalProperties"]
            continue
        if "none_as" in field.metadata:
            described = {"anyOf": [_without_null(described), {"const": field.metadata["none_as"]}]}
        properties[json_key(field)] = described
        if not field.metadata.get("absent") and not hasattr(cls, "json_fields"):
            required.append(json_key(field))
    found: dict[str, Any] = {"type": "object", "properties": properties, "required": required}
    if others is not True:
        found["additionalProperties"] = others
    said = inspect.getdoc(cls)
    return ({"description": said.split("\n\n")[0].replace("\n", " ")} if said else {}) | found


def _without_null(described: dict[str, Any]) -> dict[str, Any]:
    kinds = [kind for kind in described.get("anyOf", [described]) if kind != {"type": "null"}]
    return kinds[0] if len(kinds) == 1 else {"anyOf": kinds}


def _described(hint: Any, definitions: dict[str, Any]) -> dict[str, Any]:
    origin, arguments = typing.get_origin(hint), typing.get_args(hint)
    if origin in (typing.Union, types.UnionType):
        kinds = [_described(a, definitions) for a in arguments if a is not type(None)]
        if type(None) in arguments:
            kinds.append({"type": "null"})
        return {"anyOf": kinds}
    if hint is Any:
        return {}
    if origin is tuple:
        if arguments[-1] is Ellipsis:
            return {"type": "array", "items": _described(arguments[0], definitions)}
        items = [_described(a, definitions) for a in arguments]
        return {"type": "array", "prefixItems": items, "minItems": len(items), "maxItems": len(items)}
    if origin is not None and isinstance(origin, type) and issubclass(origin, Mapping):
        return {"type": "object", "additionalProperties": _described(arguments[1], definitions)}
    if origin is np.ndarray:
        return {"type": "array"}
    if dataclasses.is_dataclass(hint) and isinstance(hint, type):
        if hint.__name__ not in definitions:
            definitions[hint.__name__] = {}
            definitions[hint.__name__] = _object(hint, definitions)
        return {"$ref": f"#/$defs/{hint.__name__}"}
    if isinstance(hint, type) and issubclass(hint, Enum):
        return {"enum": [member.value for member in hint]}
    simple = {str: {"type": "string"}, bool: {"type": "boolean"}, int: {"type": "integer"}}
    # numbers that are not finite are null
    return simple.get(hint, {"type": ["number", "null"]})


def published(name: str) -> dict[str, Json]:
    """The schema of "result.json", "check.json", "compare.json" or "track.json" as it goes with the package."""
    text = files("trueplant.result").joinpath("schemas", f"{name.removesuffix('.json')}.schema.json")
    found: dict[str, Json] = json.loads(text.read_text(encoding="utf-8"))
    return found
