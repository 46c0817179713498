"""Controllers that scan faster than the record: what they do between two samples is not in the data."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING

from trueplant.identify import OutputEstimate
from trueplant.study.written import written_from_samples

if TYPE_CHECKING:
    from trueplant.study.pipeline import Study
    from trueplant.study.project_parts import Controller

EXACT = 5e-4
"""Share of OP's movement that rounding apart is left where OP was written from the recorded samples: a law that also
acts in between leaves little more, as most of what it answers to shows in the next sample."""
FASTER = (
    "the controller scans faster than the record, and its derivative action answers noise between the samples: "
    "export the record at the controller's scan"
)
UNDECLARED = (
    "no controller that scans as the record does can have written OP, and derivative action answers noise between the "
    "samples: declare the controller's scan (sample_time), or export the record faster"
)


def faster_scan(study: Study) -> bool:
    """Does a declared controller write OP more often than it was recorded?"""
    return any(_faster(study, law) for _, law in _closed_laws(study))


def written_between(study: Study) -> bool:
    """Is OP written more often than it was recorded: declared so, or shown by an OP that no law at the record's own
    samples can have written?"""
    if faster_scan(study):
        return True
    for k, plan in enumerate(study.project.experiments if study.segments else ()):
        if plan.closed:
            declared = {study.project.input_names.index(law.input): law.sample_time for law in plan.controllers}
            for j in range(len(study.project.inputs)):
                if declared.get(j) is None and not written_from_samples(study, k, j, EXACT):
                    return True
    return False


def hidden_dynamics(study: Study) -> dict[int, str]:
    """The outputs with derivative action that turns noise of PV into OP between the samples, and what to do.

    What the controller then does within a sample looks like a plant without dead time, and no residual shows it.
    """
    project = study.project
    hidden: dict[int, str] = {}
    for k, law in _closed_laws(study):
        i, j = project.output_names.index(law.output), project.input_names.index(law.input)
        if not (law.Td or law.Kd):
            continue
        if _faster(study, law):
            hidden[i] = FASTER
        elif law.sample_time is None and not written_from_samples(study, k, j):
            hidden.setdefault(i, UNDECLARED)
    return hidden


def without_hidden_dynamics(study: Study, i: int, found: OutputEstimate) -> OutputEstimate:
    """The estimate of output i without the dynamics that the record cannot tell."""
    if i not in study.hidden:
        return found
    moved = {k: study.hidden[i] for k, n in enumerate(found.row.names) if not n.startswith(("gain", "slope"))}
    return replace(found, order_dependence=moved | found.order_dependence)


def _closed_laws(study: Study) -> Iterator[tuple[int, Controller]]:
    """The declared laws with the closed experiments that they wrote; none if there are no data."""
    for k, plan in enumerate(study.project.experiments if study.segments else ()):
        for law in plan.controllers if plan.closed else ():
            yield k, law


def _faster(study: Study, law: Controller) -> bool:
    return law.sample_time is not None and law.sample_time < 0.99 * study.segments[0].h
