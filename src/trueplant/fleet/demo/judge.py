"""The audit of the demo site beside its truth."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from trueplant.fleet.demo.truth import FINDABLE, WITHOUT, Fault, Truth
from trueplant.fleet.rank import Ranked
from trueplant.fleet.row import FAILURES, Finding, Outcome
from trueplant.result import ElementVerdict

FOUND, OTHER = "found", "something else"
SAID = (FOUND, OTHER, "nothing found", "not identifiable", "refused", "failed", "no row")
_SHOWS_AS = {
    Fault.STEP: Finding.PLANT,
    Fault.DRIFT: Finding.PLANT,
    Fault.STICKING: Finding.VALVE,
    Fault.RETUNED: Finding.CONTROLLER,
}
"""What an audit should call a fault; any finding on a loop without one is something else."""


@dataclass(frozen=True)
class Judged:
    """How many loops with which fault came to what, and how well the ranking parts them."""

    counts: Mapping[Fault, Counter[str]]
    auc: float
    """Chance that a loop with a fault that can be found stands above one without (area under the ROC curve)."""
    false_alarms: tuple[str, ...]
    missed: tuple[str, ...]
    """Loops with a fault that can be found of which nothing is said."""
    mistaken: tuple[str, ...]
    """... of which something else is said."""

    @property
    def false_share(self) -> float:
        """Of the loops without a fault."""
        without = sum(sum(self.counts[fault].values()) for fault in WITHOUT if fault in self.counts)
        return len(self.false_alarms) / max(without, 1)


def judge(truths: Sequence[Truth], loops: Sequence[Ranked]) -> Judged:
    """`loops` in the order of the ranking."""
    rows = {one.name: one for one in loops}
    said = {truth.name: _said(truth.fault, rows.get(truth.name)) for truth in truths}
    counts: dict[Fault, Counter[str]] = {}
    for truth in truths:
        counts.setdefault(truth.fault, Counter())[said[truth.name]] += 1
    place = {one.name: k for k, one in enumerate(loops)}
    last = len(loops)
    faulty = np.array([place.get(one.name, last) for one in truths if one.fault in FINDABLE])
    sound = np.array([place.get(one.name, last) for one in truths if one.fault in WITHOUT])
    above = (faulty[:, None] < sound) + 0.5 * (faulty[:, None] == sound)
    return Judged(
        counts,
        float(above.mean()) if above.size else float("nan"),
        tuple(one.name for one in truths if one.fault in WITHOUT and said[one.name] == OTHER),
        tuple(one.name for one in truths if one.fault in FINDABLE and said[one.name] not in (FOUND, OTHER)),
        tuple(one.name for one in truths if one.fault in FINDABLE and said[one.name] == OTHER),
    )


def _said(fault: Fault, one: Ranked | None) -> str:
    if one is None:
        return "no row"
    if one.row.outcome in FAILURES:
        return "failed"
    if one.row.findings:
        return FOUND if _SHOWS_AS.get(fault) in one.row.findings else OTHER
    if one.row.outcome == Outcome.REFUSED:
        return "refused"
    # part of a loop that was not answered may hide a fault
    answered = all(element.verdict != ElementVerdict.NOT_IDENTIFIABLE for element in one.row.elements)
    return "nothing found" if answered else "not identifiable"


def lines(judged: Judged) -> list[str]:
    """A table for the terminal."""
    width = max(map(len, judged.counts), default=0)
    head = " " * width + "".join(f"  {word:>16}" for word in SAID)
    body = [
        f"{fault:<{width}}" + "".join(f"  {count[word] or '-':>16}" for word in SAID)
        for fault, count in sorted(judged.counts.items(), key=lambda entry: list(Fault).index(entry[0]))
    ]
    return [
        head,
        *body,
        f"false alarms: {100 * judged.false_share:.1f} % of the loops without a fault: "
        f"{', '.join(judged.false_alarms) or 'none'}",
        f"faults not found: {', '.join(judged.missed) or 'none'}; taken for something else: "
        f"{', '.join(judged.mistaken) or 'none'}",
        f"the ranking puts faults first with AUC = {judged.auc:.3f}",
    ]
