"""Controllers that scan faster than the record: what they do between two samples is not in the data."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING

from trueplant.identify import OutputEstimate

if TYPE_CHECKING:
    from trueplant.study.pipeline import Study
    from trueplant.study.project_parts import Controller

FASTER = (
    "the controller scans faster than the record, and its derivative action answers noise between the samples: "
    "export the record at the controller's scan"
)


def faster_scan(study: Study) -> bool:
    """Does a declared controller write OP more often than it was recorded?"""
    return any(True for _ in _faster_laws(study))


def hidden_dynamics(study: Study) -> dict[int, str]:
    """The outputs with derivative action that turns noise of PV into OP between the samples, and what to do.

    What the controller then does within a sample looks like a plant without dead time, and no residual shows it.
    """
    outputs = study.project.output_names
    return {outputs.index(law.output): FASTER for law in _faster_laws(study) if law.Td or law.Kd}


def without_hidden_dynamics(study: Study, i: int, found: OutputEstimate) -> OutputEstimate:
    """The estimate of output i without the dynamics that the record cannot tell."""
    if i not in study.hidden:
        return found
    names = [n for spec in found.row.specs for n in spec.structure.names]
    moved = {k: study.hidden[i] for k, n in enumerate(names) if not n.startswith(("gain", "slope"))}
    return replace(found, order_dependence=moved | found.order_dependence)


def _faster_laws(study: Study) -> Iterator[Controller]:
    """The laws of closed experiments whose declared scan is shorter than the sample time of the record."""
    if not study.segments:
        return
    h = study.segments[0].h
    for plan in study.project.experiments:
        for law in plan.controllers if plan.closed else ():
            if law.sample_time is not None and law.sample_time < 0.99 * h:
                yield law
