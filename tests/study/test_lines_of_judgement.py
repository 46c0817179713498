"""Where the lines are that no significance level draws: each held from just inside and from just outside of it."""

from __future__ import annotations

from types import SimpleNamespace as Stub
from typing import Any

import numpy as np
import pytest

from support.simulated import segment_of
from trueplant.calendar import Calendar
from trueplant.errors import LoopError
from trueplant.loop import PID, Controller, Kind, Simulation
from trueplant.lti.measured import MeasuredStep
from trueplant.mismatch import hold_response
from trueplant.record.types import Finding
from trueplant.record.types import Kind as Found
from trueplant.result import LawRatio, LoopMargins
from trueplant.study.data import cascade, controller_check, declared, excitation, law_judged, setpoints, tables
from trueplant.study.experiment import plans
from trueplant.study.experiment.open_questions import Matter
from trueplant.study.loops import robustness, settled, targets
from trueplant.study.methods.agreement import Difference, Estimated, _disagreement
from trueplant.study.methods.paper_forms import why_not
from trueplant.study.plant.causes import _saturated

Array = np.ndarray
RNG_SEED = 1


# -- data ------------------------------------------------------------------------------------------------------------


@pytest.mark.holds("study.MOSTLY_MANUAL")
@pytest.mark.parametrize(("share", "said"), [(0.4, False), (0.6, True)])
def test_manual_for_more_than_half_of_a_record_is_said(share, said):
    automatic = (np.arange(100) >= 100 * share)[:, None]
    record = Stub(closed=True, inputs=("u",), automatic=automatic, name="run")
    study: Any = Stub(screened=[Stub(record=record, refusal=None)])
    assert bool(excitation.manual_notes(study)) is said


@pytest.mark.holds("study.FILLED_IN")
@pytest.mark.parametrize(("share", "said"), [(0.2, False), (0.4, True)])
def test_a_signal_of_which_the_historian_filled_in_a_third_is_named(share, said):
    finding = Stub(kind="compressed", value=1 - share, signal="pv")
    study: Any = Stub(screened=[Stub(refusal=None, findings=[finding], record=Stub(name="run"))])
    assert bool(excitation.compression_notes(study)) is said


@pytest.mark.holds("study.COINCIDENT")
@pytest.mark.parametrize(("ratio", "before"), [(3.0, True), (6.0, False)])
def test_a_pv_that_jumps_with_its_setpoint_was_not_read_before_it(ratio, before):
    """Changes of PV at the moves, squared, over those elsewhere."""
    at = np.arange(10, 400, 10)
    change = np.where(np.arange(400) % 2, 1.0, -1.0)
    change[at] *= np.sqrt(ratio)
    assert setpoints._in_time(np.cumsum(change), None, at) is before


@pytest.mark.holds("study.ALONG")
@pytest.mark.parametrize(("along", "before"), [(0.4, True), (0.6, False)])
def test_so_was_one_that_goes_along_with_a_setpoint_that_always_moves(along, before):
    asked, other = np.tile([1.0, 1.0, -1.0, -1.0], 100), np.tile([1.0, -1.0, -1.0, 1.0], 100)
    step = along * asked + np.sqrt(1 - along**2) * other
    step[0] = asked[0] = 0.0
    assert setpoints._in_time(np.cumsum(step), np.cumsum(asked), np.arange(1, 400)) is before


def follows(left: float, odd: float) -> bool:
    """A set-point that is -0.3 PV but for a share `left` of its moves, squared, and one move larger by `odd` rms."""
    rng = np.random.default_rng(RNG_SEED)
    n = 4000
    y = np.cumsum(rng.standard_normal(n))
    r = -0.3 * y
    size = np.std(np.diff(r))
    r = r + np.sqrt(left) * size * rng.standard_normal(n)
    r[n // 2 :] += odd * size
    columns = {name: x[:, None] for name, x in (("r", r), ("u", r - y), ("y", y))}
    sim: Any = Stub(h=1.0, t=np.arange(n, dtype=float), **columns)
    return bool(setpoints.computed_setpoints([segment_of(sim)])[0])


@pytest.mark.holds("study.UNEXPLAINED", "study.SURPRISE")
@pytest.mark.parametrize(
    ("left", "odd", "computed"), [(6e-4, 0, True), (1.6e-3, 0, False), (0, 0.19, True), (0, 0.35, False)]
)
def test_a_setpoint_is_computed_if_the_pvs_explain_all_of_it_and_every_single_move(left, odd, computed):
    assert follows(left, odd) is computed


# -- controllers -----------------------------------------------------------------------------------------------------


@pytest.mark.holds("study.GAIN_OFF", "study.TIME_OFF", "study.LAW_SURE")
@pytest.mark.parametrize(
    ("kind", "value", "std", "off"),
    [
        (Kind.GAIN, 1.04, 0.001, False),
        (Kind.GAIN, 1.06, 0.001, True),
        (Kind.INTEGRAL, 1.10, 0.001, False),
        (Kind.INTEGRAL, 1.14, 0.001, True),
        (Kind.GAIN, 1.10, 0.04, False),  # 2.5 standard errors
        (Kind.GAIN, 1.10, 0.029, True),  # 3.4
    ],
)
def test_a_gain_that_is_off_by_half_of_a_tenth_and_a_time_by_half_of_a_quarter(kind, value, std, off):
    assert law_judged.Ratio(0, kind, kind is Kind.GAIN, value, std).off is off


@pytest.mark.parametrize(
    ("kind", "value", "std", "known"),
    [
        (Kind.GAIN, 1.00, 0.029, True),
        (Kind.GAIN, 1.00, 0.031, False),  # 0.907 is left
        (Kind.GAIN, 1.04, 0.018, True),
        (Kind.GAIN, 1.04, 0.022, False),  # 1.106 is
        (Kind.GAIN, 0.96, 0.018, False),  # 0.906
        (Kind.INTEGRAL, 1.10, 0.045, True),
        (Kind.INTEGRAL, 1.10, 0.055, False),  # its inverse is what is judged: 1.265
        (Kind.INTEGRAL, -0.10, 0.01, False),
    ],
)
def test_a_gain_or_time_is_known_if_none_that_has_to_be_found_out_is_within_three_standard_errors(
    kind, value, std, known
):
    assert law_judged.Ratio(0, kind, kind is Kind.GAIN, value, std).known is known


@pytest.mark.holds("study.BETWEEN_OFF")
@pytest.mark.parametrize(("gain", "off"), [(1.4, False), (1.6, True), (0.7, False), (0.6, True)])
def test_a_law_that_acts_between_the_samples_may_come_out_half_as_high_again(gain, off):
    law = Controller.diagonal([PID(Kc=1.0, Ti=10.0)])
    assert controller_check._far_off([LawRatio("y", "gain", gain, 0.001)], law, 0) is off


@pytest.mark.holds("study.WHOLE_SCAN")
def test_a_scan_is_whole_samples_to_a_thousandth():
    segment, u = segment_of(record(np.zeros(40))), np.arange(40.0)
    assert controller_check._scan(segment, [5.004], u)[0] == 5
    with pytest.raises(LoopError, match="whole multiple"):
        controller_check._scan(segment, [5.008], u)


# -- cascades --------------------------------------------------------------------------------------------------------


@pytest.mark.holds("study.FOLLOWS", "study.HELD", "study.STUCK")
@pytest.mark.parametrize(
    ("slave", "words"),
    [
        ({"gain": 1.3}, "does 1.3 of what is asked"),
        ({"gain": 1.2}, "neither lag nor gain"),
        ({"high": 0.03}, "at its upper end"),
        ({"high": 0.015}, "neither lag nor gain"),
        ({"stuck": 0.07}, "it sticks"),
        ({"stuck": 0.03}, "neither lag nor gain"),
    ],
)
def test_why_a_slave_does_not_follow(slave, words):
    usual = {"gain": 1.0, "lag": 0.0, "deviation": 0.2, "at": 0.1, "high": 0.0, "low": 0.0, "stuck": 0.0}
    assert words in cascade._why(cascade._Slave(**(usual | slave)), "min")


@pytest.mark.holds("study.PLATEAU")
@pytest.mark.parametrize(("samples", "counts"), [(7, False), (15, True)])
def test_a_slave_is_held_from_ten_samples_on(samples, counts):
    sp = np.linspace(0.0, 0.4, 200) % 0.2
    pv = sp.copy()
    pv[100 : 100 + samples], sp[100 : 100 + samples] = 1.0, np.linspace(1.2, 3.0, samples)
    assert (cascade._share(sp, pv, 0.05) > 0) is counts


@pytest.mark.holds("study.WORKING")
@pytest.mark.parametrize(("slow", "low"), [(0.93, True), (0.86, False)])
def test_the_band_of_a_slave_holds_nine_tenths_of_the_power_of_op(slow, low):
    """Two sines, the slow one with that share of the power."""
    t = np.arange(400)
    u = np.sqrt(slow) * np.sin(2 * np.pi * t / 100) + np.sqrt(1 - slow) * np.sin(2 * np.pi * t / 10)
    study: Any = Stub(records=Stub(linear=[None]))
    top, _ = cascade._bandwidth(study, 0, 0, None, [segment_of(record(u))])  # type: ignore[arg-type]
    assert (top < 0.1) is low


@pytest.mark.holds("study.OWN_SETPOINT")
@pytest.mark.parametrize(("shared", "is_op"), [(0.93, True), (0.86, False)])
def test_the_setpoint_of_a_slave_is_op_if_a_tenth_at_most_is_its_own(shared, is_op):
    t = np.arange(400)
    op, own = np.sin(2 * np.pi * t / 100), np.cos(2 * np.pi * t / 100)
    asked = np.sqrt(shared) * op + np.sqrt(1 - shared) * np.sin(2 * np.pi * t / 10)
    assert own.size and cascade._asked([segment_of(record(asked, op))]) is is_op


@pytest.mark.holds("study.T_KNOWN")
@pytest.mark.parametrize(("std", "told"), [(0.2, True), (0.3, False)])
def test_a_slave_that_is_known_to_a_quarter_tells_whether_it_follows(std, told, monkeypatch):
    w = np.linspace(0.001, 0.01, 10)
    one, size = np.ones((10, 1, 1)), std * np.abs(hold_response(w, 1.0))[:, None, None]
    response = Stub(w=w, value=one.astype(complex), std=size, h=1.0, points=10)
    monkeypatch.setattr(cascade, "local_response", lambda segments, form: response)
    monkeypatch.setattr(cascade, "_bandwidth", lambda *given: (0.01, "where OP moves"))
    names = [Stub(name="flow")]
    study: Any = Stub(project=Stub(experiments=names, inputs=names, time_unit="min"))
    still = segment_of(record(np.arange(9.0)))
    found = cascade._checked(study, 0, 0, None, [still])  # type: ignore[arg-type]
    assert (found.follows is True) is told


def record(u: Array, r: Array | None = None) -> Simulation:
    """A record (simulated) of one OP and nothing else."""
    r = np.zeros(u.size) if r is None else r
    stub: Any = Stub(h=1.0, t=np.arange(u.size, dtype=float), u=u[:, None], r=r[:, None], y=np.zeros((u.size, 1)))
    return stub


# -- plant and methods -----------------------------------------------------------------------------------------------


@pytest.mark.holds("study.WORTH_SAYING_AT_LIMIT")
@pytest.mark.parametrize(("share", "said"), [(0.015, False), (0.03, True)])
def test_a_valve_at_its_limit_is_said_from_a_fiftieth_of_the_samples_on(share, said):
    at = (np.arange(1000) < 1000 * share)[:, None]
    used = np.ones((1000, 1), dtype=bool)
    one = Stub(refusal=None, saturated=at, usable_y=used, record=Stub(name="run"))
    study: Any = Stub(screened=[one], project=Stub(input_names=("u",)))
    assert bool(_saturated(study)) is said


@pytest.mark.holds("study.HOPELESS")
@pytest.mark.parametrize(("error", "hopeless"), [(0.4, False), (0.6, True)])
def test_a_method_has_nothing_to_say_of_a_gain_that_it_knows_to_half(error, hopeless):
    answer = Estimated({(0, 0): np.array([-1.0])}, {(0, 0): np.array([[error**2]])})
    assert answer.hopeless((0, 0)) is hopeless


@pytest.mark.holds("study.MOST_AT_LIMIT")
@pytest.mark.parametrize(("share", "linear"), [(0.04, True), (0.06, False)])
def test_a_loop_with_op_at_a_limit_for_a_twentieth_is_no_linear_one(share, linear, monkeypatch):
    monkeypatch.setattr("trueplant.study.methods.paper_forms.not_stationary", lambda study: "")
    free = (np.arange(100) >= 100 * share)[:, None]
    segment: Any = Stub(closed=True, free=free, experiment=0)
    study: Any = Stub(project=Stub(analysis=Stub(method="auto")))
    monkeypatch.setattr("trueplant.study.methods.paper_forms._in_closed_loop", lambda every, name: True)
    monkeypatch.setattr("trueplant.study.methods.paper_forms._segments", lambda every, closed: every)
    assert (why_not(study, [segment], "joint") is None) is linear


@pytest.mark.holds("study.STEP_NEGLIGIBLE")
@pytest.mark.parametrize(("deviation", "outside"), [(0.008, False), (0.013, True)])
def test_a_declared_step_response_may_leave_the_band_by_a_hundredth_of_its_size(deviation, outside):
    t = np.arange(1.0, 6.0)
    step = MeasuredStep(np.concatenate([[0.0], np.full(5, 1.0)]), 1.0)
    inside = np.interp(np.concatenate([[0.0], t]), step.t, step.values)
    high = inside - deviation
    found = declared._outside(step, np.concatenate([[0.0], t]), high - 1.0, high)
    assert bool(found) is outside


@pytest.mark.holds("study.MOST_SPANS")
@pytest.mark.parametrize(("spans", "whole"), [(15, True), (30, False)])
def test_a_finding_lists_twenty_stretches(spans, whole):
    finding = Finding(Found.MISSING, "pv", "", tuple((float(k), k + 0.5) for k in range(spans)))
    assert (len(tables._finding(finding, Calendar("min")).spans) == spans) is whole


@pytest.mark.holds("study.SHOWN_SPANS")
@pytest.mark.parametrize(("spans", "more"), [(3, False), (5, True)])
def test_a_note_names_three_stretches_outside_of_the_band(spans, more):
    step = Stub(outside=[(k, k + 0.5) for k in range(spans)])
    study: Any = Stub(project=Stub(time_unit="min", analysis=Stub(confidence=0.95)))
    (note,) = declared.band_notes(study, [Stub(declared_step=step, input="u", output="y")])  # type: ignore[list-item]
    assert ("more" in note.message) is more


@pytest.mark.holds("study.MOST_NAMED")
@pytest.mark.parametrize(("parameters", "more"), [(3, False), (6, True)])
def test_a_disagreement_names_four_parameters(parameters, more):
    study: Any = Stub(columns=("u",), project=Stub(output_names=("y",)))
    clear = [Difference(0, 0, f"gain_{k}", 1.0, 2.0, 0.0) for k in range(parameters)]
    assert ("more" in _disagreement(study, "joint", clear, ())) is more


# -- loops -----------------------------------------------------------------------------------------------------------


@pytest.mark.holds("study.HIGHEST_MS")
@pytest.mark.parametrize(("peak", "worse"), [(1.8, False), (2.5, True)])
def test_a_sensitivity_peak_above_2_is_close_to_instability(peak, worse):
    model, plant = (LoopMargins("u", True, None, None, None, Ms, None) for Ms in (None, peak))
    assert robustness._worse(model, plant) is worse


@pytest.mark.holds("study.REFUTED_SHARE")
@pytest.mark.parametrize(("share", "refuted"), [(0.94, False), (0.96, True)])
def test_a_loop_that_settled_refutes_what_lets_it_run_away_on_95_percent_of_the_plants(share, refuted, monkeypatch):
    segment = Stub(experiment=0, t=np.arange(5.0))
    monkeypatch.setattr(settled, "updated_plant", lambda model, estimates: Stub(nominal=None, rows={0: None}))
    monkeypatch.setattr(settled, "_settled", lambda study, checks: segment)
    monkeypatch.setattr(settled, "share_diverging", lambda *given: share)
    project = Stub(analysis=Stub(seed=0), experiments=[Stub(name="run")])
    study: Any = Stub(model=None, loop=lambda plant: 1, project=project)
    one = Stub(without_answers=lambda *why: "refuted")
    monkeypatch.setattr(settled, "replace", lambda identified, estimates: estimates)
    after = settled.against_settled_loop(study, Stub(estimates={0: one}), [])  # type: ignore[arg-type]
    assert (after == {0: "refuted"}) is refuted


@pytest.mark.holds("study.RUNS_AWAY")
@pytest.mark.parametrize(("growth", "still"), [(2.6, True), (3.8, False)])
def test_a_loop_has_settled_if_its_error_did_not_grow_tenfold_over_the_record(growth, still):
    """Over half of the record by the root of that."""
    y = np.tile([1.0, -1.0], 50)
    y[50:] *= growth
    segment: Any = Stub(experiment=0, y=y[:, None], r=np.zeros((100, 1)), __len__=lambda: 100)
    part = segment_of(record(np.zeros(100)))
    object.__setattr__(part, "y", segment.y)
    study: Any = Stub(loop_experiment=0, project=Stub(experiments=[Stub(name="run")]), segments=[part])
    found = settled._settled(study, [Stub(experiment="run", confirmed=True)])  # type: ignore[list-item]
    assert (found is not None) is still


# -- test plans ------------------------------------------------------------------------------------------------------


def question(*now: float) -> plans.Question:
    matters = tuple(Matter((0, 0), slice(0, 1), np.ones((1, 1), dtype=complex), one) for one in now)
    project = Stub(time_unit="min", analysis=Stub(longest_test=None, confidence=0.95))
    study: Any = Stub(project=project, segments=[Stub(h=1.0)])
    return plans.Question(study, {}, (), matters, 480.0)


@pytest.mark.holds("study.MATTERS", "study.MATTERS_SURE")
@pytest.mark.parametrize(("error", "well"), [(0.04, True), (0.06, False)])
def test_two_standard_errors_of_a_tenth_of_the_answer_do_not_matter(error, well):
    assert question(0.2).reached({0: np.array([[[error**2]]])}).all() == well


@pytest.mark.holds("study.HARDLY_KNOWN")
@pytest.mark.parametrize(("now", "first"), [(0.4, False), (0.6, True)])
def test_what_is_hardly_known_needs_a_first_test(now, first):
    assert question(now).first_of_two is first


@pytest.mark.holds("study.FIRST_PRECISION")
@pytest.mark.parametrize(("error", "enough"), [(0.12, True), (0.18, False)])
def test_a_first_test_is_to_bring_it_to_three_tenths(error, enough):
    assert question(0.6).goals_reached({0: np.array([[[error**2]]])}).all() == enough


@pytest.mark.holds("study.SHIFT")
def test_a_test_may_take_a_shift_where_nobody_says_how_long():
    assert plans._longest(question(0.2).study) == 480.0


@pytest.mark.holds("study.SPEED")
@pytest.mark.parametrize(("place", "said"), [(0, "")])
def test_a_proposal_may_be_twice_as_fast_as_today(place, said, monkeypatch):
    monkeypatch.setattr(targets, "crossover", lambda *given: 0.1)
    tuning = Stub(limits=Stub(speed=None))
    study: Any = Stub(project=Stub(tuning=tuning, time_unit="min"))
    today: Any = Stub(plant={(0, 0): None}, controller=None)
    highest, _ = targets._crossover_limit(study, today, (place, place), None)
    assert 0.15 < highest < 0.25
