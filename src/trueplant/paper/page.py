"""paper.html: one file that opens offline, in the report's style."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from string import ascii_lowercase

from trueplant.paper import figures, levels
from trueplant.paper.compute import Paper
from trueplant.paper.entry import Entry, Value
from trueplant.paper.records import KINDS, STEP_TIMES
from trueplant.report.frame import Book, Drawn, frame
from trueplant.report.levels import MOST_ROWS
from trueplant.report.numbers import number
from trueplant.report.page import environment
from trueplant.version import __version__

Legend = tuple[tuple[str, str], ...]
MU: Legend = (
    ("model", "model"),
    ("plant", "plant, 1.1014 as (34) prints it"),
    ("setpoint", "plant, 1.0137 as (37) implies"),
)

COLUMNS = ("median_error", "rms_error", "bound", "rms_over_bound", "coverage", "median_error_of_route")
HEADINGS = (
    "Parameter",
    "Ours, median error (%)",
    "Ours, rms error (%)",
    "Cramér-Rao bound (%)",
    "rms over bound",
    "Share of 95 % intervals that hold the truth",
    "Paper's route, median error (%)",
)


@dataclass(frozen=True)
class Chapter:
    """A section of the page: figures in groups under a legend, then a table of entries."""

    id: str
    title: str
    text: str
    groups: tuple[tuple[Legend, tuple[Drawn, ...]], ...]
    entries: tuple[Entry, ...]
    numbers: tuple[tuple[str, tuple[str, ...], list[list[str]]], ...] = ()
    """Tables of numbers: caption, headings, rows."""


def render(paper: Paper) -> str:
    """The page as HTML text: no file or address outside of it is needed."""
    book = Book()
    chapters = (_equations(paper), _mill(paper, book), _splitter(paper, book), _seeds(paper, book))
    compared = [e for e in paper.entries if e.agrees is not None]
    template = environment("trueplant.paper", "trueplant.report").get_template("paper.html.j2")
    page = template.render(
        chapters=chapters,
        compared=len(compared),
        agreeing=sum(e.agrees is True for e in compared),
        entries=len(paper.entries),
        differing=[e for e in compared if e.agrees is False],
        value=value,
        noted=noted,
        version=__version__,
        most_rows=MOST_ROWS,
        **frame(book),
    )
    return page + "\n"


def noted(entries: Sequence[Entry], apart: bool) -> tuple[list[tuple[str, str]], list[tuple[Entry, str | None]]]:
    """What several notes of a table say, once and with a letter, and each entry with what its own note says besides.

    The note is None for a difference, which the table of the differences, `apart`, explains.
    """
    clauses = {e.id: re.split(r"; |\. (?=[A-Z])", e.note) if e.note else [] for e in entries}
    holders: dict[str, list[str]] = {}
    for e in entries:
        for clause in clauses[e.id]:
            holders.setdefault(clause, []).append(e.id)
    together: dict[tuple[str, ...], list[str]] = {}
    for clause, ids in holders.items():
        if len(ids) >= levels.OFTEN and len(clause) >= levels.LONG_CLAUSE:
            together.setdefault(tuple(ids), []).append(clause)
    remarks = [(letter, "; ".join(said)) for letter, said in zip(ascii_lowercase, together.values(), strict=False)]
    letters = {clause: letter for (letter, _), said in zip(remarks, together.values(), strict=False) for clause in said}
    rows: list[tuple[Entry, str | None]] = []
    for e in entries:
        own = ""
        for clause in (c for c in clauses[e.id] if c not in letters):
            own += f"{'. ' if clause[0].isupper() else '; '}{clause}" if own else clause
        marks = dict.fromkeys(f"[{letters[clause]}]" for clause in clauses[e.id] if clause in letters)
        told = e.agrees is False and not apart
        rows.append((e, None if told else " ".join(filter(None, [own, *marks]))))
    return remarks, rows


def value(computed: Value) -> str:
    """A computed value as text."""
    if computed is None:
        return "–"
    if isinstance(computed, bool):
        return "yes" if computed else "no"
    if isinstance(computed, str):
        return computed
    if isinstance(computed, int | float):
        return number(float(computed), 5)
    if isinstance(computed, Sequence):
        return ", ".join(number(float(x)) for x in computed)
    return "; ".join(f"{key.replace('_', ' ')} {value(part)}" for key, part in computed.items())


def _equations(paper: Paper) -> Chapter:
    text = (
        "Each side of an equation is computed by itself, on the mill of section 3 at 9 frequencies, for two "
        "experiments with random r and v. The signals come from the two equations of the loop, not from the paper's "
        "algebra."
    )
    return Chapter("equations", "Section 2 and Appendix A: the expression", text, (), tuple(paper.equations))


def _mill(paper: Paper, book: Book) -> Chapter:
    mill = paper.mill
    four = book.add(
        figures.figure_4(mill),
        "Figure 4: robust performance test",
        f"mu of the model peaks at {number(mill.nominal.RP.upper)} at {number(mill.nominal.RP.frequency)} rad/min. "
        f"The suprema of the plant, {number(mill.perturbed['printed'].RP.upper)} and "
        f"{number(mill.perturbed['eq37'].RP.upper)}, are limits towards frequency 0. Both bounds agree to within the "
        "line.",
    )
    steps = []
    for k, what in enumerate(("particle size", "circulating load")):
        for signals, kind in (("y", "controlled"), ("u", "manipulated")):
            at = 5 + 2 * k + (signals == "u")
            title = f"Figure {at}: {kind} variables, step of the {what} set-point"
            steps.append(book.add(figures.mill_steps(mill, k, signals), title, ""))
    groups = (((*MU, ("bound", "limit of 1, or set-point")), (four,)), ((), tuple(steps)))
    text = (
        "Everything is computed twice where (34) matters: with the factor 1.1014 that it prints and with the 1.0137 "
        "that (37) implies. Figures 5 to 8 are simulated and show deviations for a unit step."
    )
    return Chapter("mill", "Section 3: the grinding mill", text, groups, tuple(mill.entries))


def _splitter(paper: Paper, book: Book) -> Chapter:
    shown = paper.records.shown
    ten = book.add(figures.figure_10(shown), "Figure 10: step test data for 5 hours", "")
    near = []
    for output, (at, what) in enumerate(((11, "top temperature"), (12, "vaporisation"))):
        start = STEP_TIMES[output] - 10
        drawn = figures.step_data(shown, output, start, start + 50)
        near.append(book.add(drawn, f"Figure {at}: step of the {what}", ""))
    last = []
    for at, element, output, step in ((13, "(1, 1)", 0, 2), (14, "(1, 2)", 0, 3), (15, "(2, 2)", 1, 3)):
        ids = [f"table5.{name}{element[1]}{element[4]}" for name in ("model", "fit")]
        fit = [e for e in paper.records.entries if e.id in ids]
        said = ", ".join(f"{'model' if '.model' in e.id else 'estimate'} {value(e.computed)} %" for e in fit)
        caption = f"One of the steps that show element {element}. Fit about all of them: {said}."
        last.append(
            book.add(figures.comparison(shown, output, STEP_TIMES[step]), f"Figure {at}: element {element}", caption)
        )
    groups = (
        (
            (
                ("measured", "PV, or OP"),
                ("setpoint", "SP; in Figures 11 and 12 the model's error"),
                ("model", "model (41)"),
                ("plant", "plant, estimated"),
            ),
            (ten,),
        ),
        ((), tuple(near)),
        ((), tuple(last)),
    )
    entries = [e for e in paper.records.entries if not e.id.startswith(("mc.", "table4.ours", "table4.route"))]
    text = (
        "The printed models are taken as they are, and the record is simulated from (40) with white noise, under "
        "Table 2 with the sign that the top temperature's controller must have."
    )
    return Chapter("splitter", "Section 4: the splitter column", text, groups, (*paper.splitter, *entries))


def _seeds(paper: Paper, book: Book) -> Chapter:
    drawn = tuple(
        book.add(
            figures.errors(paper.records.runs[kind]),
            what[0].upper() + what[1:],
            "",
        )
        for kind, what in KINDS.items()
    )
    entries = [e for e in paper.records.entries if e.id.startswith(("mc.", "table4.ours", "table4.route"))]
    legend: Legend = (
        ("bound", "Cramér-Rao bound (short lines)"),
        ("plant", "our estimate, rms (dots)"),
        ("points", "paper's route, median (crosses)"),
    )
    text = (
        f"The paper's own route (equation error, (20), reduction) and this program's estimate on the same "
        f"{paper.seeds} simulated records for each kind of noise. Row 2 of the plant has no mismatch: where the "
        "paper's route finds none it returns the model, which is the truth, and no mark is drawn. The bound of a time "
        "constant holds while errors are small."
    )
    numbers = tuple((what[0].upper() + what[1:], HEADINGS, _rows(paper, kind)) for kind, what in KINDS.items())
    return Chapter("seeds", "Table 4 over many records", text, ((legend, drawn),), tuple(entries), numbers)


def _rows(paper: Paper, kind: str) -> list[list[str]]:
    rows = []
    for e in paper.records.entries:
        if e.id.startswith(f"mc.{kind}.") and isinstance(e.computed, Mapping):
            rows.append([e.id.rsplit(".", 1)[1], *(value(e.computed[key]) for key in COLUMNS)])
    return rows


def summary(paper: Paper) -> str:
    """Two lines for the terminal."""
    compared = [e for e in paper.entries if e.agrees is not None]
    differing = [e.id for e in compared if not e.agrees]
    return (
        f"{len(paper.entries)} values computed; {len(compared)} can be compared with the print, "
        f"{len(compared) - len(differing)} agree\nnot in agreement: {', '.join(differing)}"
    )
