"""A first project file, guessed from the column names of a data file."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import tomlkit
from tomlkit.items import Comment, Item

from trueplant.errors import DataError
from trueplant.project.levels import SHOWN_COLUMNS

# What the last (or first) part of a tag means, in the words of the usual control systems. MV is OP on a Yokogawa.
_KINDS = {
    "sp": {"sp", "sv", "setpoint", "ref", "reference", "target", "soll", "r"},
    "pv": {"pv", "meas", "measurement", "measured", "ist", "y", "temp"},
    "op": {"op", "mv", "out", "output", "co", "u", "valve", "stell", "heater"},
    "mode": {"mode", "auto", "automatic"},
}
_TIME = {"t", "time", "timestamp", "datetime", "date", "date time", "zeit", "datum", "tijd", "times"}
_ISA = re.compile(r"^([a-z]d?)[ircty]{1,3}$")
_SPLIT = re.compile(r"[._/\\:\-\s]+|(?<=[A-Za-z])(?=\d)|(?<=\d)(?=[A-Za-z])")

_INTRODUCTION = (
    "Guessed by trueplant init from the column names. Check every line with the word CHECK, then:",
    "    trueplant check THIS_FILE     what of the data can be used",
    "    trueplant run THIS_FILE       what changed in the plant, and how surely",
)
_TIME_UNITS = 'CHECK: of every time constant and dead time: "ms", "s", "min", "h" or "d"'
_ABOUT_THE_MODEL = "The model: put yours in place of the 0. With 0 the element is found from the data alone."
_ABOUT_CONTROLLERS = "The controllers, if their tuning is known: they allow a second, independent answer."

Line = Comment | tuple[str, Any]
"""A line of a table: a comment, or a key and its value."""


@dataclass(frozen=True)
class Loop:
    """The columns of one control loop, as far as they were recognised."""

    key: str
    pv: str
    op: str
    sp: str | None = None
    mode: str | None = None


def guess_loops(columns: Sequence[str]) -> list[Loop]:
    """Loops among the columns: ``sp1 op1 pv1``, ``FIC101.SP FIC101.MV FIC101.PV``, ``set-point``, ``pv`` and so on."""
    found: dict[str, dict[str, str]] = {}
    for column in columns:
        kind, key = _kind(column)
        if kind is not None:
            found.setdefault(key, {}).setdefault(kind, column)
    loops = [
        Loop(key, names["pv"], names["op"], names.get("sp"), names.get("mode"))
        for key, names in found.items()
        if {"pv", "op"} <= names.keys()
    ]
    return loops


def _kind(column: str) -> tuple[str | None, str]:
    parts = [part for part in _SPLIT.split(column.strip()) if part]
    joined = [part.lower() for part in parts]
    for at in (len(parts) - 1, 0, len(parts) - 2):
        if not 0 <= at < len(parts):
            continue
        for kind, words in _KINDS.items():
            if joined[at] in words:
                return kind, _key(joined[:at] + joined[at + 1 :])
    # "set-point 1" and "set_point" fall apart into two words
    if "set" in joined and "point" in joined:
        return "sp", " ".join(part for part in joined if part not in ("set", "point"))
    return None, ""


def _key(parts: Sequence[str]) -> str:
    """What the tags of one loop share: TI 101, TT 101 and TIC 101 are one loop, by the letters of ISA-5.1."""
    after = [*parts[1:], ""][: len(parts)]
    return " ".join(_ISA.sub(r"\1ic", p) if n.isdigit() else p for p, n in zip(parts, after, strict=True))


def guess_time(columns: Sequence[str]) -> str:
    """The column of the time: by its name, else the first one that belongs to no loop."""
    for column in columns:
        if column.strip().lower().split("[")[0].split("(")[0].strip() in _TIME:
            return column
    return next((column for column in columns if _kind(column)[0] is None), columns[0])


def guess_project(file: str, columns: Sequence[str], units: Mapping[str, str] | None = None) -> str:
    """The text of a commented project file for ``file``, whose columns these are.

    Nothing is known of the model, so every element is to be identified, as first order with dead time. Names may hold
    any character: tomlkit quotes them. Raises DataError if no pair of a PV and an OP is among the columns, or if the
    name of the file is not Unicode, as TOML must be.
    """
    if any("\ud800" <= character <= "\udfff" for character in file):
        raise DataError(f"{file!r}: a name that is not Unicode cannot stand in a project file: rename the file")
    columns = [column for column in columns if column]
    loops = guess_loops(columns)
    if not loops:
        raise DataError(
            f"{file}: no pair of PV and OP was recognised among its columns ({', '.join(columns[:SHOWN_COLUMNS])}): "
            f"name them like pv1 and op1, or like FIC101.PV and FIC101.OP, or write the project file by hand"
        )
    names, units = _names(loops), units or {}
    controllers = [_commented_out(_controller(output, input_)) for output, input_ in names]
    sections = [
        _section("", *map(tomlkit.comment, _INTRODUCTION)),
        _section("", ("time_unit", _noted("s", 6, _TIME_UNITS))),
        _section("[data]", *_data(file, columns, loops)),
        *(_section("[[output]]", *_output(loop, name, units)) for loop, (name, _) in zip(loops, names, strict=True)),
        *(_section("[[input]]", *_input(loop, name, units)) for loop, (_, name) in zip(loops, names, strict=True)),
        _section("", tomlkit.comment(_ABOUT_THE_MODEL)),
        *(_section("[[model]]", *_element(output, input_)) for output, _ in names for _, input_ in names),
        _section("", tomlkit.comment(_ABOUT_CONTROLLERS)) + "\n".join(controllers),
    ]
    return "\n".join(sections)


def _names(loops: Sequence[Loop]) -> list[tuple[str, str]]:
    """Names of the output and the input of each loop, no two alike: y1 and u1, or fic101_pv and fic101_op."""
    names = []
    seen: set[str] = set()
    for k, loop in enumerate(loops, 1):
        stem = loop.key.replace(" ", "") or str(k)
        if stem in seen:
            stem = f"{stem}_{k}"
        seen.add(stem)
        numbered = not loop.key or loop.key.isdigit()
        names.append((f"y{stem}", f"u{stem}") if numbered else (f"{stem}_pv", f"{stem}_op"))
    return names


def _data(file: str, columns: Sequence[str], loops: Sequence[Loop]) -> Iterator[Line]:
    time = guess_time(columns)
    used = {time, *(c for loop in loops for c in (loop.pv, loop.op, loop.sp, loop.mode) if c)}
    # a line break in a name would end the comment
    spare = [column if column.isprintable() else repr(column) for column in columns if column not in used]
    yield "files", [file]
    yield "time", _noted(time, 6, "CHECK: numbers in the time unit above, or timestamps")
    yield tomlkit.comment('time_unit = "s"                    # if the column counts in another unit')
    yield tomlkit.comment("exclude = [{from = 0, to = 100}]   # stretches to leave out")
    if spare:
        yield tomlkit.comment(f"columns not used: {', '.join(spare)}")


def _output(loop: Loop, name: str, units: Mapping[str, str]) -> Iterator[Line]:
    yield "name", name
    yield "pv", loop.pv
    yield ("sp", loop.sp) if loop.sp else tomlkit.comment('sp = "..."      # no set-point was recognised')
    yield _unit(units.get(loop.pv))
    yield tomlkit.comment("limits = [0, 100]   # the instrument's range")


def _input(loop: Loop, name: str, units: Mapping[str, str]) -> Iterator[Line]:
    yield "name", name
    yield "op", loop.op
    yield _unit(units.get(loop.op))
    yield tomlkit.comment("limits = [0, 100]   # CHECK: where OP saturates; such samples are treated with care")
    if loop.mode:
        yield "mode", loop.mode
        yield tomlkit.comment('automatic_values = [1, "AUTO"]   # what the mode says in automatic')


def _unit(unit: str | None) -> Line:
    return ("unit", unit) if unit else tomlkit.comment('unit = "..."        # not known from the file')


def _element(output: str, input_: str) -> Iterator[Line]:
    yield "output", output
    yield "input", input_
    yield "tf", _noted("0", 16, 'such as "1.2 exp(-3 s)/(20 s + 1)"')
    yield "structure", "fopdt"


def _controller(output: str, input_: str) -> str:
    return _section(
        "[[controller]]",
        ("input", input_),
        ("output", output),
        ("form", _noted("ideal", 8, "ideal, series or parallel")),
        ("Kc", 1.0),
        ("Ti", 60.0),
        ("action", _noted("reverse", 4, "reverse: OP rises when PV falls")),
    )


def _section(header: str, *lines: Line) -> str:
    """The text of one table of the project; without a header, of what stands outside of tables."""
    body = tomlkit.document()
    for line in lines:
        if isinstance(line, Comment):
            body.add(line)
        else:
            body.add(*line)
    return f"{header}\n{tomlkit.dumps(body)}".lstrip("\n")


def _noted(value: str, spaces: int, note: str) -> Item:
    """A value with a comment behind it."""
    item = tomlkit.item(value)
    item.comment(note)
    item.trivia.comment_ws = " " * spaces
    return item


def _commented_out(text: str) -> str:
    return "".join(f"# {line}\n" for line in text.rstrip("\n").split("\n"))
