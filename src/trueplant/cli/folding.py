"""Plain lines on a terminal, which would break a word at its edge."""

from __future__ import annotations

import shutil
import textwrap
from typing import TextIO


def folded(line: str, stream: TextIO) -> str:
    """The line in as many as a terminal needs for whole words, the later ones two characters in.

    What goes elsewhere stays one line, and no word is broken: a path is as long as it is.
    """
    width = shutil.get_terminal_size().columns if stream.isatty() else 0
    if not width or len(line) <= width:
        return line
    indent = " " * (len(line) - len(line.lstrip()) + 2)
    return textwrap.fill(line, width, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False)
