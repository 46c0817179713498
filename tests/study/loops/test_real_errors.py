"""Settings held against the declared errors of the elements: nothing that makes them worse is recommended."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import pytest

from trueplant.loop import PID, Controller, LinearLoop
from trueplant.lti import TransferMatrix
from trueplant.project.tables import Robustness, UncertaintyNumbers
from trueplant.result import BeforeAfter
from trueplant.result.controllers import TradeOff
from trueplant.result.recommendation_words import Outlook, Recommendation, recommendation_sentence
from trueplant.study.loops import real_errors
from trueplant.study.loops.real_errors import held_against_elements
from trueplant.tune import Proposal

PLANT = TransferMatrix.of([["2 exp(-1 s)/(10 s + 1)"]], "min")
TODAY = LinearLoop(PLANT, Controller.diagonal([PID(Kc=1.0, Ti=10.0)]))
LAWS = {name: Controller.diagonal([PID(Kc=Kc, Ti=10.0)]) for name, Kc in (("a", 2.0), ("b", 3.0))}
PROPOSALS = [Proposal(name, law, (True,), ("",), (None,)) for name, law in LAWS.items()]
CHANGE = TradeOff("u", BeforeAfter(2.0, 1.0), None, None, None, None, None, None)


def study(**declared: Any) -> Any:
    return SimpleNamespace(project=SimpleNamespace(robustness=Robustness(**declared)))


ERRORS = {"elements": UncertaintyNumbers(gain_percent=10.0), "wP": "(s + 0.1)/(2 s)"}


def choose(left: Any) -> Recommendation:
    """The first that is left."""
    method = next(iter(left), None)
    return Recommendation(
        Outlook.CHANGE if method else Outlook.NO_ANSWER, 1.59, 0.97, 0.95, method, changes=(CHANGE,) if method else ()
    )


def held(
    monkeypatch: pytest.MonkeyPatch, mu: dict[float | None, float], **declared: Any
) -> tuple[Recommendation, list[str]]:
    """mu: by the gain of the controller."""

    def peak(_: Any, loop: LinearLoop) -> float:
        return mu[cast(PID, loop.controller.entries[0, 0]).Kc]

    monkeypatch.setattr(real_errors, "declared_peak", peak)
    said: list[str] = []
    judged = cast(Any, dict.fromkeys(LAWS))
    return held_against_elements(study(**declared), TODAY, PROPOSALS, judged, choose, 1.0, said.append), said


def test_what_raises_mu_gives_way_to_what_does_not(monkeypatch: pytest.MonkeyPatch) -> None:
    found, said = held(monkeypatch, {1.0: 1.6, 2.0: 1.9, 3.0: 1.2}, **ERRORS)
    assert found.method == "b"
    assert len(said) == 2  # each takes its time
    assert recommendation_sentence(found).endswith("mu 1.60 -> 1.20")


def test_nothing_is_recommended_where_all_raise_it(monkeypatch: pytest.MonkeyPatch) -> None:
    found, _ = held(monkeypatch, {1.0: 1.6, 2.0: 1.9, 3.0: 2.2}, **ERRORS)
    assert (found.method, found.changes) == (None, ())
    assert recommendation_sentence(found).endswith("has a larger mu than today's")


def test_below_the_limit_a_larger_one_may_be(monkeypatch: pytest.MonkeyPatch) -> None:
    found, _ = held(monkeypatch, {1.0: 0.5, 2.0: 0.9, 3.0: 0.4}, **ERRORS)
    assert found.method == "a"


def test_beside_wI_both_are_told_apart(monkeypatch: pytest.MonkeyPatch) -> None:
    found, _ = held(monkeypatch, {1.0: 1.6, 2.0: 1.2, 3.0: 2.2}, wI="0.1", **ERRORS)
    assert found.changes == (CHANGE,)
    assert recommendation_sentence(found).endswith("; with the errors of the elements mu 1.60 -> 1.20")


def test_without_errors_or_without_a_performance_nothing_is_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    for left_out in ERRORS:
        declared = {name: value for name, value in ERRORS.items() if name != left_out}
        found, said = held(monkeypatch, {}, **declared)
        assert found == choose(LAWS)
        assert not said
