"""The report on the loops: margins, robust performance and new settings say what the result says."""

from __future__ import annotations

import dataclasses
import json
import re
import tomllib
from html import unescape

import numpy as np
import pytest

from support.pages import Page, book, without_plotly
from support.report_sample import sample, with_loop
from trueplant.project.law_table import Controller
from trueplant.report import loopfigures, loops, render, retuned
from trueplant.report.numbers import number, probability
from trueplant.report.style import DARK, LIGHT
from trueplant.result import (
    KEEP,
    ControllerSettings,
    LoopRetuning,
    LoopRobustness,
    MoreData,
    MuCurves,
    Notation,
    Pairing,
    Result,
    RetuningCurves,
    build,
)
from trueplant.result.summary import loop_line, settings_lines, text_summary


@pytest.fixture(scope="module")
def result(tmp_path_factory) -> Result:
    return with_loop(tmp_path_factory.mktemp("loop"))


@pytest.fixture(scope="module")
def page(result: Result) -> str:
    return render(result)


@pytest.fixture(scope="module")
def parsed(page: str) -> Page:
    return Page(without_plotly(page))


def rows(parsed: Page) -> list[str]:
    return [text for _, text in parsed.all("tr")]


def test_margins_of_model_and_plant_stand_side_by_side(result, parsed):
    found = result.to_dict()["robustness"]["margins"]
    model, plant = found["model"][0], found["plant"][0]
    assert plant["Ms"] > model["Ms"] > 1.3
    labels = {"gain_margin": "Gain margin", "Ms": "Ms, peak of the sensitivity", "Mt": "Mt, peak of T"}
    for key, label in labels.items():
        mark = "▲ " if key != "Mt" and (plant[key] < 2) == (key == "gain_margin") else ""
        text = f"{number(model[key], 3)} {mark}{number(plant[key], 3)}"
        assert any(row.startswith(label) and row.endswith(text) for row in rows(parsed)), text


def test_peaks_are_marked_where_they_fail(result, parsed):
    peaks = result.to_dict()["robustness"]["peaks"]
    assert peaks["model"]["RP"]["upper"] < 1 < peaks["plant"]["RP"]["upper"]
    row = next(row for row in rows(parsed) if row.startswith("Robust performance (RP)"))
    for name in ("model", "plant", "estimate"):
        peak = peaks[name]["RP"]
        place = f"at {number(peak['frequency'], 3)} rad/min" if peak["frequency"] else "towards frequency 0"
        assert f"{'▲ ' if peak['upper'] >= 1 else ''}{number(peak['upper'], 3)} {place}" in row
    assert row.count("▲") == sum(peaks[name]["RP"]["upper"] >= 1 for name in peaks)


def test_worst_plant_stands_in_the_report(result, parsed):
    formula = result.to_dict()["robustness"]["peaks"]["plant"]["worst_plant"][0]["tf"]
    assert any(row == f"top_temperature reflux {formula}" for row in rows(parsed))


def test_what_the_change_does_to_the_loop_stands_in_the_verdict(result, parsed):
    verdict = next(text for a, text in parsed.all("section") if "verdict" in (a.get("class") or ""))
    assert loop_line(result) in verdict
    assert "Robust performance does not hold" in loop_line(result)
    assert loop_line(result) in text_summary(result)


def test_mu_is_drawn_with_bounds_peaks_and_the_line_at_one(result, page):
    drawn = list(book(page)["figures"].values())
    titles = [f["layout"]["yaxis"]["title"]["text"] for f in drawn if f["layout"].get("yaxis", {}).get("title")]
    assert titles.count("µ") == 2
    assert result.curves is not None
    curves = result.curves.mu
    figure = loopfigures.mu_test(curves, "RP", "min")
    traces = {t.name: t for t in figure.data if t.mode == "lines"}
    assert set(traces["limit"].y) == {1.0}
    low, high = (10**edge for edge in figure.layout.xaxis.range)
    for one in curves:
        x, y = traces[loopfigures.NAMES[one.system]].x, traces[loopfigures.NAMES[one.system]].y
        assert low == pytest.approx(x[0]) and x[-1] <= high * (1 + 1e-9)
        assert y == pytest.approx(np.interp(np.log(x), np.log(one.w), one.bounds["RP"][:, 1]), rel=0.02)
        frequency, peak = one.peaks["RP"]
        marks = [(t.x[0], t.y[0]) for t in figure.data if t.name == "peak"]
        assert any(x == pytest.approx(max(frequency, low)) and y == peak for x, y in marks)
        assert number(peak, 3) in loopfigures.mu_caption(curves, "RP", "min")


def test_bounds_that_differ_are_shown_as_a_band():
    w = np.geomspace(1e-6, 100, 200)
    upper = 0.4 + 0.3 / (1 + w**2)
    tight = MuCurves("plant", w, {"RP": np.column_stack([upper, upper])}, {"RP": (0.0, 0.7)})
    loose = dataclasses.replace(tight, bounds={"RP": np.column_stack([0.9 * upper, upper])})
    assert not [t for t in loopfigures.mu_test([tight], "RP", "s").data if t.fill]
    assert [t for t in loopfigures.mu_test([loose], "RP", "s").data if t.fill == "toself"]
    low, high = loopfigures.mu_span([tight])
    assert 0.01 < low < 0.1 and 5 < high < 30  # the curve leaves 1 % of its peak at 0.15 and reaches it at 6.5


def test_high_peaks_get_a_logarithmic_axis():
    w = np.geomspace(1e-3, 100, 50)
    steep = MuCurves("plant", w, {"NP": np.column_stack([40 / (1 + w)] * 2)}, {"NP": (0.0, 40.0)})
    assert loopfigures.mu_test([steep], "NP", "s").layout.yaxis.type == "log"


# -- new settings ---------------------------------------------------------------------------------------------


def test_new_settings_come_before_all_else_that_explains_them(result, parsed):
    loop = result.to_dict()["controllers"][0]
    assert loop["recommended"]
    new = next(p for p in loop["proposals"] if p["method"] == loop["recommended"])["shown"]
    said = next(text for a, text in parsed.all("section") if a.get("id") == "next")
    assert "Enter these settings" in said
    assert f"Gain (%/degC) {number(loop['current']['shown']['gain'])} {number(new['gain'])}" in said
    assert f"Integral time (min) {number(loop['current']['shown']['integral'])} {number(new['integral'])}" in said
    line = settings_lines(result)[0]
    assert f"Kc = {new['gain']:.4g} (now 0.6)" in line and line in text_summary(result)


def test_every_proposal_has_its_row(result, parsed):
    said = [
        row
        for row in rows(parsed)
        if any(row.startswith(p["method"]) for p in result.to_dict()["controllers"][0]["proposals"])
    ]
    assert len(said) == len(result.to_dict()["controllers"][0]["proposals"]) >= 2
    for row, proposal in zip(said, result.to_dict()["controllers"][0]["proposals"], strict=True):
        if proposal["metrics"]:
            now = result.to_dict()["controllers"][0]["current"]["metrics"]["plant"]["load"]["iae"]
            assert f"{number(100 * proposal['metrics']['plant']['load']['iae'] / now, 3)} %" in row
            assert f"{number(100 * proposal['drawn']['share'], 3)} %" in row
            mu = proposal["metrics"]["plant"]["mu"]["upper"]
            assert f"{'▲ ' if mu >= 1 else ''}{number(mu, 3)}" in row


def test_before_and_after_are_compared_on_the_plant(result, parsed):
    loop = result.to_dict()["controllers"][0]
    now = loop["current"]["metrics"]
    new = next(p for p in loop["proposals"] if p["method"] == loop["recommended"])["metrics"]["plant"]
    text = (
        f"{number(now['plant']['setpoint']['settling'], 3)} min {number(new['setpoint']['settling'], 3)} min "
        f"{100 * (new['setpoint']['settling'] / now['plant']['setpoint']['settling'] - 1):+.0f} % "
        f"{number(now['model']['setpoint']['settling'], 3)} min"
    )
    assert any(row.startswith("Settling time") and row.endswith(text) for row in rows(parsed)), text


def test_pasted_settings_are_a_controller_of_the_project(result, page):
    loop = result.to_dict()["controllers"][0]
    pasted = re.search(r"<pre><code>(.*?)</code></pre>", page, re.DOTALL)
    assert pasted
    table = tomllib.loads(unescape(pasted[1]))["controller"][0]
    law = Controller(**table)
    new = next(p for p in loop["proposals"] if p["method"] == loop["recommended"])["settings"]
    assert law.Kc == pytest.approx(new["Kc"], rel=1e-5) and law.Ti == pytest.approx(new["Ti"], rel=1e-5)


def test_names_in_pasted_settings_are_quoted(result):
    strange = 'a "quoted" \\ name'
    loop = dataclasses.replace(result.controllers[0], input=strange, output="ü", gain_unit="percent of span")
    law = ControllerSettings(form="ideal", Kc=-1.5, Ti=None)
    table = tomllib.loads(retuned._toml(loop, law))["controller"][0]
    assert table == {"input": strange, "output": "ü", "form": "ideal", "Kc": -1.5, "gain_unit": "percent of span"}


def test_responses_before_and_after_are_drawn_with_their_bands(result, page):
    assert result.curves is not None
    curves = result.curves.retuning[0]
    figures = [f for f in book(page)["figures"].values() if any(t["meta"]["role"] == "after" for t in f["data"])]
    assert len(figures) == (5 if curves.replay_t.size else 4)
    assert all(sum(t["meta"]["role"].endswith("_band") for t in f["data"]) == 2 for f in figures[:4])
    drawn = {t.meta["role"]: t for t in loopfigures.before_after(curves.t, curves.load, "min", "degC", 0.0).data}
    for role in ("before", "after"):
        assert drawn[role].y == pytest.approx(curves.load[role][:, 1])
        band = curves.load[role][:, (0, 2)]
        assert (min(drawn[f"{role}_band"].y), max(drawn[f"{role}_band"].y)) == pytest.approx((band.min(), band.max()))


def step(t: np.ndarray, lag: float) -> np.ndarray:
    value = 1 - np.exp(-t / lag)
    return np.column_stack([value, value, value])


def test_captions_of_responses_state_what_the_curves_do():
    t = np.linspace(0, 100, 1001)
    slow, fast = step(t, 10.0), step(t, 2.0)
    assert loopfigures.settling_caption(t, {"before": slow, "after": fast}, "min") == (
        "Within 5 % of the step from 30 min on before, from 6 min on after."  # ln 20 = 3.0 lags
    )
    assert "not in this time before" in loopfigures.settling_caption(t, {"before": step(t, 90.0), "after": fast}, "s")
    half = 0.5 * slow
    said = loopfigures.size_caption("Largest error", {"before": slow, "after": -half}, "degC")
    assert said == "Largest error: 1 before, 0.5 after (degC)."
    curves = RetuningCurves("u", "y", "simc", t, {"before": slow, "after": fast}, {}, {}, {}, np.zeros(0), {})
    assert t[loopfigures.until_settled(curves) - 1] == pytest.approx(1.5 * 10 * np.log(50), abs=0.5)


def test_nothing_recommended_says_keep_and_why(result):
    loop = {**result.to_dict()["controllers"][0], "recommended": None, "reason": "today's settings hold what is asked"}
    kept = dataclasses.replace(result, controllers=(build(LoopRetuning, loop),))
    parsed = Page(without_plotly(render(kept)))
    said = next(text for a, text in parsed.all("section") if a.get("id") == "next")
    assert "Enter these settings" not in said and "Keep the settings of the controllers" in said
    section = next(text for a, text in parsed.all("section") if a.get("id") == "controllers")
    assert "Nothing is recommended" in section and "Today's settings hold what is asked." in section
    assert settings_lines(kept) == ["no retuning is recommended: today's settings hold what is asked."]


def test_settings_that_stay_are_not_to_be_entered(result):
    loop = dataclasses.replace(result.controllers[0], recommended=KEEP, reason="there is nothing to gain: keep them")
    made = retuned.retuned(loop, "%", "degC")
    assert made.kept and not made.recommended
    parsed = Page(without_plotly(render(dataclasses.replace(result, controllers=(loop,)))))
    said = {a["id"]: text for a, text in parsed.all("section") if a.get("id") in ("next", "controllers")}
    assert "Keep the settings of the controllers" in said["next"] and "Enter these settings" not in said["next"]
    assert "Keep today's settings." in said["controllers"] and "Nothing is recommended" not in said["controllers"]
    # beside a loop that is set anew it is said by its name
    two = dataclasses.replace(result, controllers=(result.controllers[0], dataclasses.replace(loop, input="steam")))
    said = {a["id"]: text for a, text in Page(without_plotly(render(two))).all("section") if a.get("id")}
    assert f"steam → {loop.output}: keep today's settings." in said["next"]


def test_a_law_that_is_no_pid_is_shown_as_its_formula(result):
    law = ControllerSettings(tf="0.5 (4 s + 1)/(4 s (s + 1))", others={"level": "0.1/s"})
    proposals = tuple(dataclasses.replace(p, settings=law, shown=None) for p in result.controllers[0].proposals)
    loop = dataclasses.replace(result.controllers[0], proposals=proposals)
    made = retuned.retuned(loop, "%", "degC")
    assert ("Form", "ideal", "formula") in [(s.label, s.now, s.new) for s in made.settings]
    formula = "0.5 (4 s + 1)/(4 s (s + 1)); 0.1/s from level"
    assert ("Transfer function", "none", formula) in [(s.label, s.now, s.new) for s in made.settings]
    own, other = (Controller(**table) for table in tomllib.loads(made.toml)["controller"])
    assert own.tf == "0.5 (4 s + 1)/(4 s (s + 1))" and (other.output, other.tf) == ("level", "0.1/s")
    line = settings_lines(dataclasses.replace(result, controllers=(loop,)))[0]
    assert "tf = 0.5 (4 s + 1)/(4 s (s + 1)) (now none), and from level as in the report" in line


VENDOR = Notation(gain="proportional band", integral="repeats", derivative_filter="divisor", time_unit="min")
PARALLEL = Notation(gain="gain", integral="time", derivative_filter="time", time_unit="s")


@pytest.mark.parametrize(
    ("notation", "form", "labels"),
    [
        (VENDOR, "ideal", ("Proportional band (%)", "Repeats per min", "Derivative time (min)")),
        (PARALLEL, "parallel", ("Gain (%/degC)", "Integral gain Ki (per s)", "Derivative gain Kd (times s)")),
    ],
)
def test_settings_bear_the_names_and_units_of_the_notation(result, notation, form, labels):
    loop = dataclasses.replace(result.controllers[0], notation=notation, form=form)
    assert retuned.retuned(loop, "%", "degC").headings == labels


def test_unstable_loop_on_the_plant_is_said_first_and_in_the_table(result):
    robustness = json.loads(json.dumps(result.to_dict()["robustness"]))
    robustness["margins"]["plant"] = [{"input": "reflux", "stable": False, "message": "2 unstable poles"}]
    robustness["peaks"]["plant"] = {"stable": False, "robust_performance_holds": False} | {
        test: {"lower": None, "upper": None, "frequency": None} for test in ("NP", "RS", "RP")
    }
    broken = dataclasses.replace(result, robustness=build(LoopRobustness, robustness))
    assert loop_line(broken) == "Today's controller leaves the loop of reflux unstable on the plant as estimated."
    parsed = Page(without_plotly(render(broken)))
    assert any(row.startswith("Gain margin") and row.endswith("▲ unstable") for row in rows(parsed))
    assert any("plant: 2 unstable poles" in row for row in rows(parsed))


def test_pairing_against_the_sign_is_said():
    found = Pairing(rga=((-0.3, 1.3), (1.3, -0.3)), niederlinski=-3.0, wrong_sign=("a", "b"))
    text = loops.pairing_rows({"model": found, "plant": found}, ("y", "z"), ("a", "b"))
    assert text[0][0] == ("y", ("-0.3 → -0.3", "1.3 → 1.3"))
    assert "below 0" in text[1]


def test_results_without_a_controller_have_neither_section():
    parsed = Page(without_plotly(render(sample())))
    assert not [a for a, _ in parsed.all("section") if a.get("id") in ("robustness", "controllers")]


def test_both_palettes_know_every_role(page):
    roles = {t["meta"]["role"] for f in book(page)["figures"].values() for t in f["data"]}
    assert {"before", "after", "estimate", "limit"} <= roles
    assert roles <= LIGHT.keys() and LIGHT.keys() == DARK.keys()


def test_fit_and_residual_tests_are_tables_not_nested_lists(result, parsed):
    said = next(text for a, text in parsed.all("section") if a.get("id") == "fit")
    row = result.to_dict()["fit"][0]
    tests = row["residual_tests"]
    assert f"{number(row['fit_percent_model'])} {number(row['fit_percent_plant'])}" in said
    assert f"{probability(tests['whiteness_p'])} {probability(tests['input_p']['reflux'])}" in said
    assert "p, unrelated to reflux" in said
    section = next(k for k, (_, a, _) in enumerate(parsed.elements) if a.get("id") == "fit")
    after = [tag for tag, _, _ in parsed.elements[section:]]
    assert "dl" not in after[: after.index("section", 1)]


def test_moves_that_would_settle_what_is_open_are_listed(result):
    plan = {
        "sentence": "move the set-point of top temperature by ±2 degC every 16 min",
        "moves": [{"signal": "set-point", "name": "top_temperature", "size": 2.0, "unit": "degC", "every": 16.1}],
        "settles": [
            {
                "output": "top_temperature",
                "input": "reflux",
                "parameter": "gain",
                "unit": "degC/%",
                "now": None,
                "wanted": 0.05,
                "then": 0.04,
            }
        ],
    }
    parsed = Page(without_plotly(render(dataclasses.replace(result, more_data=(build(MoreData, plan),)))))
    said = next(text for a, text in parsed.all("section") if a.get("id") == "more-data")
    assert "Move the set-point of top temperature by ±2 degC every 16 min." in said
    assert "set-point top_temperature 2 degC 16.1" in said
    assert "top_temperature reflux gain degC/% – 0.05 0.04" in said
    assert not [a for a, _ in Page(without_plotly(render(result))).all("section") if a.get("id") == "more-data"]
