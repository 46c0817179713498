"""Text from files, made fit to be looked at: nothing in it steers a terminal or turns the direction of a line."""

from __future__ import annotations

import re

_STEERING = re.compile(
    "[\x00-\x08\x0b-\x1f\x7f-\x9f"  # control characters, but for tab and line end
    "\u061c\u200e\u200f\u2028\u2029\u202a-\u202e\u2066-\u2069\ufeff"  # marks of direction, line ends of their own
    "\ud800-\udfff]"  # bytes of names that are not Unicode
)
SHOWN = "\n    "
"""Begins a line that a message shows below itself."""
_OTHER_LINE_END = re.compile(rf"\n(?!{SHOWN[1:]})")
_WINDOW = 34
"""Characters shown on each side of a place: with what is around them they fit a line of a terminal."""


def printable(text: str) -> str:
    r"""The text with every character that steers a terminal as an escape, such as \x1b or \u202e."""
    return _STEERING.sub(lambda found: found[0].encode("unicode_escape", "surrogatepass").decode("ascii"), text)


def escaped_json(text: str) -> str:
    r"""JSON with the same characters as JSON escapes: they stand only within its strings."""
    return _STEERING.sub(lambda found: f"\\u{ord(found[0]):04x}", text)


def message_lines(message: str) -> list[str]:
    r"""A message and the lines that it shows below itself; line ends of names that it holds are written as \n."""
    return printable(_OTHER_LINE_END.sub(r"\\n", message)).split("\n")


def around(text: str, at: int) -> tuple[str, int]:
    """What of a line is shown around its character ``at``, and where in it that one is."""
    first = max(0, at - _WINDOW)
    shown = "".join(c if c.isprintable() else " " for c in text[first : at + _WINDOW])
    before, after = "..." * (first > 0), "..." * (at + _WINDOW < len(text))
    return f"{before}{shown}{after}", len(before) + at - first
