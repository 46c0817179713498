"""Which of the proposals is recommended, and why."""

from __future__ import annotations

from dataclasses import replace

import pytest

from trueplant.loop import PID, Controller
from trueplant.result import DrawnShares, LoopMetrics, MetricsOfBoth
from trueplant.result.controllers import BeforeAfter, MsQuantiles, MuPeak, NoiseMetrics, StepResponseMetrics
from trueplant.result.recommendation_words import Outlook, recommendation_sentence
from trueplant.result.trade_off import shown, trade_off, trade_off_words
from trueplant.study.loops.recommendation import Judged, Limits, recommend
from trueplant.tune import Proposal

BARE = Controller.diagonal([PID(Kc=1.0, Ti=10.0)])
UNCHANGED = Limits(Ms=1.59, share=0.95, mu=None, sound=2.0)
ASKED = Limits(Ms=1.59, share=0.95, mu=None)
WITH_MU = Limits(Ms=1.59, share=0.95, mu=1.0)


def judged(
    share: float, load: float, mu: float | None = None, noise: float = 1.0, peak: float | None = None, ms: float = 1.5
) -> Judged:
    """mu: the share below its limit; peak: its own value, by default on the side of the limit that the share says."""
    own = None if mu is None else (peak or (0.7 if mu > 0.9 else 1.2))
    loop = LoopMetrics(
        stable=True,
        mu=None if own is None else MuPeak(own, own, 1.0),
        load=StepResponseMetrics(iae=load, itae=1.0, ise=1.0, total_variation=1.0, settling=1.0),
        noise=NoiseMetrics(pv_std=1.0, op_std=1.0, op_variation=noise),
    )
    drawn = DrawnShares(1000, 0, share, share, 1.0, MsQuantiles(1.3, 1.4, ms), mu)
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
    recommendation = recommend(proposed(*found), found, today, {(0, 0): "u"}, asked, "min")
    assert recommendation.method == expected
    assert words in recommendation_sentence(recommendation)


def said(found, today, asked):
    return recommend(proposed(*found), found, today, {(0, 0): "u"}, asked, "min")


@pytest.mark.holds("study.WORTH_A_CHANGE")
def test_an_unchanged_plant_with_sound_margins_is_left_alone():
    """Ms of 1.8 holds no limit of 1.59: only on a plant that has changed is that a reason to calm the loop."""
    found, today = {"certain-share": judged(0.97, 9.0)}, judged(0.2, 8.0, ms=1.8)
    kept = said(found, today, UNCHANGED)
    assert kept.outlook is Outlook.KEEP_UNCHANGED and kept.method is None
    assert "not found changed" in recommendation_sentence(kept)
    assert said(found, today, ASKED).method == "certain-share"
    # neither is it left alone close to instability, nor where a tenth and more can be had
    assert said(found, judged(0.2, 8.0, ms=2.1), UNCHANGED).method == "certain-share"
    assert said({"certain-share": judged(0.97, 7.1)}, today, UNCHANGED).method == "certain-share"
    assert said({"certain-share": judged(0.97, 7.3)}, today, UNCHANGED).method is None


@pytest.mark.holds("study.MORE_OVERSHOOT")
def test_overshoot_and_settling_do_not_pay_for_a_load_step_on_an_unchanged_plant():
    def with_step(one: Judged, overshoot: float, settling: float) -> Judged:
        loop = one.metrics[0, 0].plant
        step = StepResponseMetrics(1.0, 1.0, 1.0, total_variation=1.0, settling=settling, overshoot=overshoot)
        loop = replace(loop, setpoint=step)
        return Judged({(0, 0): MetricsOfBoth(loop, loop)}, one.drawn)

    today = with_step(judged(1.0, 8.0), 0.07, 8.0)
    cases = ((0.1, 8.5, "simc"), (0.14, 8.5, None), (0.25, 8.5, None), (0.1, 14.0, None))
    for overshoot, settling, expected in cases:
        found = {"simc": with_step(judged(1.0, 5.0), overshoot, settling)}
        assert said(found, today, UNCHANGED).method == expected
        # what has changed is tuned anew
        assert said(found, today, ASKED).method == "simc"


@pytest.mark.holds("study.MORE_PEAK", "study.WORTH_MARGIN")
def test_margin_does_not_pay_for_a_load_step_on_an_unchanged_plant():
    def with_peak(iae: float, Ms: float) -> Judged:
        one = judged(1.0, iae)
        loop = replace(one.metrics[0, 0].plant, Ms=Ms)
        return Judged({(0, 0): MetricsOfBoth(loop, loop)}, one.drawn)

    today = with_peak(8.0, 1.40)
    cases = ((5.0, 1.30, "simc"), (5.0, 1.44, "simc"), (5.0, 1.47, None), (5.0, 1.52, None), (3.9, 1.52, "simc"))
    for iae, Ms, expected in cases:
        assert said({"simc": with_peak(iae, Ms)}, today, UNCHANGED).method == expected
        assert said({"simc": with_peak(iae, Ms)}, today, ASKED).method == "simc"


def test_a_trade_off_rounds_each_number_by_its_own_size():
    assert shown(BeforeAfter(46.4, 1.52)) == "46 -> 1.52"
    assert shown(BeforeAfter(1644.0, 57.0)) == "1644 -> 57"
    assert shown(BeforeAfter(1.301, 1.299)) == "stays 1.30"
    assert shown(BeforeAfter(0.084, 0.187), 100) == "8 -> 19"
    moves = LoopMetrics(True, noise=NoiseMetrics(pv_std=1.0, op_std=1.0, op_variation=2.0))
    assert trade_off_words(trade_off("u", moves, moves), "min") == "noise moves OP as much"


def test_mu_decides_where_it_is_limited():
    today = judged(1.0, 8.0, 0.0, peak=1.43)
    found = {"certain-share": judged(1.0, 4.0, 0.96, peak=0.95), "mu": judged(1.0, 9.0, 1.0, peak=0.72)}
    assert said(found, today, WITH_MU).method == "mu"
    # a larger mu than today's is never recommended, whatever the error of a load step
    today = judged(0.9, 8.0, 0.97, peak=0.8)
    found = {"certain-share": judged(1.0, 4.0, 0.97, peak=0.85)}
    none = said(found, today, WITH_MU)
    assert none.method is None and none.outlook is Outlook.NO_BETTER
    assert "larger mu than today" in recommendation_sentence(none)


def test_a_smaller_mu_is_said_to_be_that_where_none_holds():
    today = judged(1.0, 8.0, 0.0, peak=1.5)
    found = {"certain-share": judged(1.0, 4.0, 0.0, peak=1.6), "mu": judged(1.0, 9.0, 0.3, peak=1.2)}
    less = said(found, today, WITH_MU)
    assert less.method == "mu" and less.outlook is Outlook.LESS_MU
    sentence = recommendation_sentence(less)
    assert "no proposal holds" in sentence and "mu 1.50 -> 1.20" in sentence and "30 %" in sentence
    # a tenth is the least
    assert said({"mu": judged(1.0, 9.0, 0.3, peak=1.4)}, today, WITH_MU).method is None


def test_one_loop_better_and_another_worse_is_no_gain():
    places = {(0, 0): "u", (1, 1): "v"}

    def two(first: float, second: float) -> Judged:
        one, other = judged(0.97, first), judged(0.97, second)
        return Judged(
            {(0, 0): one.metrics[0, 0], (1, 1): other.metrics[0, 0]}, {(0, 0): one.drawn[0, 0], (1, 1): one.drawn[0, 0]}
        )

    proposal = [Proposal("simc", BARE, (True, True), ("", ""), (None, None))]
    today = two(8.0, 8.0)
    assert recommend(proposal, {"simc": two(4.0, 8.7)}, today, places, ASKED).method == "simc"
    assert recommend(proposal, {"simc": two(4.0, 9.0)}, today, places, ASKED).method is None


def test_the_line_says_every_trade_off():
    def loop(iae, overshoot, settling, ms, moves, noise, mu):
        step = StepResponseMetrics(iae=iae, itae=1.0, ise=1.0, total_variation=moves, settling=settling)
        return LoopMetrics(
            True,
            Ms=ms,
            setpoint=replace(step, overshoot=overshoot),
            load=step,
            noise=NoiseMetrics(1.0, 1.0, noise),
            mu=MuPeak(mu, mu, 1.0),
        )

    found = trade_off("u", loop(10, 0.12, 30, 2.1, 2.0, 1.0, 1.41), loop(6.5, 0.08, 22, 1.5, 2.4, 0.5, 0.75))
    assert trade_off_words(found, "min") == (
        "error of a load step -35 %, overshoot 12 -> 8 %, settling 30 -> 22 min, Ms 2.10 -> 1.50, OP moves 1.2 times "
        "as much, noise moves OP 0.5 times as much, mu 1.41 -> 0.75"
    )
    assert trade_off_words(trade_off("u", LoopMetrics(False), LoopMetrics(True)), "min").startswith("unstable")
