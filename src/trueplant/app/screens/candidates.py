"""Settings that were tried, as a [[candidate]] of the project: its text, and the change of the file."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from typing import Any

from trueplant.errors import ProjectError
from trueplant.project.document import to_toml, with_entry, without_entries
from trueplant.project.law_table import FACEPLATE

OF_LAW = ("form", "vendor", "Kc", "Ti", "Td", "alpha", "Kp", "Ki", "Kd", "Tf", "tf", "gain_unit", "action", *FACEPLATE)
"""Keys of a controller that settings replace; all else is kept as it is declared."""


def candidate(text: str, input_: str, settings: Mapping[str, Any], gain_unit: str) -> dict[str, Any]:
    """The keys of the [[candidate]] of this input's controller. Raises ProjectError where it has none."""
    laws = [law for law in tomllib.loads(text).get("controller", []) if law.get("input") == input_]
    if len(laws) != 1:
        raise ProjectError(f"the project has no single [[controller]] of {input_} any more: load the page again")
    own = laws[0]
    new = {key: value for key, value in settings.items() if key in OF_LAW and value is not None}
    if not new.get("Td"):
        new.pop("alpha", None)
    if gain_unit != "engineering":
        new["gain_unit"] = gain_unit
    kept = {key: value for key, value in own.items() if key not in OF_LAW and key not in ("input", "output")}
    return {"input": input_, "output": own["output"], **new, **kept}


def as_text(entries: list[dict[str, Any]]) -> str:
    """As it would stand in a project file."""
    return to_toml({"candidate": entries}) if entries else ""


def with_candidates(text: str, entries: list[dict[str, Any]]) -> str:
    """The project with these candidates in place of those of the same loops."""
    for entry in entries:
        place = entry["input"], entry["output"]
        if "candidate" in tomllib.loads(text):
            text = without_entries(text, "candidate", lambda one, p=place: (one["input"], one["output"]) == p)  # type: ignore[misc]
        text = with_entry(text, "candidate", entry)
    return text


def with_tuning(text: str) -> str:
    """The project with an empty [tuning] table, which asks for settings; as it is where it has one."""
    if "tuning" in tomllib.loads(text):
        return text
    end = "\r\n" if "\r\n" in text else "\n"
    return f"{text.rstrip()}{end}{end}[tuning]{end}"
