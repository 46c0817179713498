"""A light a loop: does its set-point move enough to learn from? What `check` says, in a word, a symbol and a colour."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any, Literal

from trueplant.app import levels
from trueplant.result import Check, Code, ExperimentData, SetpointMoves

Look = Literal["good", "doubt", "bad"]


@dataclass(frozen=True)
class Light:
    """Of one loop."""

    look: Look
    symbol: str
    words: str
    told: str
    """Moves, their sizes and the noise, or why there is no answer."""

    def to_dict(self) -> dict[str, Any]:
        """Of a page."""
        return asdict(self)


def light_of(found: Check, record: ExperimentData, output: str) -> Light:
    """The light of the loop of this output in one record."""
    if record.refused is not None:
        return Light("bad", "✗", "record cannot be used", record.refused)
    if record.loop == "open":
        return _open(record)
    moves = next((one for one in record.setpoints if one.signal == output), None)
    if moves is None:
        return Light("bad", "✗", "no set-point is named", "Choose the column of the set-point on the page Tags.")
    if moves.moves == 0:
        return Light("bad", "✗", "set-point never moves", moves.message)
    still = next((one for one in found.reasons if one.code == Code.NO_EXCITATION), None)
    if still is not None:
        return Light("bad", "✗", "set-points move too little", f"{moves.message} {_sentence(still.message)}")
    if moves.always:
        told = f"{moves.message} A master controller may move it; then it moves nothing from outside."
        return Light("doubt", "?", "set-point changes all the time", told)
    if _small(moves):
        return Light("doubt", "?", "moves are small against the noise", moves.message)
    return Light("good", "✓", "set-point moves enough", moves.message)


def _small(moves: SetpointMoves) -> bool:
    return moves.largest is not None and moves.largest < levels.SMALL_MOVE * moves.noise


def _open(record: ExperimentData) -> Light:
    signals = record.excitation.signals if record.excitation is not None else ()
    told = ", ".join(f"{one.signal} changes {one.changes} times" for one in signals)
    if any(one.changes for one in signals):
        return Light("good", "✓", "OP moves, in open loop", f"{told}.")
    return Light("bad", "✗", "OP never moves", "In open loop someone has to move OP.")


def _sentence(text: str) -> str:
    return f"{text[:1].upper()}{text[1:]}."
