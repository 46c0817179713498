"""What the published detectors say, as a terminal shows it."""

from __future__ import annotations

from collections.abc import Mapping

from trueplant.result.methods import Detection
from trueplant.result.outcome import Outcome
from trueplant.result.status import ElementVerdict

Place = tuple[str, str]


def detector_lines(result: Outcome) -> list[str]:
    """A line for each detector that was asked for: what it flags, and where that is not the verdict."""
    found = result.methods.detectors
    if not found:
        return []
    verdicts = {(e.output, e.input): e.verdict for e in result.elements}
    return ["published detectors, on which no verdict rests:", *(f"  {_line(one, verdicts)}" for one in found)]


def _line(found: Detection, verdicts: Mapping[Place, ElementVerdict]) -> str:
    if found.refused is not None:
        return f"{found.name} does not apply: {found.refused}"
    flagged = {(e.output, e.input): e.kind for e in found.elements if e.flagged}
    said = ", ".join(_arrow(place) + (f" ({kind})" if kind else "") for place, kind in flagged.items())
    text = f"{found.name} flags {said or 'nothing'}"
    more = [place for place in flagged if verdicts.get(place) == ElementVerdict.UNCHANGED]
    tested = [(e.output, e.input) for e in found.elements]
    missed = [place for place in tested if verdicts.get(place) == ElementVerdict.CHANGED and place not in flagged]
    if not more and not missed:
        return text
    parts = [f"{', '.join(map(_arrow, more))} unchanged"] * bool(more)
    parts += [f"{', '.join(map(_arrow, missed))} changed"] * bool(missed)
    return f"{text} (verdict: {'; '.join(parts)})"


def _arrow(place: Place) -> str:
    return f"{place[1]} -> {place[0]}"
