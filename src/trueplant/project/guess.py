"""Loops, time, modes and disturbances, guessed from the names and the first look at a data file."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

from trueplant.project.tags import Meaning, Role, meaning_of

_TIME = {"t", "time", "timestamp", "datetime", "date", "date time", "zeit", "datum", "zeitstempel", "tijd", "times"}
_OUTSIDE = {"feed", "ambient", "inlet", "upstream", "outdoor", "weather", "zulauf", "umgebung", "charge", "throughput"}
"""Words for what comes from outside of a loop."""


@dataclass(frozen=True)
class Seen:
    """What a data file shows of itself."""

    names: tuple[str, ...]
    """Of its columns, or of its tags if it is a long export."""
    time: str | None = None
    """The column of the time, where it was found or named."""
    stamped: bool | None = None
    """Does the time bear moments, or numbers that count? None: not known."""
    interval: float | None = None
    """Seconds from one sample to the next; None where the unit of time is not known."""
    units: Mapping[str, str] = field(default_factory=dict)
    modes: Mapping[str, str] = field(default_factory=dict)
    """By column: the values found there, and which of them count as automatic."""
    said: Mapping[str, str | float] = field(default_factory=dict)
    """Keys of [data] that have to be said for the file to be read as it was."""
    doubt: str = ""
    """What of its time is not understood."""
    zone: str | None = None
    """Of its time stamps."""
    span: str = ""
    """From when to when, in words."""
    notes: tuple[str, ...] = ()
    """What else reading had to say."""
    long: bool = False
    """Does it list tags below each other?"""


@dataclass(frozen=True)
class Loop:
    """The columns of one control loop, as far as they were recognised."""

    key: str
    pv: str
    op: str
    sp: str | None = None
    mode: str | None = None
    kind: str | None = None
    tag: str = ""
    status: Mapping[Role, str] = field(default_factory=dict)
    """By signal, the column of its quality."""
    likely: bool = False
    """Is its PV no more than likely, by a quantity or a tag?"""

    @property
    def columns(self) -> tuple[str, ...]:
        named = (self.pv, self.op, self.sp, self.mode, *self.status.values())
        return tuple(column for column in named if column)


def guess_loops(names: Iterable[str]) -> list[Loop]:
    """Loops among the columns: ``sp1 op1 pv1``, ``FIC101.SP FIC101.MV FIC101.PV``, ``set-point``, ``pv`` and so on."""
    meanings = {name: meaning_of(name) for name in names}
    by_key: dict[str, list[str]] = defaultdict(list)
    for name, meaning in meanings.items():
        if meaning.role is not None:
            by_key[meaning.key].append(name)
    for key in [key for key, members in by_key.items() if {meanings[name].role for name in members} <= {"op", "mode"}]:
        shorter = {meanings[name].shorter for name in by_key[key]}
        other = shorter.pop() if len(shorter) == 1 else key
        roles = {meanings[name].role for name in by_key.get(other, ())}
        if other != key and "pv" in roles and "op" not in roles:
            by_key[other] += by_key.pop(key)
    found = []
    for key, members in by_key.items():
        measured = {meanings[name].quantity for name in members if meanings[name].role == "pv"}
        several = len(measured - {""}) > 1
        for quantity in dict.fromkeys(meanings[name].quantity for name in members) if several else [None]:
            own = [name for name in members if quantity is None or meanings[name].quantity == quantity]
            if loop := _loop(key, {name: meanings[name] for name in own}):
                found.append(loop)
    return found


def _loop(key: str, members: Mapping[str, Meaning]) -> Loop | None:
    """The loop of these columns; None without a PV and an OP. The first counts, what is said before what is likely."""
    signals: dict[Role, str] = {}
    status: dict[Role, str] = {}
    for name, meaning in sorted(members.items(), key=lambda one: one[1].weak):
        if meaning.role is not None:
            (status if meaning.status else signals).setdefault(meaning.role, name)
    if not {"pv", "op"} <= signals.keys():
        return None
    kinds = [meaning.kind for meaning in members.values() if meaning.kind]
    tags = sorted((meaning.tag for meaning in members.values() if meaning.tag), key=len, reverse=True)
    return Loop(
        key,
        signals["pv"],
        signals["op"],
        signals.get("sp"),
        signals.get("mode"),
        kinds[0] if kinds else None,
        tags[0] if tags else "",
        {role: column for role, column in status.items() if role in ("pv", "op")},
        members[signals["pv"]].weak,
    )


def guess_time(names: Sequence[str]) -> str:
    """The column of the time: by its name, else the first one that belongs to no loop."""
    for name in names:
        if name.strip().casefold().split("[")[0].split("(")[0].strip() in _TIME:
            return name
    return next((name for name in names if meaning_of(name).role is None), names[0])


def guess_disturbances(names: Iterable[str]) -> list[str]:
    """Among columns of no loop those that look as if they acted on one: measured without an OP, or named so."""
    found = []
    for name in names:
        meaning = meaning_of(name)
        outside = _OUTSIDE & set(meaning.key.split())
        if not meaning.status and (outside or meaning.role == "pv"):
            found.append(name)
    return found


def guess_time_unit(interval: float | None) -> str:
    """The unit in which time constants of a loop sampled so often are easily read: tens of intervals."""
    if interval is None or interval < 5:
        return "s"
    return "min" if interval < 600 else "h"


def guess_counted_unit(time: str) -> str | None:
    """The unit behind the name of a time column, as in "t [s]"; None without one."""
    found = re.search(r"[\[(_/ ]\s*(ms|s|sec|seconds|min|minutes|h|hr|hours|d|days)\s*[\])]?\s*$", time.casefold())
    shown = {"sec": "s", "seconds": "s", "minutes": "min", "hr": "h", "hours": "h", "days": "d"}
    return shown.get(found.group(1), found.group(1)) if found else None
