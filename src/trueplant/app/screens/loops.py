"""Which output and which input of a project are one loop."""

from __future__ import annotations

from trueplant.project import Project
from trueplant.project.tags import meaning_of

Pair = tuple[int | None, int | None]
"""Places of an output and an input; None where a loop has none."""


def pairs_of(project: Project) -> list[Pair]:
    """By the controllers, else by their tags, else in the order of the file; what is left over stands alone."""
    outputs, inputs = list(range(len(project.outputs))), list(range(len(project.inputs)))
    found: dict[int, int] = {}

    def pair(i: int, j: int) -> None:
        if i not in found and j not in found.values():
            found[i] = j

    for law in project.controllers:
        pair(project.output_names.index(law.output), project.input_names.index(law.input))
    for i in outputs:
        key = meaning_of(project.outputs[i].pv).key
        alike = [j for j in inputs if meaning_of(project.inputs[j].op).key == key]
        if len(alike) == 1 and key:
            pair(i, alike[0])
    free = [j for j in inputs if j not in found.values()]
    for i, j in zip([i for i in outputs if i not in found], free, strict=False):
        found[i] = j
    alone: list[Pair] = [(None, j) for j in inputs if j not in found.values()]
    return [(i, found.get(i)) for i in outputs] + alone
