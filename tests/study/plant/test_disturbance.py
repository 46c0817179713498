"""Disturbances through the whole analysis: measured ones in the closed form, unmeasured ones estimated along.

All records here are simulated. Of a single record at most 2 of 12 intervals may miss, which only tells a method that is
wrong from one that is right; benchmarks/bench_disturbance.py measures how often they miss.
"""

from __future__ import annotations

import numpy as np
import pytest

from support.budgets import sources_of
from support.disturbed import (
    FEED,
    LAWS,
    WITH_CLOSED_FORM,
    WITH_FIT,
    analysed,
    outside,
    parameters,
    true_value,
)
from support.simulated import coloured, random_switching
from trueplant import Result
from trueplant.loop import step_disturbance
from trueplant.lti import sampled_response
from trueplant.result import Source


@pytest.fixture(scope="module")
def stepped(tmp_path_factory: pytest.TempPathFactory) -> Result:
    rng = np.random.default_rng(11)
    samples = 2000
    r = random_switching(rng, samples, 2, 20.0)
    v = coloured(rng, samples, 2, [1, -0.8], [1], 0.1) + step_disturbance(samples, 1.0, 700.0, [8.0, -8.0])
    declared = [{"output": name, "kind": "step", "std": 0.3} for name in ("top", "bottom")]
    return analysed(tmp_path_factory.mktemp("stepped"), v, r, unmeasured=declared)


@pytest.mark.slow
def test_closed_form_with_the_disturbance_estimate_recovers_the_mismatch(stepped):
    found = parameters(stepped, WITH_CLOSED_FORM)
    assert set(found) == {(y, u) for y in ("top", "bottom") for u in ("reflux", "steam")}
    for place, row in found.items():
        assert row[0]["plant"] == pytest.approx(true_value(*place, 0), rel=0.04)
    for method in (WITH_CLOSED_FORM, WITH_FIT, "direct"):
        assert outside(stepped, method) <= 2


@pytest.mark.slow
def test_the_verdict_rests_on_a_fit_that_knows_the_step(stepped):
    """Without the jump as a term of its own the same record gives 10.6 for a gain of 8.58. The answer is that fit, but
    for what valves that may not follow OP would make of it, which is next to nothing here."""
    assert [(e.output, e.input) for e in stepped.elements if e.verdict == "changed"] == [("bottom", "reflux")]
    gain = next(e for e in stepped.elements if e.verdict == "changed").parameters[0]
    assert gain.plant == pytest.approx(8.58, rel=0.03)
    for place, row in parameters(stepped, WITH_FIT).items():
        for mine, other in zip(row, parameters(stepped, "direct")[place], strict=True):
            assert mine["plant"] == pytest.approx(other["plant"], rel=1e-3)


@pytest.mark.slow
def test_the_declared_disturbance_has_its_part_in_every_standard_error(stepped):
    """What the step leaves uncertain beside the noise, what no likelihood counts, and what valves may do."""
    uncounted = {Source.START, Source.ROUNDING}
    assert sources_of(stepped) == {Source.NOISE, Source.DISTURBANCE, *uncounted, Source.VALVE}


@pytest.mark.slow
def test_a_drift_is_taken_along(tmp_path):
    """Slopes that wander: of 12 such records without the declared drift 16 % of the intervals missed, not 5 %."""
    rng = np.random.default_rng(15)
    samples = 900
    v = coloured(rng, samples, 2, [1, -0.8], [1], 0.1)
    v += np.cumsum(np.cumsum(2e-3 * rng.standard_normal((samples, 2)), axis=0), axis=0)
    declared = [{"output": name, "kind": "drift", "std": 2e-3} for name in ("top", "bottom")]
    result = analysed(tmp_path, v, random_switching(rng, samples, 2, 20.0), unmeasured=declared)
    assert outside(result, "direct") <= 2
    assert ("bottom", "reflux") in {(e.output, e.input) for e in result.elements if e.verdict == "changed"}
    for row in result.to_dict()["methods"]["disturbance"]:
        assert row["jumps"] == []
        assert 0.3 < row["declared"][0]["found_std"] / 2e-3 <= 1


@pytest.mark.slow
def test_the_step_is_found_and_said(stepped):
    table = {row["output"]: row for row in stepped.to_dict()["methods"]["disturbance"]}
    for output, size in (("top", 8.0), ("bottom", -8.0)):
        (jump,) = table[output]["jumps"]
        assert jump["time"] == 700.0
        assert jump["size"] == pytest.approx(size, abs=0.5)
        # apart from the one step nothing wanders: next to none of the declared random walk is left
        assert table[output]["declared"][0]["found_std"] < 0.05
        assert table[output]["background"]["std"] == pytest.approx(0.1, rel=0.2)
    assert not any(note.code == "disturbance-model" for note in stepped.notes)


@pytest.mark.slow
def test_what_the_step_takes_from_the_parameters_is_said(stepped):
    """A level that is not known takes from the gains, which are levels too, and next to nothing from the dead times."""
    rows = stepped.to_dict()["methods"]["disturbance"]
    assert rows
    for row in rows:
        shares = {name: [x["share"] for x in row["lost"] if x["name"] == name] for name in ("gain", "dead_time")}
        assert min(shares["gain"]) > 0.5
        assert max(shares["dead_time"]) < 0.2


@pytest.mark.slow
def test_forms_that_a_step_breaks_are_not_applied(stepped):
    for name in ("joint", "closed-form"):
        assert "has to be estimated along" in stepped.to_dict()["methods"]["not_applied"][name]
        assert name not in stepped.to_dict()["methods"]


@pytest.mark.parametrize(
    ("seed", "agreement"),
    [
        (9, "joint and closed-form agree with the fit within their uncertainties"),
        (111, "closed-form agrees with the fit within their uncertainties"),
    ],
)
def test_measured_disturbance_with_a_drifted_model_in_the_closed_form(tmp_path, seed, agreement):
    """Feed gain 3.8, model 3.0: estimated along by the fit, taken off in (17).

    Of the second record the first response says so little that its deepest minimum is another plant: taken about that
    one, the next response confirmed it, with a dead time of reflux -> top of 9.51 +- 0.08 min where 1.4 is true. Noise
    hides the loop's answer there from the joint form.
    """
    rng = np.random.default_rng(seed)
    samples = 4000
    d = 0.3 * random_switching(rng, samples, 1, 40.0)
    # a measured disturbance runs on between samples: its effect is that of the piecewise-linear signal
    v = coloured(rng, samples, 2, [1, -0.8], [1], 0.2) + sampled_response(FEED, d, 1.0, "linear")
    elements = [
        {"output": "top", "input": "feed", "tf": "3.0 exp(-8.1 s)/(14.9 s + 1)"},
        {"output": "bottom", "input": "feed", "tf": "4.9 exp(-3.4 s)/(13.2 s + 1)", "estimate": False},
    ]
    r = random_switching(rng, samples, 2, 20.0)
    result = analysed(tmp_path, v, r, d, disturbance=[{"name": "feed", "column": "feed"}], more=elements)
    found = {(e.output, e.input): e for e in result.elements}
    gain = found["top", "feed"].parameters[0]
    assert gain.changed
    assert gain.ci[0] < 3.8 < gain.ci[1]
    assert outside(result, "closed-form") <= 2
    for place, row in parameters(result, "closed-form").items():
        # nearly as sure as the fit, on which it rests where the feed was estimated along: it is not left in as noise
        own = found[place].parameters[0].std_error
        assert row[0]["std_error"] < (1.9 if place[0] == "top" else 1.6) * own
    assert (
        "feed -> top as the fit estimated it along; feed -> bottom as declared"
        in result.to_dict()["methods"]["assumed"]
    )
    assert result.to_dict()["methods"]["agreement"] == [agreement]


def test_closed_form_is_refused_where_setpoint_and_pv_act_differently(tmp_path):
    rng = np.random.default_rng(14)
    v = coloured(rng, 800, 2, [1, -0.8], [1], 0.1)
    laws = [law | {"setpoint_weight": 0.5} for law in LAWS]
    declared = [{"output": "top", "kind": "ar1", "std": 0.2, "time_constant": 5.0}]
    result = analysed(tmp_path, v, random_switching(rng, 800, 2, 20.0), controller=laws, unmeasured=declared)
    assert "otherwise on its set-point" in result.to_dict()["methods"]["not_applied"][WITH_CLOSED_FORM]
    assert {(e["output"], e["input"]) for e in result.to_dict()["methods"][WITH_FIT]} == {
        ("top", "reflux"),
        ("top", "steam"),
    }


def test_where_a_disturbance_could_have_been_the_mismatch_it_is_said(tmp_path):
    """Two short set-point steps and a random walk declared far larger than anything there."""
    rng = np.random.default_rng(13)
    samples = 400
    r = np.zeros((samples, 2))
    r[100:, 0], r[250:, 1] = 1.0, 1.0
    v = coloured(rng, samples, 2, [1, -0.8], [1], 0.02)
    result = analysed(tmp_path, v, r, unmeasured=[{"output": "bottom", "kind": "step", "std": 5.0}])
    notes = [note for note in result.notes if note.code == "mismatch-or-disturbance"]
    assert any(note.where == "reflux -> bottom" for note in notes)
    assert all("bottom" in note.where for note in notes)


@pytest.mark.slow
def test_dead_times_beside_a_declared_colour_are_known_as_well_as_without(tmp_path):
    """A cost with a minimum in every sample interval: by its curvature in one, 13 of 37 intervals missed."""
    rng = np.random.default_rng(5)
    samples = 1200
    v = coloured(rng, samples, 2, [1, -0.983], [1], 0.05)
    r = random_switching(rng, samples, 2, 40.0)
    declared = [
        {"output": name, "kind": "ar1", "time_constant": 60.0, "std": float(v[:, i].std())}
        for i, name in enumerate(("top", "bottom"))
    ]
    (tmp_path / "plain").mkdir()
    (tmp_path / "declared").mkdir()
    plain = parameters(analysed(tmp_path / "plain", v, r), "direct")
    beside = parameters(analysed(tmp_path / "declared", v, r, unmeasured=declared), "direct")
    for place, row in plain.items():
        own, other = (next(p for p in found if p["name"] == "dead_time") for found in (beside[place], row))
        assert own["std_error"] >= 0.999 * other["std_error"]
