"""What is said to the shift, and what is to be done first; all records are simulated."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from support.one_loop import LAG, declared, one_loop
from trueplant import Loop, Result, run
from trueplant.lti import TransferMatrix
from trueplant.report.shift import render_shift
from trueplant.result import Code, Importance, LoopRobustness, Reason, SystemPeaks
from trueplant.result.shift_words import Action

MODEL = "2 exp(-13.4 s)/(60 s + 1)"
LAW = {"Kc": 1.0, "Ti": 60.0, "sample_time": 1.0}


def said(folder, plant: str = MODEL, law: dict[str, float] | None = LAW, **of_record: float) -> Result:
    """The result of a record of this plant, held against the model."""
    simulation = one_loop(3, TransferMatrix.of([[plant]]), **of_record)
    return run(declared(folder, simulation, MODEL, law)).result


def _missed() -> dict[str, SystemPeaks]:
    """The weights are held on the model and not on the plant."""
    return {name: SystemPeaks(True, holds, None, None, None) for name, holds in (("model", True), ("plant", False))}


@pytest.mark.parametrize(
    ("plant", "words", "does"),
    [
        (MODEL, "Y answers as the model says; today's tuning is stable; no action now.", Action.NONE),
        (
            "2.6 exp(-13.4 s)/(60 s + 1)",
            r"Y answers (29|3\d) % stronger than the model says; today's tuning is still stable; no action now.",
            Action.NONE,
        ),
        (
            "2 exp(-13.4 s)/(90 s + 1)",
            r"Y answers (4|5)\d % slower than the model says; today's tuning is still stable; no action now.",
            Action.NONE,
        ),
        (
            "2 exp(-17.4 s)/(60 s + 1)",
            r"Y answers \d\.\d s later than the model says; today's tuning is still stable; no action now.",
            Action.NONE,
        ),
        (
            "5.5 exp(-13.4 s)/(60 s + 1)",
            r"Y answers 17\d % stronger than the model says; today's tuning has little margin left on it; "
            "the controllers need new settings.",
            Action.RETUNE,
        ),
    ],
)
def test_a_loop_that_changed_and_its_tuning(tmp_path, plant, words, does):
    result = said(tmp_path, plant)
    assert re.fullmatch(words, result.shift), result.shift
    assert result.action is does
    document = result.to_dict()
    assert (document["shift"], document["action"]) == (result.shift, str(does))


def test_without_a_controller_nobody_is_told_that_nothing_is_to_be_done(tmp_path):
    result = said(tmp_path, "2.6 exp(-13.4 s)/(60 s + 1)", None)
    unknown = "; whether today's tuning suits that is not known, as no controller is declared"
    # only the gain has changed: that may be the instrument's
    assert result.shift.endswith(
        f"stronger than the model says{unknown}; check the transmitter of y and the valve of u."
    )
    assert replace(result, notes=()).shift.endswith(f"stronger than the model says{unknown}.")
    assert said(tmp_path, law=None).shift == "Y answers as the model says; no action now."


def test_an_instrument_that_may_be_wrong_comes_before_new_settings(tmp_path):
    result = said(tmp_path, "2.6 exp(-13.4 s)/(60 s + 1)")
    assert isinstance(result.robustness, LoopRobustness)
    result = replace(result, notes=(), robustness=replace(result.robustness, peaks=_missed()))
    assert result.shift.endswith("; the controllers need new settings.")
    then = "first: if that is in order, the controllers need new settings."
    for code, where, first in (
        (Code.CAUSE_SENSOR_SPAN, "Y", "the transmitter of Y"),
        (Code.CAUSE_ACTUATOR_GAIN, "u", "the valve of u"),
        (Code.CAUSE_UNKNOWN, "u -> Y", "the transmitter of Y and the valve of u"),
        (Code.CAUSE_UNKNOWN, "transmitter of Y; valve of u", "the transmitter of Y and the valve of u"),
        (Code.CAUSE_UNKNOWN, "valve of u", "the valve of u"),
        (Code.CAUSE_ACTUATOR_GAIN, "steam_valve", "the steam valve"),
    ):
        doubtful = replace(result, notes=(Reason(code, "why", where),))
        assert doubtful.shift.endswith(f"; check {first} {then}")


def test_a_refusal_that_another_structure_might_end_says_so(tmp_path):
    nothing = replace(said(tmp_path, size=0.0), reasons=(Reason(Code.NOT_IDENTIFIABLE, "nothing can be told"),))
    assert nothing.shift == "These data say nothing of the plant; get more data before anything is changed."
    simple = replace(nothing, notes=(Reason(Code.UNDERMODELLED, "a richer structure predicts better", "u -> Y"),))
    assert simple.shift.endswith("; get more data, or try a richer structure of the model, before anything is changed.")


def test_a_refusal_asks_for_data(tmp_path):
    result = said(tmp_path, size=0.0)
    assert result.shift == (
        "These data say nothing of the plant (nothing moves the plant from outside, or not enough); "
        "get more data before anything is changed."
    )
    assert result.action is Action.GET_DATA


def test_a_first_model_is_named(tmp_path):
    simulation = one_loop(3, LAG)
    frame = {"t": simulation.t, "sp": simulation.r[:, 0], "op": simulation.u[:, 0], "pv": simulation.y[:, 0]}
    result = run(frame, loops=[Loop("T", pv="pv", sp="sp", op="op")], time_unit="s").result
    assert result.shift == "A first model of T was found; no action now."


def test_a_dead_time_that_the_model_does_not_have_is_worth_a_word(tmp_path):
    """It is held against the lags: against a dead time of 0 every change would be endless, or nothing."""
    simulation = one_loop(3, TransferMatrix.of([["2.6 exp(-20 s)/(60 s + 1)"]]))
    result = run(declared(tmp_path, simulation, "2/(60 s + 1)", LAW)).result
    said_now = r"Y answers (2|3)\d % stronger and (19|20) s later than the model says;"
    assert re.match(said_now, result.shift), result.shift


def test_a_valve_comes_before_tuning(tmp_path):
    result = said(tmp_path, "2.6 exp(-13.4 s)/(60 s + 1)")
    stuck = replace(result, notes=(*result.notes, Reason(Code.CAUSE_VALVE_STICKING, "the valve sticks", "u")))
    ended = replace(result, notes=(*result.notes, Reason(Code.CAUSE_VALVE_END, "the valve is at its end", "u")))
    assert stuck.action is ended.action is Action.CHECK_VALVE
    assert stuck.shift.endswith("check the valve of u first.")


def test_a_plant_that_moved_meanwhile_is_to_be_tracked_before_anything_is_done(tmp_path):
    result = said(tmp_path, "2.6 exp(-13.4 s)/(60 s + 1)")
    moved = Reason(Code.CAUSE_MOVED_MEANWHILE, "the plant was not the same throughout the record", "Y, record.csv")
    then = replace(result, notes=(moved,))
    assert result.action is Action.NONE and then.action is Action.GET_DATA
    look = "find out what it does now, since it did not do the same throughout (trueplant track)"
    assert then.shift.endswith(f"; {look}.") and "no action" not in then.shift
    assert (
        then.headline == f"{result.headline} No one plant suits the whole record, so that these values lie between "
        "several: see the notes."
    )
    asked = replace(then, robustness=replace(then.robustness, peaks=_missed()))
    assert asked.action is Action.RETUNE and f"; {look} first, then the controllers need new settings." in asked.shift


def test_another_controller_is_said_and_its_margins_are_not(tmp_path):
    result = said(tmp_path, law=LAW | {"Kc": 2.0})
    assert (
        result.shift == "Y answers as the model says; the controller is not the one that was declared: look up which "
        "settings are in it."
    )
    assert result.action is Action.GET_DATA


def test_new_settings_are_not_asked_for_on_the_word_of_a_controller_that_was_not_at_work(tmp_path):
    """Declared is a law that would be unstable on the plant; the one that wrote OP has a sixth of its gain."""
    result = said(tmp_path, "4 exp(-13.4 s)/(60 s + 1)", LAW | {"Kc": 6.0})
    assert isinstance(result.robustness, LoopRobustness) and not result.robustness.margins.plant[0].stable
    assert result.action is Action.GET_DATA
    assert "new settings" not in result.shift and "unstable" not in result.shift
    assert not [note for note in result.notes if note.code in (Code.MARGINS, Code.DRAWN)]
    (plan,) = result.more_data
    assert plan.sentence.startswith("no test can be planned before it is known which controller is at work")
    page = render_shift(result)
    assert "Not known: OP was written by another controller" in page and "NOT SAFE" not in page
    assert "[tuning]" not in page


def test_a_gain_whose_sign_has_turned_is_said_before_all_else(tmp_path):
    result = said(tmp_path, "2.6 exp(-13.4 s)/(60 s + 1)")
    element = result.elements[0]

    def with_model(model: float) -> Result:
        derived = tuple(replace(one, model=model) if one.name == "net_gain" else one for one in element.derived)
        return replace(result, elements=(replace(element, derived=derived),))

    assert with_model(-2.0).shift.startswith("Y answers in the opposite direction to what the model says;")
    assert "u -> y responds in the opposite direction to the model, with a gain of 2." in with_model(-2.0).headline
    assert "opposite" not in with_model(2.0).shift + with_model(2.0).headline
    one, other = with_model(-2.0).elements[0], replace(element, output="Z", importance=Importance(9.0, "loop"))
    assert replace(result, elements=(other, one)).shift.startswith("Y answers in the opposite direction")


def test_an_unstable_loop_needs_new_settings(tmp_path):
    result = said(tmp_path, "2.6 exp(-13.4 s)/(60 s + 1)")
    assert isinstance(result.robustness, LoopRobustness)
    margins = result.robustness.margins
    broken = replace(margins, plant=tuple(replace(one, stable=False) for one in margins.plant))
    unstable = replace(result, robustness=replace(result.robustness, margins=broken))
    assert "today's tuning of u is unstable on it; the controllers need new settings" in unstable.shift
    assert unstable.action is Action.RETUNE


def test_what_a_little_data_leave_open_asks_for_more(tmp_path):
    result = said(tmp_path, samples=400, std=0.8)
    assert np.all([element.verdict == "not identifiable" for element in result.elements])
    assert result.action is Action.GET_DATA
    assert result.shift.endswith("get more data before anything is changed.")
