"""The commands around the data: ``check``, ``init`` and ``simulate``."""

from __future__ import annotations

import hashlib
import os
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

from trueplant.calendar import duration
from trueplant.claims import claim
from trueplant.cli.layout import say_lines
from trueplant.errors import UsageError
from trueplant.output import as_json, write_files
from trueplant.result import Calendar, Check, Code, DataFinding, Status

REFUSED = 3
SHOWN = 3
"""Stretches of a finding that are printed."""


def check(path: Path, json: bool) -> int:
    """Say of each record what can be used and what cannot, and whether it moves enough to learn from."""
    from trueplant.cli.analyse import saying
    from trueplant.project import Project
    from trueplant.study.check import check

    with saying() as say:
        found = check(Project.load(path), say)
    if json:
        sys.stdout.write(as_json(found.to_dict()))
    else:
        show_check(found)
    return 0 if found.status == Status.OK else REFUSED


def show_check(found: Check) -> None:
    """Record by record, then what the data cannot answer."""
    unit = found.provenance.time_unit
    for record in found.data:
        calendar = record.calendar(unit)
        span = calendar.span(*record.span)
        say_lines(f"{record.name}: {record.samples} samples, {span}, one every {duration(record.sample_time, unit)}")
        if record.refused:
            say_lines(f"  cannot be used: {record.refused}")
        for name, share in record.usable_share.items():
            say_lines(f"  {name}: {100 * share:.0f} % of the samples can be used")
        for moves in record.setpoints:
            say_lines(f"  {moves.message}")
        for finding in record.findings:
            say_lines(f"  {finding.message}{_where(finding, calendar)}")
    for reason in found.reasons:
        if reason.code != Code.RECORD:
            say_lines(f"{reason.where}: {reason.message}" if reason.where else reason.message)
    for note in found.notes:
        say_lines(f"note: {note.message}")


def _where(finding: DataFinding, calendar: Calendar) -> str:
    """Where a finding is: its longest stretches in order of time, and how many more there are."""
    longest = sorted(sorted(finding.spans, key=lambda s: s[0] - s[1])[:SHOWN])
    if not longest:
        return ""
    left = len(finding.spans) - len(longest)
    places = ", ".join(calendar.span(*span) for span in longest)
    return f" {places}{f', and {left} shorter' if left else ''}."


def init(data: Path, out: Path | None, force: bool, given: Mapping[str, str | None], also: Sequence[str] = ()) -> int:
    """Write a project file for ``data`` next to it, or where ``out`` says.

    given: what `Hints.of` takes. also: more of it, as "key=value".
    """
    from trueplant.project.draft import draft_project
    from trueplant.project.hints import Hints, first_look, keys_said

    if data.suffix.lower() == ".toml":
        raise UsageError(
            f"{data} is a project file, and init writes one: give it the record (a CSV, Parquet or XLSX file), or go "
            f"on with: trueplant check {data}"
        )
    place = out or data.with_suffix(".toml")
    claim([place], [data], force)
    _, seen = first_look(data, Hints.of({**given, **keys_said(also)}))
    text = draft_project(Path(os.path.relpath(data, place.parent)).as_posix(), seen)
    write_files(place.parent, {place.name: text})
    say_lines(f"{place}: check every line with the word CHECK, then run: trueplant check {place}")
    return 0


def simulate(path: Path, out: Path | None, force: bool) -> int:
    """Write the record that the table [simulate] of a project asks for."""
    from trueplant.project.project import Project
    from trueplant.project.simulation import as_file, checked_format, simulate_record

    project = Project.load(path)
    place = out or Path(f"{path.stem}-simulated.csv")
    checked_format(place)
    claim([place], [path], force=True)
    frame = simulate_record(project)
    content = as_file(frame, place)
    claim([place], force=force, known=[hashlib.sha256(content).hexdigest()])
    write_files(place.parent, {place.name: content})
    said = f"{place}: {frame.height} samples of {', '.join(frame.columns)}"
    if place.resolve() not in [file.resolve() for file in project.files]:
        name = Path(os.path.relpath(place.resolve(), path.resolve().parent)).as_posix()
        key, where = ("file", "an [[experiment]]") if project.declared_experiments else ("files", "[data]")
        value = f'"{name}"' if key == "file" else f'["{name}"]'
        said = f"{said}; {path} does not read it: to analyse it, write {key} = {value} under {where} there"
    say_lines(said)
    return 0
