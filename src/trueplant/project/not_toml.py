"""What is wrong with text that is not TOML, for people who have not heard of TOML: the line, and what to write."""

from __future__ import annotations

import re
import tomllib

from trueplant.printable import around

_PLACE = re.compile(r"\s*\(at (?:line (\d+), column (\d+)|end of document)\)$")
_ADVICE = (
    (r"Cannot (declare|overwrite|redefine|mutate)|Duplicate", "", "it is there twice: keep one of them"),
    ("", r"=\s*[-+]?\d+,\d", "write decimals with a point, as in 1.5"),
    (r"'\\'|hex|Unicode", r"\\", r"write / instead of \, or put the text in single quotes, as in 'C:\data\x.csv'"),
    (r"Illegal character '\\n'|Unterminated", "", "the quotes are never closed: add the closing one"),
    ("Unclosed", "", "the bracket that opens there or above is never closed: close it"),
    (r"Expected '='", "", "write it as key = value, and a comment with # before it"),
    ("Invalid value", r"=\s*[^\W\d]", 'put text in quotes, as in name = "y"'),
    ("Invalid value", r"=\s*(#|$)", "write a value behind the =, or take the line out"),
)
"""What the parser says, how the line looks, and what to do: the first that fits."""


def not_toml(error: tomllib.TOMLDecodeError, source: str, text: str) -> str:
    """The message for the TOML ``text`` of the file ``source`` that raised ``error``."""
    lines = text.replace("\r\n", "\n").split("\n")
    found = _PLACE.search(str(error))
    reason = str(error)[: found.start()] if found else str(error)
    number, column = (int(found[1]), int(found[2])) if found and found[1] else (_last(lines), 1)
    line = lines[number - 1]
    shown = around(line, min(column - 1, len(line)))[0].strip()
    fits = (what for says, looks, what in _ADVICE if re.search(says, reason) and re.search(looks, line))
    advice = next(fits, f"{reason[:1].lower()}{reason[1:]}: correct it")
    return f"{source}, line {number}: is not valid TOML: {shown} ({advice})"


def _last(lines: list[str]) -> int:
    """The number of the last line that is not empty, of which the parser only says that the text ends."""
    return max((k for k, line in enumerate(lines, 1) if line.strip()), default=1)
