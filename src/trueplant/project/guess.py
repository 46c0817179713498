"""A first project file, guessed from the column names of a data file."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from trueplant.errors import DataError

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

    Nothing is known of the model, so every element is asked for from scratch as first order with dead time. Raises
    DataError if no pair of a PV and an OP is among the columns.
    """
    loops = guess_loops(columns)
    time = guess_time(columns)
    if not loops:
        raise DataError(
            f"{file}: no pair of PV and OP was recognised among its columns ({', '.join(columns[:20])}): name them "
            f"like pv1 and op1, or like FIC101.PV and FIC101.OP, or write the project file by hand"
        )
    used = {time, *(c for loop in loops for c in (loop.pv, loop.op, loop.sp, loop.mode) if c)}
    spare = [c for c in columns if c not in used]
    known = units or {}
    lines = [
        "# Guessed by trueplant init from the column names. Check every line with the word CHECK, then:",
        "#     trueplant check THIS_FILE     what of the data can be used",
        "#     trueplant run THIS_FILE       what changed in the plant, and how surely",
        "",
        'time_unit = "s"      # CHECK: of every time constant and dead time: "ms", "s", "min", "h" or "d"',
        "",
        "[data]",
        f"files = [{_text(file)}]",
        f"time = {_text(time)}      # CHECK: numbers in the time unit above, or timestamps",
        '# time_unit = "s"                    # if the column counts in another unit',
        "# exclude = [{from = 0, to = 100}]   # stretches to leave out",
    ]
    if spare:
        lines.append(f"# columns not used: {', '.join(spare)}")
    for k, loop in enumerate(loops, 1):
        lines += ["", "[[output]]", f"name = {_text(_output(loop, k))}", f"pv = {_text(loop.pv)}"]
        lines.append(f"sp = {_text(loop.sp)}" if loop.sp else '# sp = "..."      # no set-point was recognised')
        lines.append(_unit(known.get(loop.pv)))
        lines.append("# limits = [0, 100]   # the instrument's range")
    for k, loop in enumerate(loops, 1):
        lines += ["", "[[input]]", f"name = {_text(_input(loop, k))}", f"op = {_text(loop.op)}"]
        lines.append(_unit(known.get(loop.op)))
        lines.append("# limits = [0, 100]   # CHECK: where OP saturates; such samples are treated with care")
        if loop.mode:
            lines += [
                f"mode = {_text(loop.mode)}",
                '# automatic_values = [1, "AUTO"]   # what the mode says in automatic',
            ]
    lines += ["", "# The model: put yours in place of the 0. With 0 the element is found from the data alone."]
    for i, row in enumerate(loops, 1):
        for j, column in enumerate(loops, 1):
            lines += ["", "[[model]]", f"output = {_text(_output(row, i))}", f"input = {_text(_input(column, j))}"]
            lines += ['tf = "0"                # such as "1.2 exp(-3 s)/(20 s + 1)"', 'structure = "fopdt"']
    lines += ["", "# The controllers, if their tuning is known: they allow a second, independent answer."]
    for k, loop in enumerate(loops, 1):
        lines += ["# [[controller]]", f"# input = {_text(_input(loop, k))}", f"# output = {_text(_output(loop, k))}"]
        lines += ['# form = "ideal"        # ideal, series or parallel', "# Kc = 1.0", "# Ti = 60.0"]
        lines += ['# action = "reverse"    # reverse: OP rises when PV falls', ""]
    return "\n".join(lines).rstrip() + "\n"


def _output(loop: Loop, k: int) -> str:
    return loop.key.replace(" ", "") + "_pv" if loop.key and not loop.key.isdigit() else f"y{loop.key or k}"


def _input(loop: Loop, k: int) -> str:
    return loop.key.replace(" ", "") + "_op" if loop.key and not loop.key.isdigit() else f"u{loop.key or k}"


def _unit(unit: str | None) -> str:
    return f"unit = {_text(unit)}" if unit else '# unit = "..."        # not known from the file'


def _text(text: str) -> str:
    return json.dumps(text, ensure_ascii=False)
