"""The published detectors as one table: elements down, detectors across."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from trueplant.report.loops import Cell
from trueplant.report.numbers import MISSING, number
from trueplant.result import DetectedElement, Detection, Element


@dataclass(frozen=True)
class Detected:
    """What each detector says of each element; `bad` marks a flag."""

    names: tuple[str, ...]
    """Of the detectors that apply."""
    rows: tuple[tuple[str, str, tuple[Cell, ...]], ...]
    """(element, verdict, cells) in the order of the first detector."""
    remarks: tuple[str, ...]
    """Why others do not apply, and what to know of those that do."""


def detected(entries: Sequence[Detection], elements: Sequence[Element]) -> Detected:
    """The published detectors of a result beside the verdicts on the elements."""
    verdicts = {(e.output, e.input): e.verdict for e in elements}
    ran = [entry for entry in entries if entry.refused is None]
    answers: dict[tuple[str, str], list[Cell]] = {}
    for entry in ran:
        for one in entry.elements:
            answers.setdefault((one.output, one.input), []).append(_cell(one))
    rows = tuple(
        (f"{input_} → {output}", verdicts.get((output, input_), MISSING), tuple(cells))
        for (output, input_), cells in answers.items()
    )
    remarks = [f"{e.name} does not apply: {e.refused}" for e in entries if e.refused is not None]
    remarks += [f"{e.name}: {e.note}" for e in ran if e.note]
    return Detected(tuple(e.name for e in ran), rows, tuple(remarks))


def _cell(one: DetectedElement) -> Cell:
    """The statistic against its threshold, and the kind of change where the detector names one."""
    sign = ">" if one.flagged else "≤"
    kind = f" ({one.kind})" if one.flagged and one.kind else ""
    return Cell(f"{number(one.statistic, 3)} {sign} {number(one.threshold, 3)}{kind}", one.flagged)
