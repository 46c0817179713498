"""The text of a first project file."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import tomlkit
from tomlkit.items import Comment, Item

from trueplant.errors import DataError
from trueplant.project.guess import (
    Loop,
    Seen,
    guess_counted_unit,
    guess_disturbances,
    guess_loops,
    guess_time,
    guess_time_unit,
)
from trueplant.project.levels import SHOWN_COLUMNS

_INTRODUCTION = (
    "Guessed by trueplant init from the names in the data file. Look at every line with the word CHECK, then:",
    "    trueplant check THIS_FILE     what of the data can be used",
    "    trueplant run THIS_FILE       what changed in the plant, and how surely",
)
_ABOUT_THE_MODEL = (
    "The model, if there is one: an entry for each pair that it has; pairs without an entry are zero in it. Without",
    "any entry the first run looks for every pair, and writes what it finds as the first model into plant.toml.",
)
_ABOUT_CONTROLLERS = (
    "The controllers, if their tuning is known: a second, independent answer, and new settings beside today's.",
)
_ABOUT_TUNING = ("New settings on the plant that is found: take the # off, and say below how your system shows them.",)
_ABOUT_DISTURBANCES = ("Measured, and perhaps acting on the loops from outside: take the # off if they do.",)

Line = Comment | tuple[str, Any]
"""A line of a table: a comment, or a key and its value."""


def draft_project(file: str, seen: Seen) -> str:
    """The text of a commented project file for ``file``, in which these names were seen.

    Names may hold any character: tomlkit quotes them. Raises DataError if no pair of a PV and an OP is among the names,
    or if the name of the file is not Unicode, as TOML must be.
    """
    if any("\ud800" <= character <= "\udfff" for character in file):
        raise DataError(f"{file!r}: a name that is not Unicode cannot stand in a project file: rename the file")
    names = [name for name in seen.names if name]
    loops = guess_loops(name for name in names if name != seen.time)
    if not loops:
        raise DataError(
            f"{file}: no pair of PV and OP was recognised among its columns ({', '.join(names[:SHOWN_COLUMNS])}): "
            f"name them like pv1 and op1, or like FIC101.PV and FIC101.OP, or write the project file by hand"
        )
    time = seen.time or guess_time(names)
    spare = [name for name in names if name not in {time, *(c for loop in loops for c in loop.columns)}]
    outside = guess_disturbances(spare)
    called = _names(loops)
    sections = [
        _section("", *map(tomlkit.comment, _INTRODUCTION)),
        _section("", ("time_unit", _time_unit(seen))),
        _section("[data]", *_data(file, time, seen, [name for name in spare if name not in outside])),
        *(_section("[[output]]", *_output(loop, name, seen)) for loop, (name, _) in zip(loops, called, strict=True)),
        *(_section("[[input]]", *_input(loop, name, seen)) for loop, (_, name) in zip(loops, called, strict=True)),
    ]
    if outside:
        sections.append(_offered(_ABOUT_DISTURBANCES, [_disturbance(name, seen) for name in outside]))
    sections += [
        _offered(_ABOUT_THE_MODEL, [_element(called[0])]),
        _offered(_ABOUT_CONTROLLERS, [_controller(*pair) for pair in called]),
        _offered(_ABOUT_TUNING, [_section("[tuning]")]),
    ]
    return "\n".join(sections)


def _names(loops: Sequence[Loop]) -> list[tuple[str, str]]:
    """Names of the output and the input of each loop, no two alike: y1 and u1, or fic101_pv and fic101_op."""
    names = []
    seen: set[str] = set()
    for k, loop in enumerate(loops, 1):
        stem = loop.tag or loop.key.replace(" ", "") or str(k)
        numbered = stem.isdigit()
        if stem in seen:
            stem = f"{stem}_{k}"
        seen.add(stem)
        names.append((f"y{stem}", f"u{stem}") if numbered else (f"{stem}_pv", f"{stem}_op"))
    return names


def _time_unit(seen: Seen) -> Item:
    note = 'of every time constant and dead time: "ms", "s", "min", "h" or "d"'
    return _noted(guess_time_unit(seen.interval), 6, note if seen.interval else f"CHECK: {note}")


def _data(file: str, time: str, seen: Seen, spare: Sequence[str]) -> Iterator[Line]:
    yield "files", [file]
    if seen.stamped is None:
        yield "time", _noted(time, 6, "CHECK: numbers in the time unit below, or timestamps")
    else:
        yield "time", time
    if not seen.stamped and "time_unit" not in seen.said:
        unit = guess_counted_unit(time)
        yield "time_unit", unit or _noted("s", 6, "CHECK: the unit in which this column counts")
    yield from seen.said.items()
    if seen.doubt:
        yield tomlkit.comment(f"CHECK: {_in_a_line(seen.doubt)}")
    yield tomlkit.comment("exclude = [{from = 0, to = 100}]   # stretches to leave out")
    if spare:
        yield tomlkit.comment(f"not used: {', '.join(map(_in_a_line, spare))}")


def _output(loop: Loop, name: str, seen: Seen) -> Iterator[Line]:
    yield "name", name
    yield "pv", _noted(loop.pv, 6, "CHECK: by what else is there") if loop.likely else loop.pv
    yield ("sp", loop.sp) if loop.sp else tomlkit.comment('sp = "..."      # no set-point was recognised')
    if "pv" in loop.status:
        yield "status", loop.status["pv"]
    yield _unit(seen.units.get(loop.pv))
    if loop.kind:
        yield "kind", loop.kind
    yield tomlkit.comment("limits = [0, 100]   # the instrument's range")


def _input(loop: Loop, name: str, seen: Seen) -> Iterator[Line]:
    yield "name", name
    yield "op", loop.op
    if "op" in loop.status:
        yield "status", loop.status["op"]
    yield _unit(seen.units.get(loop.op))
    yield tomlkit.comment("limits = [0, 100]   # CHECK: where OP saturates; such samples are treated with care")
    if loop.mode:
        yield "mode", loop.mode
        if found := seen.modes.get(loop.mode):
            yield tomlkit.comment(_in_a_line(found))


def _in_a_line(text: str) -> str:
    """Text from a file: a line break in it would end a comment."""
    return text if text.isprintable() else repr(text)


def _unit(unit: str | None) -> Line:
    return ("unit", unit) if unit else tomlkit.comment('unit = "..."        # not known from the file')


def _disturbance(column: str, seen: Seen) -> str:
    unit = [("unit", seen.units[column])] if column in seen.units else []
    return _section("[[disturbance]]", ("name", column), ("column", column), *unit)


def _element(names: tuple[str, str]) -> str:
    return _section("[[model]]", ("output", names[0]), ("input", names[1]), ("tf", "1.2 exp(-3 s)/(20 s + 1)"))


def _controller(output: str, input_: str) -> str:
    return _section(
        "[[controller]]",
        ("input", input_),
        ("output", output),
        ("form", _noted("ideal", 8, "ideal, series or parallel; or vendor = ..., see the documentation")),
        ("gain", _noted(1.0, 12, "OP unit per PV unit; or PB = ... in per cent, with a span of output and input")),
        ("reset_minutes", _noted(1.0, 3, "or reset_seconds, repeats_per_minute")),
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


def _noted(value: str | float, spaces: int, note: str) -> Item:
    """A value with a comment behind it."""
    item = tomlkit.item(value)
    item.comment(note)
    item.trivia.comment_ws = " " * spaces
    return item


def _offered(about: Sequence[str], tables: Sequence[str]) -> str:
    """Tables that a user may take, as comments below a word about them."""
    lines = "\n".join(tables).rstrip("\n").split("\n")
    return "".join(f"# {line}".rstrip() + "\n" for line in (*about, *lines))
