"""Lines and tables on the terminal, whole words at any width."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from typing import Any

from rich.console import Console, RenderableType
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from trueplant.cli import levels
from trueplant.cli.folding import folded
from trueplant.printable import printable


def console() -> Console:
    """Standard output: words are wrapped on a terminal; elsewhere every line is whole."""
    on_terminal = Console(highlight=False)
    if on_terminal.is_terminal:
        return on_terminal
    return Console(highlight=False, soft_wrap=True, width=levels.PIPE_WIDTH)


def text(content: str, **style: Any) -> Text:
    """For the terminal: names and messages may hold what came with the data."""
    return Text(printable(content), **style)


def say_lines(*lines: object) -> None:
    """Print plain lines."""
    print(*(folded(printable(str(line)), sys.stdout) for line in lines), sep="\n")


Group = tuple[Text | None, Sequence[Sequence[Text]]]
"""A title, and rows of cells below it."""


def blocks(
    headings: Sequence[str], groups: Sequence[Group], right: Sequence[str], width: int
) -> Iterator[RenderableType]:
    """The headings, then each group's title with its rows below, in columns that all groups share.

    right: the headings whose columns are set to the right. Columns give way down to their longest word; where that is
    still too wide, each row is a line a cell.
    """
    rows = [row for _, found in groups for row in found]
    cells = [[text(heading, style="dim") for heading in headings], *rows]
    columns = list(zip(*cells, strict=True))
    least = [max(map(_longest_word, column)) for column in columns]
    room = width - levels.INDENT - levels.GAP * (len(columns) - 1)
    if sum(least) > room:
        for title, found in groups:
            if title is not None:
                yield title
            for row in found:
                yield from _stacked(headings, row)
        return
    widths = _fitted([max(cell.cell_len for cell in column) for column in columns], least, room)
    justify = ["right" if heading in right else "left" for heading in headings]
    yield _indented(cells[:1], widths, justify)
    for title, found in groups:
        if title is not None:
            yield title
        yield _indented(found, widths, justify)


def _stacked(headings: Sequence[str], row: Sequence[Text]) -> Iterator[RenderableType]:
    """A line for each cell that says something, the first one not as far in."""
    told = [(heading, cell) for heading, cell in zip(headings, row, strict=True) if cell.plain.strip()]
    for k, (heading, cell) in enumerate(told):
        named = text(f"{heading}: ", style="dim") if heading else text("")
        yield Padding(named + cell, (0, 0, 0, levels.INDENT * (1 if k == 0 else 2)), expand=False)


def _indented(rows: Sequence[Sequence[Text]], widths: Sequence[int], justify: Sequence[Any]) -> RenderableType:
    table = Table.grid(padding=(0, levels.GAP, 0, 0), pad_edge=False)
    for size, side in zip(widths, justify, strict=True):
        table.add_column(width=size, justify=side)
    for row in rows:
        table.add_row(*row)
    return Padding(table, (0, 0, 0, levels.INDENT), expand=False)


def _longest_word(cell: Text) -> int:
    return max((Text(word).cell_len for word in cell.plain.split()), default=0)


def _fitted(widths: Sequence[int], least: Sequence[int], room: int) -> list[int]:
    """The widths, made smaller where most can be given until all fit, none below its least."""
    fitted = list(widths)
    for _ in range(sum(widths) - room):
        most = max(range(len(fitted)), key=lambda k: fitted[k] - least[k])
        if fitted[most] <= least[most]:
            break
        fitted[most] -= 1
    return fitted
