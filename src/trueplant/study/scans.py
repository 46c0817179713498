"""Controllers that scan faster than the record: what they do between two samples is not in the data."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING

from trueplant.identify import OutputEstimate

if TYPE_CHECKING:
    from trueplant.study.pipeline import Study
    from trueplant.study.project_parts import Controller


def faster_scan(study: Study) -> bool:
    """Does a declared controller write OP more often than it was recorded?"""
    return any(True for _ in _faster_laws(study))


def without_hidden_dynamics(study: Study, i: int, found: OutputEstimate) -> OutputEstimate:
    """The estimate of output i without dynamics where derivative action turns noise into OP between the samples.

    What the controller then does within a sample looks like a plant without dead time, and no residual shows it.
    """
    name = study.project.output_names[i]
    if not any(law.output == name and (law.Td or law.Kd) for law in _faster_laws(study)):
        return found
    reason = (
        "the controller scans faster than the record, and its derivative action answers noise between the samples: "
        "export the record at the controller's scan"
    )
    names = [n for spec in found.row.specs for n in spec.structure.names]
    moved = {k: reason for k, n in enumerate(names) if not n.startswith(("gain", "slope"))}
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
