"""One thing that the paper prints or claims, beside what comes out when it is computed."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

Value = float | bool | str | None | Sequence[float] | Mapping[str, float | Sequence[float]]


@dataclass(frozen=True)
class Entry:
    """One line of paper.json."""

    id: str
    what: str
    printed: str | None
    """As the paper prints it; None where it prints nothing to compare with."""
    computed: Value
    agrees: bool | None
    """None where nothing printed can be compared."""
    note: str
    """The tolerance, and where it differs, why."""

    def to_dict(self) -> dict[str, object]:
        """As a member of the list in paper.json."""
        return {key: getattr(self, key) for key in ("id", "what", "printed", "computed", "agrees", "note")}


def last_digit(printed: str) -> tuple[float, float]:
    """The number at the beginning of a printed text, and half a unit of its last digit."""
    found = re.match(r"-?\d+(?:\.(\d+))?", printed)
    if found is None:
        raise ValueError(f"{printed!r} does not begin with a number")
    return float(found[0]), 0.5 * 10.0 ** -len(found[1] or "")


def rounds_to(printed: str, computed: float) -> bool:
    """True if the computed number rounds to the printed one (a half may go either way)."""
    value, half = last_digit(printed)
    return abs(computed - value) <= half * (1 + 1e-9)


def rounded(id: str, what: str, printed: str, computed: float, note: str = "") -> Entry:
    """An entry that agrees if the computed number rounds to the printed one."""
    tolerance = "tolerance: half a unit of the last printed digit"
    said = f"{note}; {tolerance}" if note else tolerance
    return Entry(id, what, printed, computed, rounds_to(printed, computed), said)


def shown(id: str, what: str, computed: Value, note: str) -> Entry:
    """An entry for which the paper prints nothing to compare with."""
    return Entry(id, what, None, computed, None, note)
