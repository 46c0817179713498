"""Controllers that scan faster than the record: what they do between two samples is not in the data."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np

from trueplant.identify import OutputEstimate, Unanswered, WhyUnanswered
from trueplant.project.law_table import Controller
from trueplant.study import levels
from trueplant.study.data.op_law import written_from_samples
from trueplant.study.study import Records


def faster_scan(records: Records) -> bool:
    """Does a declared controller write OP more often than it was recorded?"""
    return any(_faster(records, law) for _, law in _closed_laws(records))


def written_between(records: Records) -> bool:
    """Is OP written more often than it was recorded: declared so, or shown by an OP that no law at the record's own
    samples can have written?"""
    if faster_scan(records):
        return True
    for k, plan in enumerate(records.project.experiments if records.segments else ()):
        if plan.closed:
            declared = {records.project.input_names.index(law.input): law.sample_time for law in plan.controllers}
            for j in range(len(records.project.inputs)):
                if declared.get(j) is None and not written_from_samples(records, k, j, levels.EXACT_LAW):
                    return True
    return False


def hidden_dynamics(records: Records) -> dict[int, WhyUnanswered]:
    """The outputs with derivative action that turns noise of PV into OP between the samples, and why that matters.

    What the controller then does within a sample looks like a plant without dead time, and no residual shows it.
    """
    project = records.project
    hidden: dict[int, WhyUnanswered] = {}
    for k, law in _closed_laws(records):
        i, j = project.output_names.index(law.output), project.input_names.index(law.input)
        if not (law.Td or law.Kd):
            continue
        if _faster(records, law):
            hidden[i] = WhyUnanswered.CONTROLLER_FASTER_THAN_RECORD
        elif law.sample_time is None and not written_from_samples(records, k, j):
            hidden.setdefault(i, WhyUnanswered.CONTROLLER_SCAN_UNDECLARED)
    return hidden


def without_hidden_dynamics(hidden: Mapping[int, WhyUnanswered], i: int, found: OutputEstimate) -> OutputEstimate:
    """The estimate of output i, its dynamics withheld where the record does not determine them."""
    if i not in hidden:
        return found
    why = Unanswered.because(hidden[i])
    return replace(found, withheld={int(k): why for k in np.flatnonzero(~found.row.is_gain)})


def _closed_laws(records: Records) -> Iterator[tuple[int, Controller]]:
    """The declared laws with the closed experiments that they wrote; none if there are no data."""
    for k, plan in enumerate(records.project.experiments if records.segments else ()):
        for law in plan.controllers if plan.closed else ():
            yield k, law


def _faster(records: Records, law: Controller) -> bool:
    return law.sample_time is not None and law.sample_time < (1 - levels.WHOLE_SCAN) * records.segments[0].h
