"""Where the lines of test plans and of settings are that no significance level draws: each held from both sides."""

from __future__ import annotations

from types import SimpleNamespace as Stub
from typing import Any

import numpy as np
import pytest

from support.simulated import segment_of
from trueplant.lti import Structure
from trueplant.project.tables import TuningLimits
from trueplant.study.data import excitation, law_judged, op_law
from trueplant.study.experiment import open_questions, plans, stand
from trueplant.study.experiment.moves import Moves
from trueplant.study.loops import judging
from trueplant.study.methods.paper_forms import short_segments
from trueplant.study.plant import meanwhile

Array = np.ndarray


# -- settings --------------------------------------------------------------------------------------------------------


@pytest.mark.holds("study.LIMIT_MS", "study.LIMIT_SHARE", "study.LIMIT_MU", "study.HIGHEST_MS")
def test_settings_keep_the_limits_of_simc_on_95_percent_of_the_plants_where_nobody_asks_for_others():
    """Tight SIMC settings have an Ms of 1.59 on a lag with dead time (Skogestad 2003); mu of performance is below 1."""
    limits = judging.limits_of(TuningLimits(), weighted=True, changed=False)
    assert limits.Ms == pytest.approx(1.59, abs=0.01)
    assert 0.94 < limits.share < 0.96
    assert limits.mu == 1.0
    assert limits.sound is not None
    assert 1.8 < limits.sound < 2.2
    assert judging.limits_of(TuningLimits(), weighted=False, changed=True).mu is None
    asked = judging.limits_of(TuningLimits(Ms=1.4, share=0.9, mu=0.8), weighted=True, changed=False)
    assert (asked.Ms, asked.share, asked.mu, asked.sound) == (1.4, 0.9, 0.8, 1.4)


# -- controllers -----------------------------------------------------------------------------------------------------


@pytest.mark.holds("study.CONFIRMED", "study.LAW_ROUNDED")
@pytest.mark.parametrize(
    ("left", "scale", "rounding", "confirmed"),
    [(0.015, 1.0, 0.0, True), (0.03, 1.0, 0.0, False), (1.2, 1.0, 1.0, True), (1.8, 1.0, 1.0, False)],
)
def test_a_law_is_confirmed_that_leaves_a_fiftieth_of_op_or_half_as_much_again_as_rounding(
    left, scale, rounding, confirmed
):
    windows: Any = Stub(
        freedom=np.array([100.0]),
        plain=Stub(op_rounding=rounding**2),
        pv_rounding=lambda: 0.0,
        missed=lambda: np.zeros(1),
        labels=(),
    )
    found = law_judged._with(windows, Stub(rms=left), Stub(longest=20), scale, None)  # type: ignore[arg-type]
    assert found.confirmed is confirmed


@pytest.mark.holds("study.LAW_ROUNDED")
@pytest.mark.parametrize(("times", "written"), [(1.2, True), (1.8, False)])
def test_op_is_written_from_its_samples_if_no_more_is_left_than_their_rounding_makes(times, written):
    u = np.tile([1.0, -1.0], 100) * times / np.sqrt(12)
    rows = np.column_stack([u, np.tile([1.0, 1.0, -1.0, -1.0], 50)])
    assert (op_law._left(rows, np.array([1.0, 0.0]), 0.0) <= 1) is written


# -- how much work, how few samples ----------------------------------------------------------------------------------


@pytest.mark.holds("study.MOST_WORK")
@pytest.mark.parametrize(("samples", "refused"), [(400_000, False), (600_000, True)])
def test_sixteen_elements_of_one_output_are_refused_from_half_a_million_samples_on(samples, refused):
    """16 of them took 16 s on 2,000: an hour."""
    study: Any = Stub(specs=[(0, j) for j in range(16)], segments=[range(samples)])
    assert bool(excitation._too_much(study)) is refused


@pytest.mark.holds("study.LARGEST_SEGMENT")
@pytest.mark.parametrize(("samples", "kept"), [(150_000, True), (300_000, False)])
def test_long_segments_are_left_to_the_fit(samples, kept):
    assert bool(short_segments([range(samples)])) is kept  # type: ignore[list-item]


@pytest.mark.holds("study.FEWEST_ERRORS")
@pytest.mark.parametrize(("errors", "compared"), [(150, False), (300, True)])
def test_the_disturbance_of_a_stretch_is_compared_from_200_errors_on(errors, compared, monkeypatch):
    monkeypatch.setattr(meanwhile.TwoFits, "of", lambda *given: "compared")
    pieces = [Stub(y=np.zeros(1000), valid=np.ones(errors, dtype=bool))]
    pair: Any = Stub(fit=Stub(row=Stub(pieces=pieces)), border=500)
    moved: Any = Stub(stretch=lambda begin, end: pieces)
    assert (meanwhile._compared(pair, moved) is not None) is compared


# -- test plans ------------------------------------------------------------------------------------------------------


@pytest.mark.holds("study.SHOWN_WIDENED")
def test_where_no_limits_are_declared_a_signal_may_go_as_far_again_as_the_record_shows():
    low, high = stand._shown([np.array([40.0, 50.0])], None)
    assert 25 < low < 35
    assert 55 < high < 65
    assert stand._shown([np.array([5.0, 50.0])], stand.levels.PERCENT)[0] == 0.0


@pytest.mark.holds("study.LATELY", "study.WELL_AFTER")
@pytest.mark.parametrize(("since", "lags"), [(1.0, 3.0), (6.0, 4.0), (100.0, 10.0)])
def test_op_is_averaged_well_after_the_last_move_and_lately(since, lags):
    """In lags and dead times of the slowest element: at least three, from two after the move on, ten at most."""
    slowest = 100.0
    moves = np.zeros((20_000, 1))
    moves[: -int(since * slowest)] = 1.0
    assert stand._still_for(moves, slowest) == pytest.approx(lags * slowest, rel=0.1)


@pytest.mark.holds("study.SLOW_NOISE")
@pytest.mark.parametrize(("share", "drifts"), [(0.04, False), (0.065, True)])
def test_noise_that_is_slow_beside_its_record_is_taken_for_a_drift(share, drifts):
    """Its time constant, over the length of the record."""
    assert stand._with_drift(np.array([-np.exp(-1 / (share * 1000))]), 1000)[1] is drifts


@pytest.mark.holds("study.LARGER_DISTURBANCE")
def test_the_disturbance_of_a_plan_is_larger_than_the_noise_model_says_but_not_twice_as_large(monkeypatch):
    """White noise of one: short records take a part of it for the plant."""
    segment = segment_of(Stub(h=1.0, t=np.arange(50.0), **{x: np.zeros((50, 1)) for x in "ruy"}))  # type: ignore[arg-type]
    monkeypatch.setattr(stand, "_last", lambda study: segment)
    study: Any = Stub(segments=[segment], model=np.zeros((1, 1)))
    fit = Stub(variance=1.0, ar=np.zeros(1))
    estimate: Any = Stub(fit=fit, row=Stub(stride=1))
    v = stand._disturbance(study, {0: estimate}, {}, 20_000, np.random.default_rng(1))
    assert 1.2 < np.std(v) < 1.8


@pytest.mark.holds("study.LEAST_ROOM")
@pytest.mark.parametrize(("share", "room"), [(0.015, False), (0.03, True)])
def test_limits_that_leave_a_fiftieth_of_the_moves_leave_no_room(share, room, monkeypatch):
    plan = plans.Plan(Moves({0: 1.0}, {0: 10.0}), 100.0)
    begun: Any = Stub(
        bench=Stub(h=1.0, channels=1), slowest=10.0, share=lambda course: (share if not shares else 1.0, "PV")
    )
    shares: list[float] = []
    monkeypatch.setattr(plans, "_shortest", lambda question, stand, moves: shares.append(1.0) or plan)
    monkeypatch.setattr(plans, "_settled", lambda question, stand, plan: plan)
    found = plans._kept_within(Stub(longest=480.0), begun, plan)  # type: ignore[arg-type]
    assert np.isfinite(found.length) == room


@pytest.mark.holds("study.SPAN_PART")
def test_a_setpoint_that_never_moved_is_moved_by_a_twentieth_of_its_span_in_a_plan():
    """As large as the moves of a plan are wished for where a record shows how far they go: twice what it saw."""
    segment = Stub(setpoints=np.zeros((10, 1)), y=np.zeros((10, 1)))
    study: Any = Stub(project=Stub(outputs=[Stub(limits=(0.0, 100.0))], inputs=[]), segments=[segment])
    (seen,) = plans._seen(study, True)
    assert plans.levels.LARGER_MOVES * seen == pytest.approx(5.0)
    assert 2.0 < seen < 3.0


@pytest.mark.parametrize(("half", "is_open"), [(0.08, False), (0.12, True)])
def test_a_parameter_is_open_whose_interval_is_wider_than_a_tenth_of_it(half, is_open, monkeypatch):
    spec: Any = Stub(structure=Structure.parse("fopdt"), initial=(2.0, 10.0, 5.0), column=0)
    theta = np.array([2.0, 10.0, 5.0])
    intervals = np.array([[2 - 2 * half, 2 + 2 * half], [9.9, 10.1], [4.9, 5.1]])
    own: Any = Stub(
        fit=Stub(theta=theta, row=Stub(lag_of_dead_times=lambda theta: np.array([0.0, 0.0, 10.0]))),
        estimate=Stub(intervals=intervals),
        covariance=1e-6 * np.eye(3),
        reasons={},
        hopeless=lambda part: np.zeros(3, dtype=bool),
        without_dynamics=lambda spec, part: False,
    )
    monkeypatch.setattr(open_questions, "_elements", lambda study, known: [(0, spec, slice(0, 3))])
    project = Stub(outputs=[Stub(unit="")], inputs=[Stub(unit="")], time_unit="min")
    found = open_questions.open_parameters(Stub(project=project), {0: own}, 0.95)  # type: ignore[arg-type]
    assert ([one.name for one in found] == ["gain"]) is is_open
