"""What an audit keeps of one loop: a line an element, and what became of the loop as a whole."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from trueplant.result import Code, ElementVerdict, Result
from trueplant.result.numbers import percentage


class Outcome(StrEnum):
    """What became of a loop in an audit."""

    ANALYSED = "analysed"
    """There is a result; it may be a refusal of single elements."""
    REFUSED = "refused"
    """Its data cannot answer, for the reason beside it."""
    FAILED = "failed"
    """Its project or its data could not be read, or the program failed on it."""
    LATE = "late"
    """It was not done by the deadline."""
    KILLED = "killed"
    """The process that worked on it died, more than once."""


class Finding(StrEnum):
    """What is wrong with a loop, as far as a result says so."""

    PLANT = "plant changed"
    VALVE = "valve sticks"
    END = "valve at its end"
    CONTROLLER = "controller is not as declared"


FAILURES = frozenset({Outcome.FAILED, Outcome.LATE, Outcome.KILLED})


@dataclass(frozen=True)
class ElementRow:
    """One element of the plant."""

    output: str
    input: str
    verdict: ElementVerdict
    grade: str
    importance: float | None
    basis: str
    """Of the importance: "loop" or "open loop"."""
    change: str
    """Which parameters changed, and by how much."""
    p_adjusted: float | None
    detectable_change: float | None


@dataclass(frozen=True)
class LoopRow:
    """One loop."""

    key: str
    outcome: Outcome
    version: str
    cpu_s: float
    memory_mb: float | None
    """Highest of the process while it worked on the loop; None where the system does not say."""
    deadline_s: float
    text: str = ""
    """The verdict in a sentence, or why there is none."""
    action: str = ""
    elements: tuple[ElementRow, ...] = ()
    findings: tuple[Finding, ...] = ()
    codes: tuple[str, ...] = ()
    """Of the reasons and notes of the result."""
    used: str = ""
    """Which part of the record was analysed, where stretches were looked for."""

    def stands(self, deadline: float) -> bool:
        """Need it not be computed again?"""
        if self.outcome == Outcome.LATE:
            return self.deadline_s >= deadline
        return self.outcome in (Outcome.ANALYSED, Outcome.REFUSED)


def elements_of(result: Result) -> tuple[ElementRow, ...]:
    """A row an element."""
    return tuple(
        ElementRow(
            output=one.output,
            input=one.input,
            verdict=one.verdict,
            grade=one.grade,
            importance=one.importance.value,
            basis=one.importance.basis,
            change=", ".join(
                f"{p.name.replace('_', ' ')} {'' if p.change_percent is None else percentage(p.change_percent)}".strip()
                for p in one.parameters
                if p.changed
            ),
            p_adjusted=one.p_adjusted,
            detectable_change=one.detectable_change,
        )
        for one in result.elements
    )


def findings_of(result: Result) -> tuple[Finding, ...]:
    """What is wrong with the loops of a result."""
    found = [Finding.PLANT] if result.mismatch else []
    valves = {Code.CAUSE_VALVE_STICKING: Finding.VALVE, Code.CAUSE_VALVE_END: Finding.END}
    found += [finding for code, finding in valves.items() if any(note.code == code for note in result.notes)]
    # a controller that could not be checked has a note too, and nothing is wrong with it
    if any(check.confirmed is False for check in result.methods.controller_consistency):
        found.append(Finding.CONTROLLER)
    return tuple(found)
