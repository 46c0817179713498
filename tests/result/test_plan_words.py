"""What a plan says it reaches, and what is said in place of one."""

from __future__ import annotations

from dataclasses import replace

from trueplant.result.plan_words import not_worth_sentence, plan_sentence
from trueplant.result.plans import MoreData, NotWorth, PlannedMove, Settled


def test_a_plan_that_is_enough_for_the_loops_says_where_it_is_no_grade_a():
    move = PlannedMove("set-point", "y", 2.0, "degC", 60.0)
    open_one = Settled("y", "u", "gain", "degC/%", now=0.14, wanted=0.04, then=0.089)
    plan = MoreData("", (move,), 480.0, suffices=True, settles=(open_one,))
    said = plan_sentence("min", plan)
    assert "(now ±0.14), which is enough for these loops, though grade A takes ±0.04" in said
    fine = replace(plan, settles=(replace(open_one, then=0.03),))
    assert "enough for these loops" in plan_sentence("min", fine) and "grade A" not in plan_sentence("min", fine)
    modelled = replace(plan, settles=(replace(open_one, as_modelled=True),))
    assert "(now ±0.14, with times as in the model, as the record does not tell them)" in plan_sentence("min", modelled)


def test_what_to_do_instead_of_a_test_is_said():
    none = MoreData("", not_worth=NotWorth.MATTERS_LITTLE, longest=480.0)
    assert not_worth_sentence("min", none).startswith("no test is needed: ")
    long = replace(none, not_worth=NotWorth.TOO_LONG, needs=1440.0)
    for one, first in (
        (long, "a test that settles what is open would take 24 h"),
        (replace(long, needs=None), "no length"),
    ):
        said = not_worth_sentence("min", one)
        assert said.startswith(first) and "give more records together in which the set-points or OPs move" in said
