"""What the name of a column or tag says: which loop it belongs to, and what it is there.

Names are those of ANSI/ISA-5.1 (FIC101: flow, indicating, controlling), of the usual historians and control systems,
and plain words, English and German.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Literal

Role = Literal["sp", "pv", "op", "mode"]

_WORDS: dict[Role, frozenset[str]] = {
    "sp": frozenset(("sp", "sv", "spt", "setpoint", "setpt", "ref", "reference", "target", "soll", "sollwert", "r")),
    "pv": frozenset(("pv", "meas", "measurement", "measured", "ist", "istwert", "messwert", "y", "actual")),
    "op": frozenset(
        ("op", "mv", "out", "output", "co", "u", "valve", "stell", "stellgroesse", "stellwert", "stellung", "heater")
    ),
    "mode": frozenset(("mode", "md", "modattr", "auto", "automatic", "betriebsart")),
}
"""MV is OP on a Yokogawa."""
_QUANTITIES = {
    "flow": "flow",
    "durchfluss": "flow",
    "pressure": "pressure",
    "druck": "pressure",
    "level": "level",
    "fuellstand": "level",
    "niveau": "level",
    "temperature": "temperature",
    "temp": "temperature",
    "temperatur": "temperature",
}
"""Words that name a PV where nothing better does, and the kind of its loop."""
_PHRASES = (
    ("set point", "setpoint"),
    ("process value", "pv"),
    ("process variable", "pv"),
    ("controller output", "op"),
    ("control output", "op"),
    ("manipulated variable", "op"),
    ("valve position", "op"),
)
_STATUS = frozenset(("status", "stat", "st", "qual", "quality", "q", "qc", "confidence", "qualitaet", "guete"))
_VALUE = frozenset(("cv", "value", "val", "wert", "actual", "target"))
"""What stands behind the name of a signal and says no more than that it is a value."""
_BLOCK = frozenset(("daca", "dacb", "pida", "pidb", "pid", "pid1", "regctl", "ctl", "loop", "block", "pidctl"))
"""Blocks of control systems between a tag and its parameter."""
_KINDS = {"f": "flow", "p": "pressure", "l": "level", "t": "temperature"}
"""By the first letter of a tag. PV is no tag."""
_ISA = re.compile(r"^([a-z]d?)(?:[irs]{0,2}[ct][vy]?|[irs]{1,2}|v)$")
_UMLAUTS = str.maketrans({"ä": "ae", "ö": "oe", "ü": "ue", "ß": "ss"})
_SPLIT = re.compile(r"[^a-z0-9]+|(?<=[a-z])(?=\d)|(?<=\d)(?=[a-z])")
_SPURIOUS = re.compile(r"[\[(].*?[\])]")
"""A unit behind a name."""


@dataclass(frozen=True)
class Meaning:
    """What a name says."""

    key: str
    """Of its loop: what all its signals share."""
    role: Role | None
    """None: nothing is said."""
    weak: bool = False
    """Is it only a quantity (temperature), which may be the PV of the loop?"""
    status: bool = False
    """Is it the quality of that signal?"""
    quantity: str = ""
    """The word for what is measured, where there is one: the loop of "reactor temperature" may be called "reactor"."""
    kind: str | None = None
    """flow, pressure, level, temperature or other; None where nothing is said."""
    tag: str = ""
    """The tag of the loop without areas and blocks, such as "fic101"; empty without one."""
    shorter: str = ""
    """The key where the name says twice what it is: "recycle valve output" may belong to the loop "recycle"."""


def meaning_of(name: str) -> Meaning:
    """What a column or tag is, by its name."""
    parts = _parts(name)
    status = len(parts) > 1 and parts[-1] in _STATUS
    parts = parts[:-1] if status else parts
    if len(parts) > 1 and parts[-1] in _VALUE and _place(parts[:-1]) is not None:
        parts = parts[:-1]
    found = _place(parts)
    kind, tag = _loop_of(parts, None if found is None else found[0])
    at, role = (None, None) if found is None else found
    rest = [part for k, part in enumerate(parts) if k != at]
    quantity = next((_QUANTITIES[part] for part in rest if part in _QUANTITIES), "")
    named = [part for part in rest if part not in _QUANTITIES]
    key = _key(named)
    shorter = _key([part for part in named if role is None or part not in _WORDS[role]])
    weak = role is None
    if role is None and (quantity or tag):
        role = "pv"
    return Meaning(key, role, weak, status, quantity, kind or quantity or None, tag, shorter)


def _parts(name: str) -> list[str]:
    text = _SPURIOUS.sub("", name).casefold().translate(_UMLAUTS).strip()
    text = re.sub(r"[^a-z0-9]+", " ", text)
    for phrase, word in _PHRASES:
        text = re.sub(rf"\b{phrase}\b", word, text)
    return [part for part in _SPLIT.split(text) if part]


def _place(parts: list[str]) -> tuple[int, Role] | None:
    """Where the word stands that says what a signal is: last, first, or before a number."""
    for at in dict.fromkeys((len(parts) - 1, 0, len(parts) - 2)):
        if 0 <= at < len(parts):
            for role, words in _WORDS.items():
                if parts[at] in words:
                    return at, role
    return None


def _loop_of(parts: list[str], without: int | None) -> tuple[str | None, str]:
    """The kind of loop, and its tag: letters by ISA-5.1 before a number."""
    for k in reversed(range(len(parts) - 1)):  # servers and areas come first
        letters, number = parts[k], parts[k + 1]
        if k != without and number.isdigit() and (found := _ISA.match(letters)):
            return _KINDS.get(found.group(1)[0], "other"), f"{letters}{number}"
    return None, ""


def _key(parts: list[str]) -> str:
    """What the names of one loop share: TI 101, TT 101 and TIC 101 are one loop."""
    kept = [part for part in parts if part not in _BLOCK]
    after = [*kept[1:], ""][: len(kept)]
    return " ".join(_common(p) if n.isdigit() else p for p, n in zip(kept, after, strict=True))


def _common(letters: str) -> str:
    found = _ISA.match(letters)
    return f"{found.group(1)}ic" if found else letters
