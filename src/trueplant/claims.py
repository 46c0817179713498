"""Which files may be replaced: those that an earlier run wrote and nobody has changed since; what was read, never."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Collection, Iterable, Iterator
from pathlib import Path
from typing import Any

from trueplant.errors import OutputError

OPTION = "--force"


def claim(
    places: Iterable[Path], inputs: Iterable[Path] = (), force: bool = False, known: Collection[str] = ()
) -> None:
    """Raise OutputError for the first of the places that must not be written to.

    `known` are the SHA-256 sums of files that an earlier run wrote; with `force` other files are replaced as well, but
    never one of `inputs`.
    """
    read = [path for path in inputs if path.exists()]
    for place in places:
        if not place.exists():
            continue
        if any(place.samefile(path) for path in read):
            raise OutputError(f"{place} is read by this run and would be overwritten by it: name another place: --out")
        if place.is_file() and not force and sum_of(place) not in known:
            raise OutputError(
                f"{place} is there already, and no earlier run wrote it as it is: name another place with --out, or "
                f"overwrite it with {OPTION} (in Python: force=True)"
            )


def claim_pair(folder: Path, document: str, page: str, inputs: Iterable[Path] = (), force: bool = False) -> None:
    """The same for a document of an earlier run and the page that is drawn from it and bears no sum there."""
    known = known_to(folder / document)
    claim([folder / document, folder / page], inputs, force or bool(known), known)


def known_to(result: Path) -> frozenset[str]:
    """The sums of all files that a result.json (track.json, ...) speaks of, and its own; empty where it is none."""
    try:
        document = json.loads(result.read_bytes())
    except (OSError, ValueError, RecursionError):
        return frozenset()
    if not isinstance(document, dict) or "schema" not in document:
        return frozenset()
    return frozenset([*_sums(document), sum_of(result)])


def sum_of(path: Path) -> str:
    """SHA-256 of a file; empty where it is none."""
    return hashlib.sha256(path.read_bytes()).hexdigest() if path.is_file() else ""


def _sums(value: Any) -> Iterator[str]:
    """Every text in a document that has the length of a sum."""
    if isinstance(value, dict):
        for entry in value.values():
            yield from _sums(entry)
    elif isinstance(value, list):
        for entry in value:
            yield from _sums(entry)
    elif isinstance(value, str) and len(value) == 64:
        yield value
