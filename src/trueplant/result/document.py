"""An outcome as plain Python for JSON."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Collection, Mapping
from datetime import date, datetime
from pathlib import PurePath
from typing import Any

import numpy as np


def document(outcome: Any, left_out: Collection[str] = ()) -> dict[str, Any]:
    """An outcome as plain Python (schema 1), without some of its fields; first what happened, then what was found."""
    names = dict.fromkeys(["status", "headline", "reasons", "notes", *(f.name for f in dataclasses.fields(outcome))])
    return {"schema": 1} | {name: plain(getattr(outcome, name)) for name in names if name not in left_out}


def plain(value: Any) -> Any:
    """``value`` as what JSON can hold: dataclasses and mappings as dicts, arrays as lists, non-finite numbers as None.

    Raises TypeError for anything else, rather than write what nobody can read back.
    """
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {field.name: plain(getattr(value, field.name)) for field in dataclasses.fields(value)}
    if isinstance(value, Mapping):
        return {str(key): plain(entry) for key, entry in value.items()}
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, np.generic):
        return plain(value.item())
    if isinstance(value, (list, tuple)):
        return [plain(entry) for entry in value]
    if isinstance(value, (set, frozenset)):
        return sorted(plain(entry) for entry in value)
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
