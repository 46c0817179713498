"""The command ``check --find``."""

from __future__ import annotations

import sys
from itertools import groupby
from pathlib import Path

from trueplant.cli.analyse import REFUSED, saying
from trueplant.cli.data import show_check
from trueplant.cli.layout import Group, blocks, console, say_lines, text
from trueplant.errors import OutputError
from trueplant.output import as_json, write_files
from trueplant.project.exclusions import all_but_usable
from trueplant.project.project import Project
from trueplant.result import Check, ExpectedGain, UsableStretch
from trueplant.result.numbers import counted, number

_BOM = b"\xef\xbb\xbf"


def find_usable(path: Path, write: bool, json: bool) -> int:
    """Rank the stretches with usable moves, and exclude all others in the project file if asked to."""
    from trueplant.tracking.find import find

    project = Project.load(path)
    with saying() as say:
        found = find(project, say)
    if json:
        sys.stdout.write(as_json(found.to_dict()))
    else:
        show_check(found)
        show_usable(found)
    if not found.usable:
        return REFUSED
    if write:
        said = _write(path, project, found)
        if not json:
            say_lines(said)
    return 0


def show_usable(found: Check) -> None:
    """The stretches with usable moves, the most worth first."""
    if not found.usable:
        return
    several, out = len(found.data) > 1, console()
    calendars = {one.name: one.calendar(found.provenance.time_unit) for one in found.data}
    headings = ("", "usable stretch", "moves", "of", "gains known alone to")
    groups: list[Group] = []
    for experiment, ranked in groupby(enumerate(found.usable, start=1), key=lambda one: one[1].experiment):
        rows = []
        for k, one in ranked:
            span = calendars[experiment].span(one.start, one.end)
            rows.append([*map(text, (str(k), span, str(one.moves), ", ".join(one.moved), _expected(one)))])
        groups.append((text(experiment) if several else None, rows))
    for line in blocks(headings, groups, ("", "moves"), out.width):
        out.print(line)
    out.print(
        text(
            "Ranked by what each adds to those above it. Standard errors are foretold from a first estimate and the "
            "recorded inputs."
        )
    )


def _expected(one: UsableStretch) -> str:
    told = [f"{e.input} -> {e.output} {_percent(e)}" for e in one.expected if e.std_error is not None]
    left = len(one.expected) - len(told)
    return ", ".join([*told, *([f"{counted(left, 'other')} hardly"] if left else [])])


def _percent(expected: ExpectedGain) -> str:
    return f"±{number(100 * (expected.std_error or 0.0) / max(abs(expected.value), 1e-300), 2)} %"


def _write(path: Path, project: Project, found: Check) -> str:
    """Exclude all but the usable stretches in the project file."""
    entries = all_but_usable(project, found)
    if not entries:
        return f"{path}: nothing to write, the rest is excluded already"
    content = project.with_exclusions(entries).to_toml().encode("utf-8")
    place = path.resolve()
    before = place.read_bytes()
    if Project.load(place).sha256 != project.sha256:
        raise OutputError(f"{path} has changed meanwhile and was left as it is; try again")
    write_files(place.parent, {place.name: (_BOM if before.startswith(_BOM) else b"") + content})
    return f"{path}: {counted(len(entries), 'stretch', 'es')} excluded; go on with: trueplant run {path}"
