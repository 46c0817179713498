"""Text from files, made fit to be looked at: nothing in it steers a terminal or turns the direction of a line."""

from __future__ import annotations

import re

_STEERING = re.compile(
    "[\x00-\x08\x0b-\x1f\x7f-\x9f"  # control characters, but for tab and line end
    "\u061c\u200e\u200f\u2028\u2029\u202a-\u202e\u2066-\u2069\ufeff"  # marks of direction, line ends of their own
    "\ud800-\udfff]"  # bytes of names that are not Unicode
)


def printable(text: str) -> str:
    r"""The text with every character that steers a terminal as an escape, such as \x1b or \u202e."""
    return _STEERING.sub(lambda found: found[0].encode("unicode_escape", "surrogatepass").decode("ascii"), text)


def escaped_json(text: str) -> str:
    r"""JSON with the same characters as JSON escapes: they stand only within its strings."""
    return _STEERING.sub(lambda found: f"\\u{ord(found[0]):04x}", text)
