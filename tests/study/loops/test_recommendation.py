"""Which of the proposals is recommended, and why."""

from __future__ import annotations

import pytest

from trueplant.loop import PID, Controller
from trueplant.result import DrawnShares, LoopMetrics, MetricsOfBoth
from trueplant.result.controllers import MsQuantiles, NoiseMetrics, StepResponseMetrics
from trueplant.result.recommendation_words import recommendation_sentence
from trueplant.study.loops.recommendation import Judged, Limits, recommend
from trueplant.tune import Proposal

BARE = Controller.diagonal([PID(Kc=1.0, Ti=10.0)])
ASKED = Limits(Ms=1.59, share=0.95, mu=None)
WITH_MU = Limits(Ms=1.59, share=0.95, mu=1.0)


def judged(share: float, load: float, mu: float | None = None, noise: float = 1.0) -> Judged:
    loop = LoopMetrics(
        stable=True,
        load=StepResponseMetrics(iae=load, itae=1.0, ise=1.0, total_variation=1.0, settling=1.0),
        noise=NoiseMetrics(pv_std=1.0, op_std=1.0, op_variation=noise),
    )
    drawn = DrawnShares(1000, 0, share, share, 1.0, MsQuantiles(1.3, 1.4, 1.5), mu)
    return Judged({(0, 0): MetricsOfBoth(loop, loop)}, {(0, 0): drawn})


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
        ({"certain-share": judged(0.97, 5.0, 0.5)}, judged(0.5, 8.0, 0.5), WITH_MU, None, "no proposal"),
        ({"certain-share": judged(0.97, 5.0, 0.96)}, judged(0.99, 8.0, 0.5), WITH_MU, "certain-share", ""),
        # what is no PID only where nothing else was asked for
        ({"lqg": judged(1.0, 2.0), "simc": judged(0.96, 6.0)}, judged(0.5, 8.0), ASKED, "simc", ""),
        ({"lqg": judged(1.0, 2.0)}, judged(0.5, 8.0), ASKED, "lqg", ""),
        ({"simc": judged(0.96, 6.0, noise=4.0)}, judged(0.5, 8.0), ASKED, "simc", "4 times as much"),
    ],
)
def test_the_recommendation(found, today, asked, expected, words):
    recommendation = recommend(proposed(*found), found, today, [(0, 0)], asked)
    assert recommendation.method == expected
    assert words in recommendation_sentence(recommendation)
