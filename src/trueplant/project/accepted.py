"""The plant that was found as the project's model, in the text of its file."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from trueplant.errors import ProjectError
from trueplant.lti import TransferFunction
from trueplant.printable import printable
from trueplant.project.document import same_toml, with_old_lines, with_structures
from trueplant.project.project import Project
from trueplant.result import Code, Element, ElementVerdict, Result

NEWS = (ElementVerdict.CHANGED, ElementVerdict.FOUND)
"""Elements whose plant takes the place of the model."""
_FORMULA = re.compile(r"""(\s*tf\s*=\s*(?:"[^"]*"|'[^']*'))[ \t]*(#.*)""")


@dataclass(frozen=True)
class Accepted:
    """The new text of a project file, and the elements whose model it changes and keeps."""

    text: str
    changed: tuple[Element, ...]
    kept: tuple[Element, ...]
    doubts: tuple[str, ...] = ()
    """What speaks against taking this plant for a model."""


def accepted(project: Project, result: Result, note: str) -> Accepted:
    """The project with the plant of the result as its model; the old lines stay as comments that begin with ``note``.

    Elements that have not changed, or are not answered, keep theirs; where no model was given, the latter go on being
    looked for.
    Raises ProjectError where the project has not the names of the result, or its text cannot be changed so.
    """
    news = tuple(e for e in result.elements if e.verdict in NEWS)
    kept = tuple(e for e in result.elements if e.verdict in (ElementVerdict.UNCHANGED, ElementVerdict.NOT_IDENTIFIABLE))
    before = project.to_toml()
    updated = project.with_model(_systems(project, result, news)).to_toml()
    updated = _without_old_words(before, with_structures(updated, _structures(project, news, kept)))
    text = with_old_lines(before, updated, f"until {printable(note)}", f"since {printable(note)}")
    if not same_toml(text, tomllib.loads(updated)):
        raise ProjectError(
            f"{project.source}: the old lines of the model cannot stand in this file as comments; write each "
            "element of the model as a [[model]] table, or go on with plant.toml"
        )
    Project.from_toml(text, Path(project.source).parent)
    doubts = tuple(f"{note.where}: {note.message}" for note in result.notes if note.code is Code.CAUSE_MOVED_MEANWHILE)
    return Accepted(text, news, kept, doubts)


def _without_old_words(before: str, updated: str) -> str:
    """The new text without the comments behind new formulas: they speak of the old ones, beside which they stay."""
    old = set(before.splitlines())
    lines = updated.splitlines(keepends=True)
    return "".join(line if line.splitlines()[0] in old else _FORMULA.sub(r"\1", line) for line in lines)


def _systems(project: Project, result: Result, news: tuple[Element, ...]) -> dict[tuple[int, int], TransferFunction]:
    assert result.plant is not None  # something has changed or was found
    assert result.uncertainty is not None
    outputs, inputs = project.output_names, (*project.input_names, *project.disturbance_names)
    found = {}
    for e in news:
        if e.output not in outputs or e.input not in inputs:
            raise ProjectError(
                f"{project.source} has no element {e.input} -> {e.output}, and the result has: name the project "
                "that was analysed with --project"
            )
        at = result.uncertainty.outputs.index(e.output), result.uncertainty.inputs.index(e.input)
        found[outputs.index(e.output), inputs.index(e.input)] = result.plant.nominal[at]
    return found


def _structures(
    project: Project, news: tuple[Element, ...], kept: tuple[Element, ...]
) -> Mapping[tuple[str, str], str]:
    """Those that the record rejected, and the elements to be looked for on where there was no model at all."""
    rejected = {(e.output, e.input): e.structure for e in news if e.rejected_structure is not None}
    declared = {(entry.output, entry.input) for entry in project.model}
    open_ones = [e for e in kept if e.verdict == ElementVerdict.NOT_IDENTIFIABLE]
    again = {(e.output, e.input): "auto" for e in open_ones} if not declared else {}
    return {pair: structure for pair, structure in rejected.items() if pair in declared} | again
