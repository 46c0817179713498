"""Tables on the terminal: no word is broken, at any width that holds the longest."""

from __future__ import annotations

from io import StringIO
from types import SimpleNamespace

import pytest
from rich.console import Console
from rich.text import Text

from trueplant.cli.folding import folded
from trueplant.cli.layout import blocks, say_lines
from trueplant.cli.show import legend
from trueplant.result import Code, Reason

HEADINGS = ("parameter", "model", "plant (95 % interval)", "change")
GROUPS = [
    (
        Text("a_rather_long_name_of_an_input -> an_even_longer_name_of_an_output_of_the_plant: changed, grade A"),
        [tuple(map(Text, ("gain", "-0.464", "-0.5804 ± 0.0060 degC/%", "+25.1 % *")))],
    ),
    (Text("u -> y: not identifiable"), [tuple(map(Text, ("tau1", "12.0", "its input never moves by itself", "")))]),
    (Text("u2 -> y: absent"), []),
]


def drawn(width: int) -> list[str]:
    console = Console(file=StringIO(), width=width, highlight=False)
    for line in blocks(HEADINGS, GROUPS, ("model", "change"), width):
        console.print(line)
    file = console.file
    assert isinstance(file, StringIO)
    return file.getvalue().splitlines()


@pytest.mark.parametrize("width", [56, 60, 80, 140])
def test_no_word_is_broken_and_no_line_too_long(width: int) -> None:
    lines = drawn(width)
    assert all(len(line) <= width for line in lines)
    words = {word for _, rows in GROUPS for row in rows for cell in row for word in cell.plain.split()}
    assert words <= {word for line in lines for word in line.split()}


@pytest.mark.parametrize("width", [20, 30, 40])
def test_where_columns_do_not_fit_each_cell_has_its_line(width: int) -> None:
    long = "a_temperature_with_a_long_name"
    rows = [(Text("1"), Text(f"{long}, {long}"), Text("gain ±2.1 %"))]
    console = Console(file=StringIO(), width=width + len(long), highlight=False)
    for line in blocks(("", "moved by name and unit", "known to"), [(Text("record.csv"), rows)], (), width):
        console.print(line)
    file = console.file
    assert isinstance(file, StringIO)
    said = file.getvalue()
    assert "…" not in said
    assert said.count(long) == 2
    assert "known to: gain ±2.1 %" in said


def test_columns_are_shared_and_numbers_stand_right() -> None:
    lines = [line for line in drawn(80) if line.startswith("  ")]
    head, gain, tau = lines[0], lines[1], lines[2]
    assert head.index("plant") == gain.index("-0.5804") == tau.index("its input")
    assert head.index("model") + 5 == gain.index("-0.464") + 6 == tau.index("12.0") + 4


class _Terminal(StringIO):
    def isatty(self) -> bool:
        return True


SENTENCE = "  sp1 moved 4 times, by 0.5 to 1 % (median 0.75), every 4.8 h; PV noise is 0.0511 %, rounded-off."


def test_a_sentence_is_folded_between_words_on_a_terminal_only(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "40")
    lines = folded(SENTENCE, _Terminal()).split("\n")
    assert len(lines) > 1
    assert all(len(line) <= 40 for line in lines)
    assert " ".join(lines).split() == SENTENCE.split()
    assert lines[1].startswith("    ")
    assert folded(SENTENCE, StringIO()) == SENTENCE
    assert folded(f"/a/{'long_' * 20}path", _Terminal()) == f"/a/{'long_' * 20}path"


def test_plain_lines_are_folded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "40")
    terminal = _Terminal()
    monkeypatch.setattr("sys.stdout", terminal)
    say_lines(SENTENCE)
    assert max(map(len, terminal.getvalue().splitlines())) <= 40


def test_grades_are_no_leave_to_retune_on_what_changed_during_the_record():
    moved = Reason(Code.CAUSE_MOVED_MEANWHILE, "the plant was not the same throughout the record", "y, a.csv")
    for notes, words in (((moved,), "retune on, but not what changed during the record"), ((), "retune on")):
        assert legend(SimpleNamespace(elements=[SimpleNamespace(grade="B", parameters=())], notes=notes)).endswith(
            words
        )
