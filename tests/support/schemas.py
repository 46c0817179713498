"""Writes the JSON Schemas of the results into the package: python -m support.schemas, in tests/"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import trueplant.result as results
from trueplant.result.schema import schema

FOLDER = Path(results.__file__).parent / "schemas"
SUMS = {"type": "object", "additionalProperties": {"type": "string"}, "description": "SHA-256 of the files beside it."}


def generated() -> dict[str, dict[str, Any]]:
    """The schema of each document, by file name."""
    result = schema(results.Result, "The result of an analysis by trueplant", ("curves", "plant"))
    result["properties"]["files"] = SUMS
    return {
        "result.schema.json": result,
        "check.schema.json": schema(results.Check, "What trueplant found in the data, before an analysis"),
        "compare.schema.json": schema(results.Comparison, "Two results of trueplant beside each other"),
        "track.schema.json": schema(results.Track, "A plant followed through a long record by trueplant"),
    }


def text(described: dict[str, Any]) -> str:
    return json.dumps(described, indent=1, ensure_ascii=False) + "\n"


if __name__ == "__main__":
    for name, described in generated().items():
        (FOLDER / name).write_text(text(described), encoding="utf-8")
