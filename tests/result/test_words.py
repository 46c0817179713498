"""What a result says in words, and in JSON."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from datetime import datetime
from pathlib import Path

import numpy as np
import pytest

from trueplant.cli.show import show
from trueplant.lti import Structure
from trueplant.output import to_json
from trueplant.result import (
    Code,
    DetectedElement,
    Detection,
    Element,
    Importance,
    LoopMargins,
    LoopRobustness,
    Margins,
    Methods,
    Parameter,
    Provenance,
    Reason,
    Result,
    Settings,
)
from trueplant.result.codec import plain
from trueplant.result.detectors_words import detector_lines
from trueplant.result.numbers import number, value_with_interval
from trueplant.result.parameter_words import number_of, word_of
from trueplant.result.plan_words import not_worth_sentence
from trueplant.result.plans import MoreData, NotWorth
from trueplant.result.summary import (
    html_summary,
    loop_line,
    parameter_line,
    text_summary,
    told_elements,
    told_reasons,
    worth_knowing,
)
from trueplant.study.methods.agreement import in_sentences
from trueplant.study.plant.notes import grouped

PROVENANCE = Provenance("0.1.0", "project", "0" * 64, {}, {}, "s", 0, Settings("auto", 0.95, 0.0))


def _parameter(name="tau1", unit="s", model=390.0, plant=183.0, half=4.0, changed=True, **rest) -> Parameter:
    ci = None if plant is None else (plant - half, plant + half)
    percent = None if plant is None or not model else 100 * (plant / model - 1)
    return Parameter(name, unit, model, plant, half / 2, ci, percent, 0.001, 0.002, changed, **rest)


def _element(
    output="temperature_2", input="heater_2", verdict="changed", parameters=None, weight=1.0, **rest
) -> Element:
    given = {
        "structure": "fopdt",
        "tf_model": "0.61/(390 s + 1)",
        "tf_plant": "0.55/(183 s + 1)",
        "tf_mismatch": None,
        "parameters": (_parameter(changed=verdict == "changed"),) if parameters is None else parameters,
        "reason": "",
        "p_adjusted": 0.002,
        "importance": Importance(weight, "loop"),
        "grade": "A",
    }
    return Element(output, input, verdict=verdict, **(given | rest))


def _result(*elements: Element, **rest) -> Result:
    return Result(
        **({"status": "ok", "reasons": (), "provenance": PROVENANCE, "data": (), "elements": elements} | rest)
    )


def test_change_is_said_with_both_values():
    assert _result(_element()).headline == (
        "The plant has changed: heater 2 -> temperature 2 responds with a time constant of 183 s, not 390 s (-53 %)."
    )


def test_the_change_that_matters_most_comes_first():
    small = _element("y1", "u1", weight=0.1)
    big = _element("y2", "u2", weight=2.0)
    said = _result(small, big, _element("y1", "u2", "unchanged")).headline
    assert said.index("u2 -> y2") < said.index("u1 -> y1")
    assert said.endswith("1 element with no change found.")


def test_many_changes_are_counted():
    said = _result(*(_element(f"y{k}", f"u{k}", weight=10.0 - k) for k in range(6))).headline
    assert "Changed too: u1 -> y1 (tau1 -53 %), u2 -> y2 (tau1 -53 %), u3 -> y3 (tau1 -53 %) and 2 more." in said


def test_several_parameters_of_one_element_are_listed():
    gain = _parameter("gain", "degC/%", 0.5, 0.6, 0.01)
    second = _parameter("tau2", "s", 10.0, 20.0, 1.0)
    said = _result(_element(parameters=(gain, _parameter(), second))).headline
    assert "a gain of 0.600 degC/%, not 0.500 degC/% (+20 %)" in said
    assert "a first time constant of 183 s" in said
    assert "; and a second time constant of 20.0 s, not 10.0 s (+100 %)." in said


def test_response_that_the_model_lacks_is_called_that():
    gain = _parameter("gain", "degC/%", None, 0.27, 0.02)
    said = _result(_element("temperature_1", tf_model="0", parameters=(gain,))).headline
    assert "heater 2 -> temperature 1 responds with a gain of 0.270 degC/%, where the model has no response" in said


def test_joint_change_without_a_single_parameter():
    said = _result(_element(parameters=(_parameter(changed=False),))).headline
    assert "differs from the model as a whole" in said


def test_unchanged_plant():
    kept = _element(verdict="unchanged")
    assert _result(kept).headline == "No change was found in heater 2 -> temperature 2."
    assert "any of the 2 elements" in _result(kept, kept).headline


def test_no_change_found_says_what_would_have_been_seen():
    kept = _element(verdict="unchanged")
    said = _result(replace(kept, detectable_change=0.09), replace(kept, detectable_change=0.154)).headline
    assert said == (
        "No change was found in any of the 2 elements; one of gain, lag or dead time by more than 15 % would have been "
        "seen."
    )


def test_no_change_found_without_power_is_no_all_clear():
    """Over 30 % could have been missed: the element is not identifiable, and the headline says by how much."""
    weak = replace(_element("y1", "u1", "not identifiable", (_parameter(changed=False),)), detectable_change=0.35)
    assert _result(weak).headline == (
        "No change was found in u1 -> y1, but these data say too little: one of 35 % could have been missed."
    )
    of_lag = replace(weak, detectable_of="lag")
    assert _result(of_lag).headline.endswith("one of the lag by 35 % could have been missed.")
    assert _result(_element(verdict="unchanged"), of_lag).headline.endswith(
        "In 1 element no change was found, but one of the lag by 35 % could have been missed (u1 -> y1)."
    )
    blind = replace(weak, detectable_change=None)
    assert "in 2 elements, but these data say too little: any could have been missed" in _result(weak, blind).headline


def test_a_number_without_a_useful_interval_is_in_no_headline():
    """A gain of 0.02 that may be anything from -0.21 to 0.25 is not "-96 %"."""
    gain = _parameter("gain", "degC/%", 0.5, 0.02, 0.23)
    said = _result(_element(parameters=(gain,))).headline
    assert "responds with a gain between -0.210 and 0.250 degC/%, not 0.500 degC/%." in said
    other = _element("y1", "u1", parameters=(gain,))
    said = _result(replace(other, importance=Importance(9.0, "loop"), parameters=(_parameter(),)), other).headline
    assert "Changed too: u1 -> y1 (gain between -0.210 and 0.250 degC/%)." in said


def test_another_structure_is_said_where_no_parameter_says_it():
    plain_one = _parameter(changed=False)
    other = _element("y1", "u1", parameters=(plain_one,), structure="sopdt+lead", rejected_structure="fopdt")
    assert _result(other).headline == (
        "The model is too simple: u1 -> y1 does not have its model's structure fopdt: sopdt+lead fits. That may be as "
        "old as the model."
    )
    several = _result(other, replace(other, output="y2"), replace(other, output="y3")).headline
    assert several.endswith("Nor do u1 -> y2, u1 -> y3 have their own. All of that may be as old as the model.")
    first = replace(_element(), importance=Importance(9.0, "loop"))
    assert "Changed too: u1 -> y1 (another structure)." in _result(first, other).headline
    # a gain that has changed says more
    said = _result(replace(other, parameters=(_parameter("gain", "", 1.0, 2.0, 0.1),))).headline
    assert "responds with a gain of 2.00" in said and "structure" not in said


def test_a_changed_parameter_is_said_before_a_structure_that_matters_more():
    simpler = _element(
        "y1", "u1", parameters=(_parameter(changed=False),), rejected_structure="fopdt", structure="sopdt", weight=9.0
    )
    said = _result(simpler, _element()).headline
    assert said.startswith("The plant has changed: heater 2 -> temperature 2 responds with a time constant of 183 s")
    assert said.endswith("Changed too: u1 -> y1 (another structure).")


def test_nothing_known_of_the_plant_is_no_stable_plant():
    loop = LoopMargins("u1", True, Ms=1.05)
    table = LoopRobustness("run.csv", Margins((loop,), (loop,)), ())
    unknown = _element("y1", "u1", "not identifiable", (_parameter(plant=None, changed=False),))
    told = replace(unknown, parameters=(_parameter(changed=False),))
    said, known = (loop_line(_result(one, robustness=table)) for one in (unknown, told))
    assert "keeps the model stable" in said and "these data do not say" in said and "plant stable" not in said
    assert "keeps the plant stable" in known


def test_limits_that_nobody_declared_are_not_said_to_be_near():
    plan = MoreData("", limited_by="PV of y", not_worth=NotWorth.LIMITS_TOO_NEAR, longest=480.0)
    assert "so near its limits" in not_worth_sentence("min", plan)
    assumed = not_worth_sentence("min", replace(plan, assumed_limits=("PV of y",)))
    assert "no limits are declared for PV of y" in assumed and "near" not in assumed


def test_what_could_not_be_judged_is_said():
    open_one = _element("y1", "u1", "not identifiable", (_parameter(plant=None, changed=False),), p_adjusted=None)
    kept = _element(verdict="unchanged")
    assert _result(kept, open_one).headline.endswith("1 element could not be judged (u1 -> y1).")
    assert "all" not in _result(kept, open_one).headline
    assert _result(open_one).headline.startswith("No verdict is possible")


def test_refusal_gives_its_reason():
    reasons = (Reason("no-excitation", "no set-point changes"), Reason("x", "y"))
    assert _result(status="refused", reasons=reasons).headline == (
        "No answer can be given: no set-point changes. (1 more reason in the result)"
    )


def test_refusal_gives_the_reason_of_a_place_and_says_it_once():
    why, dynamics = "it depends on the noise model", "the gain cannot be told from zero"
    reasons = (
        Reason(Code.NOT_IDENTIFIABLE, "no parameter can be told"),
        Reason(Code.NOT_IDENTIFIABLE, why, "gain of u_1 -> y"),
        Reason(Code.NOT_IDENTIFIABLE, dynamics, "tau1 of u_1 -> y; dead_time of u_1 -> y"),
    )
    silent = _parameter(plant=None, changed=False)
    parameters = (replace(silent, reason=why), replace(silent, reason=dynamics))
    element = _element("y", "u_1", "not identifiable", parameters)
    refused = _result(element, status="refused", reasons=reasons)
    assert refused.headline == f"No answer can be given: gain of u 1 -> y: {why}. (1 more reason in the result)"
    assert told_reasons(refused) == [reasons[2]]
    assert told_elements(refused) == []
    # what is known of an element is said, whatever the reasons are
    known = replace(element, parameters=(_parameter(), *parameters))
    assert told_elements(_result(known, status="refused", reasons=reasons)) == [known]
    several = _result(element, status="refused", reasons=reasons[::2])
    assert several.headline == f"No answer can be given: 2 parameters: {dynamics}."


def test_a_note_on_what_is_said_of_the_loops_is_not_given_again(monkeypatch):
    missed = Reason(Code.ROBUST_PERFORMANCE, "with today's controller robust performance does not hold")
    cause, common = Reason(Code.CAUSE_PLANT, "the plant itself"), Reason(Code.ONE_EXPERIMENT, "one run")
    result = _result(notes=(common, missed, cause))
    assert worth_knowing(result) == [cause, missed]
    line = "Robust performance does not hold: mu peaks at 1.43."
    monkeypatch.setattr("trueplant.result.summary.loop_line", lambda _: line)
    assert worth_knowing(result) == [cause]


def test_a_cause_comes_before_a_limit_that_OP_stood_at():
    limit, uneven, cause = (
        Reason(code, "text") for code in (Code.CAUSE_VALVE_SATURATED, Code.UNEVEN_NOISE, Code.CAUSE_PLANT)
    )
    assert worth_knowing(_result(notes=(limit, uneven, cause))) == [cause, limit, uneven]


def test_the_terminal_gives_a_reason_once(capsys):
    why = "all that happens lies between two samples"
    silent = replace(_parameter(plant=None, changed=False), reason=why)
    common = Reason(Code.ONE_EXPERIMENT, "one run")
    dead = replace(silent, name="dead_time")
    gain = _parameter("gain", "", 1.0, 1.1, 0.1, changed=False)
    show(_result(_element("y", "u", "not identifiable", (gain, silent, dead)), notes=(common,)), ())
    said = capsys.readouterr().out
    assert said.count(why) == 1 and "likewise" in said
    assert common.message not in said and "1 note on what holds for most records: in report.html" in said


def test_parameter_line_is_the_documented_one():
    gain = _parameter("gain", "", 0.932, 0.917, 0.012, changed=False)
    assert parameter_line(gain) == "K = 0.917 ± 0.012 (model 0.932, -1.6 %)"
    assert (
        parameter_line(replace(gain, plant=None, reason="OP never moved"))
        == "K not known: OP never moved (model 0.932)"
    )


@pytest.mark.parametrize(
    ("value", "ci", "text"),
    [
        (0.917, (0.905, 0.929), "0.917 ± 0.012"),
        (183.2, (179.0, 187.4), "183.2 ± 4.2"),
        (1234.0, (1000.0, 1468.0), "1234 ± 234"),
        (2.0, (1.9, 2.9), "2.00, 1.90 to 2.90"),
        (2.0, (-math.inf, math.inf), "2.00, no limit known"),
        (0.445, (math.nan, 0.531), "0.445, at most 0.531"),
    ],
)
def test_values_have_the_digits_that_they_deserve(value, ci, text):
    assert value_with_interval(value, ci) == text


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.0, "0"), (1234.5, "1234"), (0.00123456, "0.00123"), (-0.5, "-0.500"), (1e9, "1.00e+09"), (math.nan, "unknown")],
)
def test_numbers(value, text):
    assert number(value) == text


def test_summaries_hold_verdicts_parameters_and_notes():
    note = Reason("single", "between-run variance is <missing>", "run 1")
    result = _result(_element(), notes=(note,))
    text = text_summary(result)
    assert text == repr(result)
    assert text.splitlines()[0] == result.headline
    assert "heater_2 -> temperature_2 (fopdt): changed, grade A" in text
    assert "tau1 = 183.0 ± 4.0 s (model 390, -53.1 %)  changed" in text
    assert "note (run 1): between-run variance is <missing>." in text
    assert "95 % interval" in text
    page = html_summary(result)
    assert "&lt;missing&gt;" in page and "<missing>" not in page


def test_plain_is_json_and_nothing_is_infinite():
    value = {
        "array": np.array([[1.0, np.nan], [np.inf, 2.0]]),
        "scalar": np.float64(3.5),
        "flag": np.bool_(True),
        "tuple": (1, None),
        "when": datetime(2024, 1, 2),
        "path": Path("a/b"),
        "complex": 1 + 2j,
        3: {"b", "a"},
    }
    assert json.loads(json.dumps(plain(value), allow_nan=False)) == {
        "array": [[1.0, None], [None, 2.0]],
        "scalar": 3.5,
        "flag": True,
        "tuple": [1, None],
        "when": "2024-01-02T00:00:00",
        "path": "a/b",
        "complex": {"re": 1.0, "im": 2.0},
        "3": ["a", "b"],
    }
    with pytest.raises(TypeError, match="object"):
        plain(object())


def test_result_json_has_the_published_keys():
    body = json.loads(to_json(_result(_element())))
    assert body["schema"] == 1
    assert {
        "status",
        "reasons",
        "provenance",
        "data",
        "elements",
        "fit",
        "methods",
        "robustness",
        "controllers",
    } <= set(body)
    parameter = body["elements"][0]["parameters"][0]
    assert parameter["name"] == "tau1" and parameter["ci"] == [179.0, 187.0]


def test_each_note_is_said_once_with_all_its_places():
    again = Reason("cause-plant", "the plant itself has changed", "heater_2 -> temperature_2")
    first = Reason("cause-plant", "the plant itself has changed", "heater_1 -> temperature_1")
    assert grouped([first, Reason("a", "b"), again, again]) == (
        Reason("cause-plant", "the plant itself has changed", "heater_1 -> temperature_1; heater_2 -> temperature_2"),
        Reason("a", "b"),
    )


def _detected(name: str, flagged: dict[tuple[str, str], bool], refused=None) -> Detection:
    entries = [DetectedElement(o, i, 1.0, 0.5, f, "gain" if f else "") for (o, i), f in flagged.items()]
    return Detection(name, refused, "", () if refused else tuple(entries))


def test_published_detectors_are_said_with_what_the_verdicts_say_otherwise(capsys):
    changed, kept = ("temperature_1", "heater_1"), ("temperature_2", "heater_2")
    result = replace(
        _result(_element(*changed), _element(*kept, verdict="unchanged")),
        methods=Methods(
            detectors=(
                _detected("stepwise", {changed: True, kept: False}),
                _detected("cross-correlation", {changed: False, kept: True}),
                _detected("one-class", {}, "12 windows are needed"),
            )
        ),
    )
    told = [
        "published detectors, on which no verdict rests:",
        "  stepwise flags heater_1 -> temperature_1 (gain)",
        "  cross-correlation flags heater_2 -> temperature_2 (gain) (verdict: heater_2 -> temperature_2 unchanged; "
        "heater_1 -> temperature_1 changed)",
        "  one-class does not apply: 12 windows are needed",
    ]
    assert detector_lines(result) == told
    assert "\n".join(told) in text_summary(result)
    show(result, [])
    assert "\n".join(told) in capsys.readouterr().out
    assert detector_lines(_result(_element())) == []


def test_table_explains_its_marks(capsys):
    show(_result(_element(), _element(verdict="unchanged", grade="C")), [])
    out = capsys.readouterr().out
    assert "-53.1 % *" in out
    assert "* changed, beyond chance. Grade: A and B are good enough to retune on, C is rough" in out
    show(_result(_element(verdict="unchanged", grade="")), [])
    assert "*" not in capsys.readouterr().out


def test_methods_that_agree_are_named_in_one_sentence_and_each_other_speaks_for_itself():
    apart = "srivc and the fit disagree beyond their uncertainties: gain of u -> y: 1 by the fit, 2 by srivc"
    said = in_sentences({"joint": "", "srivc": apart, "rivc": "", "the black box": ""})
    assert said == ("joint, rivc and the black box agree with the fit within their uncertainties", apart)
    assert in_sentences({"joint": ""}) == ("joint agrees with the fit within their uncertainties",)
    assert in_sentences({"srivc": apart}) == (apart,)
    assert in_sentences({}) == ()


def test_parameters_are_called_by_the_words_of_the_field():
    """Every name that a structure can give has its word; a second pair of poles is numbered apart."""
    structure = Structure(lags=2, pairs=2, leads=1, delayed=2)
    assert [word_of(name) for name in structure.names] == [
        *["gain"] * 2,
        *["time constant"] * 2,
        *["natural frequency", "damping ratio"] * 2,
        "lead time",
        *["dead time"] * 2,
    ]
    assert [number_of(name) for name in structure.names] == ["1", "2", "1", "2", "", "", "2", "2", "1", "1", "2"]
