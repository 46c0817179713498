"""Which of the proposals is recommended, and why."""

from __future__ import annotations

from typing import Any

import pytest

from trueplant.loop import PID, Controller
from trueplant.study.loops.recommendation import reason_of
from trueplant.tune import Proposal

BARE = Controller.diagonal([PID(Kc=1.0, Ti=10.0)])
ASKED = {"Ms": 1.59, "share": 0.95, "mu": None}


def judged(share: float, load: float, mu: float | None = None, noise: float = 1.0) -> dict[tuple[int, int], Any]:
    plant = {"stable": True, "load": {"iae": load}, "noise": {"op_variation": noise}}
    return {(0, 0): {"metrics": {"plant": plant}, "drawn": {"share_all": share, "mu_share": mu}}}


def proposed(*methods: str) -> list[Proposal]:
    return [Proposal(m, BARE, (True,), ("",), (None,)) for m in methods]


@pytest.mark.parametrize(
    ("found", "today", "asked", "expected", "words"),
    [
        # ours first, although another has less error
        (
            {"certain-share": judged(0.97, 5.0), "simc": judged(0.96, 4.0)},
            judged(0.5, 8.0),
            ASKED,
            "certain-share",
            "-38 %",
        ),
        # the least error among those that hold
        (
            {"simc": judged(0.96, 6.0), "amigo": judged(0.99, 7.0), "imc": judged(0.9, 2.0)},
            judged(0.5, 8.0),
            ASKED,
            "simc",
            "",
        ),
        # nothing holds
        ({"simc": judged(0.9, 4.0)}, judged(0.5, 8.0), ASKED, None, "90 %"),
        # today holds, and there is little to win
        ({"certain-share": judged(0.97, 7.5)}, judged(0.99, 8.0), ASKED, None, "keep them"),
        # calmer than today's, which does not hold: the error may rise
        ({"certain-share": judged(0.97, 9.0)}, judged(0.2, 8.0), ASKED, "certain-share", "+12 %"),
        # a limit on mu counts like the other
        ({"certain-share": judged(0.97, 5.0, 0.5)}, judged(0.5, 8.0, 0.5), {**ASKED, "mu": 1.0}, None, "no proposal"),
        ({"certain-share": judged(0.97, 5.0, 0.96)}, judged(0.99, 8.0, 0.5), {**ASKED, "mu": 1.0}, "certain-share", ""),
        # what is no PID only where nothing else was asked for
        ({"lqg": judged(1.0, 2.0), "simc": judged(0.96, 6.0)}, judged(0.5, 8.0), ASKED, "simc", ""),
        ({"lqg": judged(1.0, 2.0)}, judged(0.5, 8.0), ASKED, "lqg", ""),
        ({"simc": judged(0.96, 6.0, noise=4.0)}, judged(0.5, 8.0), ASKED, "simc", "4 times as much"),
    ],
)
def test_the_recommendation(found, today, asked, expected, words):
    method, why = reason_of(proposed(*found), found, today, [(0, 0)], asked)
    assert method == expected
    assert words in why
