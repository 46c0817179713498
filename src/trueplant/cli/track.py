"""The command ``track``."""

from __future__ import annotations

import sys
from pathlib import Path

from rich.text import Text

from trueplant.cli.analyse import REFUSED, saying
from trueplant.cli.layout import Group, blocks, console, say_lines, text
from trueplant.notebook.errands import TRACK, claim_track, track_into
from trueplant.output import prepare_output
from trueplant.project.project import Project
from trueplant.result import Calendar, Change, ElementHistory, ElementVerdict, Status, Track, TrackedElement
from trueplant.result.numbers import counted
from trueplant.result.track_words import (
    AS_A_WHOLE,
    off_words,
    refused_stretches,
    told_reasons,
    what_moved,
    word_of,
)


def track(path: Path, out: Path | None, json: bool, precision: float, force: bool) -> int:
    """Follow the plant through the record, write track.json and track.html, and say what came out."""
    project = Project.load(path)
    folder = prepare_output(out or Path(f"{path.stem}-track"))
    claim_track(project, folder, force)
    with saying() as say:
        found, written = track_into(project, folder, precision / 100, say)
    if json:
        sys.stdout.write(written[TRACK].read_text(encoding="utf-8"))
    else:
        show(found)
        say_lines(*written.values())
    return REFUSED if found.status == Status.REFUSED else 0


_STYLES = {ElementHistory.CONSTANT: "green", ElementHistory.NOT_IDENTIFIABLE: "yellow"}


def show(track: Track) -> None:
    """The headline, a table of the elements, the refused stretches and what else to know."""
    out = console()
    out.print(text(track.headline, style="bold"))
    followed = [element for element in track.elements if element.windows]
    if followed:
        for line in blocks(("when", "what changed"), [_group(e, track) for e in followed], (), out.width):
            out.print(line)
    for names, file, spans, why in refused_stretches(track):
        out.print(text(f"refused: {names}, {file}, {spans}: {why}"))
    for reason in (*told_reasons(track), *track.notes):
        out.print(text(f"{'refused' if reason in track.reasons else 'note'}: {reason.message}"))


def _group(element: TrackedElement, track: Track) -> Group:
    """An element with its history, and its changes below."""
    word = word_of(element)
    style = _STYLES.get(element.history, "bold red") if word == element.history else "bold red"
    title = text(f"{element.input} -> {element.output}: ").append(text(word, style=style))
    title.append(text(f", {counted(element.windows, 'window')}"))
    changes = [c for c in track.changes if (c.output, c.input) == (element.output, element.input)]
    rows = [_cells(c, track.calendar) for c in changes]
    said = _standing(element) or element.reason
    return title, rows or ([(Text(""), text(said))] if said else [])


def _standing(element: TrackedElement) -> str:
    """What is off the model all the time."""
    if element.standing is None or element.standing.verdict != ElementVerdict.CHANGED:
        return ""
    off = ", ".join(off_words(p) for p in element.standing.parameters if p.changed)
    return f"all the time {off or 'off the model ' + AS_A_WHOLE.format('is')}"


def _cells(change: Change, calendar: Calendar) -> tuple[Text, Text]:
    span = calendar.span(*change.interval)
    when = span if change.time is None else f"{calendar.text(change.time)} ({span})"
    return text(when), text(what_moved(change))
