"""Where the lines are in the planning of tests that no significance level draws: each held from both of its sides."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace as Stub
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from support.simulated import segment_of
from trueplant.errors import LoopError
from trueplant.identify import Spec
from trueplant.lti import Structure, TransferMatrix
from trueplant.study.experiment import known, open_questions, plans, stand
from trueplant.study.experiment.moves import Moves

Array = NDArray[np.float64]
FOPDT = Structure.parse("fopdt")
PLANT = TransferMatrix.of([["2 exp(-1 s)/(3 s + 1)"]])


# -- what is known ---------------------------------------------------------------------------------------------------


@pytest.mark.holds("study.SHORTEST_SLOWEST")
def test_the_slowest_element_takes_ten_samples_at_least() -> None:
    _, slowest = known.known_of({}, 2.0)
    assert 14 < slowest < 28


@pytest.mark.holds("study.USUAL_DAMPING")
def test_a_pair_of_which_nothing_is_known_overshoots_by_a_twentieth() -> None:
    structure = Structure.parse("pair")
    (damping,) = known._unknown(structure, 100.0)[structure.is_damping]
    assert 0.02 < np.exp(-np.pi * damping / np.sqrt(1 - damping**2)) < 0.1


@pytest.mark.holds("study.DRAWN_SPREAD")
@pytest.mark.parametrize(("error", "drawn"), [(0.7, 0.7), (5.0, 1.0)])
def test_a_gain_is_drawn_from_what_is_known_of_it_but_not_wider_than_half_of_itself(error: float, drawn: float) -> None:
    spec = Spec(0, FOPDT, (2.0, 10.0, 5.0))
    theta = np.array([2.0, 10.0, 5.0])
    own: Any = Stub(
        fit=Stub(row=Stub(specs=(spec,), lag=lambda m, p: 10.0), theta=theta),
        covariance=np.diag([error**2, 1e-4, 1e-4]),
        elements=[(spec, slice(0, 3))],
        without_dynamics=lambda spec, part: False,
    )
    possible = open_questions.possible_plants(Stub(n_u=1), {0: own}, PLANT, None)  # type: ignore[arg-type]
    assert np.sqrt(possible.rows[0].covariance[0, 0]) == pytest.approx(drawn)


# -- the stand -------------------------------------------------------------------------------------------------------


def tried_on(settles: Callable[[int], bool], monkeypatch: Any) -> int:
    """Plants that plans are tried on if today's loop is stable on the drawn ones of these numbers."""
    rest = Stub(now=np.zeros(2), wandered=lambda samples, rng: np.zeros(2))
    monkeypatch.setattr(stand, "_settles", lambda bench: bench.plant == "estimated" or settles(bench.plant))
    monkeypatch.setattr(stand.Rest, "of", lambda *given: rest)
    monkeypatch.setattr(stand.Trial, "of", lambda *given: None)
    monkeypatch.setattr(stand, "_room", lambda *given: None)
    for name in ("_drift", "_disturbance"):
        monkeypatch.setattr(stand, name, lambda *given: 0.0)
    monkeypatch.setattr(stand, "_scatter", lambda *given: {})
    possible: Any = Stub(draw=lambda count, seed: Stub(count=count, plant=lambda k: k))
    bench = stand.Bench("estimated", None, 1.0, 1)  # type: ignore[arg-type]
    study: Any = Stub(project=Stub(analysis=Stub(seed=0)))
    return len(stand.stand_of(study, {}, bench, possible, (10.0, 10), ()).trials)


@pytest.mark.holds("study.PLANS_TRIED_ON")
def test_a_plan_has_to_keep_the_limits_on_sixty_plants(monkeypatch: Any) -> None:
    assert 42 < tried_on(lambda k: True, monkeypatch) < 85


@pytest.mark.holds("study.FEWEST_TRIED_ON")
def test_nothing_is_planned_where_todays_loop_is_stable_on_fewer_than_ten_of_the_plants(monkeypatch: Any) -> None:
    assert tried_on(lambda k: k < 15, monkeypatch) == 15
    with pytest.raises(LoopError, match="run away on nearly all"):
        tried_on(lambda k: k < 7, monkeypatch)


@pytest.mark.holds("study.DRAWN_AT_MOST", "study.PLANS_TRIED_ON")
def test_stable_plants_are_looked_for_among_three_hundred(monkeypatch: Any) -> None:
    assert tried_on(lambda k: k >= 200, monkeypatch) >= 20
    with pytest.raises(LoopError, match="run away on nearly all"):
        tried_on(lambda k: k >= 450, monkeypatch)


def rest_of(samples: int, spike: int) -> stand.Rest:
    """Of a loop in manual whose PV rests but for a single sample; its slowest element takes ten samples."""
    y = np.zeros((samples, 1))
    y[spike] = 1.0
    still = np.zeros((samples, 1))
    segment = segment_of(Stub(h=1.0, t=np.arange(float(samples)), r=still, u=still, y=y))  # type: ignore[arg-type]
    study: Any = Stub(loop_experiment=None, segments=[segment])
    return stand.Rest.of(study, stand.Bench(PLANT, None, 1.0, 1), 10.0)


@pytest.mark.holds("study.WANDERS")
def test_pv_wanders_by_its_means_over_the_slowest_lag() -> None:
    """Ten samples, to the mean of which one sample adds a tenth."""
    assert 0.07 < np.max(rest_of(400, 200).before[:, 0]) < 0.15


@pytest.mark.holds("study.LONGEST_PLAN")
@pytest.mark.parametrize(("ago", "counts"), [(1000, True), (2200, False)])
def test_how_pv_wanders_is_told_from_the_last_150_slowest_lags(ago: int, counts: bool) -> None:
    assert bool(np.any(rest_of(4000, 4000 - ago).before)) is counts


@pytest.mark.holds("study.PERCENT")
def test_a_signal_in_percent_is_taken_to_end_at_0_and_100() -> None:
    """OP went from 1 to 90 % and is at 30 %: as far again to both sides it cannot go."""
    u = np.array([[1.0], [90.0]])
    segment = Stub(experiment=0, y=np.zeros((2, 0)), u=u)
    op = Stub(name="u", span=None, unit="%")
    project = Stub(outputs=[], inputs=[op], experiments=[Stub(limits=[None])])
    study: Any = Stub(loop_experiment=None, segments=[segment], project=project)
    room = stand._room(study, np.array([30.0]))
    assert (room.low[0], room.high[0]) == (-30.0, 70.0)


# -- moves -----------------------------------------------------------------------------------------------------------


def offered(first_of_two: bool, monkeypatch: Any) -> list[Moves]:
    """Moves of one OP that moved by 3 to each side in the record; the slowest element takes a hundred samples."""
    monkeypatch.setattr(plans, "_seen", lambda study, closed: np.array([3.0]))
    bench = Stub(controller=None, h=1.0, channels=1)
    begun: Any = Stub(bench=bench, slowest=100.0, room=None, today=Stub(share=lambda course, room: (1.0, "")))
    question: Any = Stub(study=None, first_of_two=first_of_two, longest=1e5)
    return [moves for moves, _ in plans._candidates(question, begun) if moves is not None]


@pytest.mark.holds("study.MOVE_INTERVALS")
def test_moves_come_every_half_lag_to_every_four_lags(monkeypatch: Any) -> None:
    intervals = [moves.interval[0] for moves in offered(False, monkeypatch)]
    assert 35 < min(intervals) < 70
    assert 280 < max(intervals) < 570


@pytest.mark.holds("study.LARGER_MOVES")
def test_moves_are_twice_as_large_as_the_record_saw_but_not_in_the_first_of_two_tests(monkeypatch: Any) -> None:
    assert all(5 < moves.size[0] < 8 for moves in offered(False, monkeypatch))
    assert all(moves.size[0] == 3 for moves in offered(True, monkeypatch))


# -- how long --------------------------------------------------------------------------------------------------------


@pytest.mark.holds("study.PLAN_SAMPLES")
@pytest.mark.parametrize(("samples", "possible"), [(70_000, True), (150_000, False)])
def test_a_test_has_a_hundred_thousand_samples_at_most(samples: int, possible: bool) -> None:
    project = Stub(time_unit="min", analysis=Stub(longest_test=0.5 * samples))
    study: Any = Stub(project=project, segments=[Stub(h=0.5)])
    assert (plans._longest(study) == 0.5 * samples) is possible


@pytest.mark.holds("study.LONGEST_FORETOLD")
@pytest.mark.parametrize(("times", "foretold"), [(70, True), (150, False)])
def test_a_test_is_foretold_that_takes_a_hundred_times_what_was_tried_out(
    times: int, foretold: bool, monkeypatch: Any
) -> None:
    """What matters is known well enough once it is told so many times as much."""
    told = np.full((1, 1, 1), 400 / times)
    monkeypatch.setattr(plans, "information", lambda *given: (told, np.array([10.0])))
    monkeypatch.setattr(plans, "combined", lambda existing, told: 1 / told)
    matter = open_questions.Matter((0, 0), slice(0, 1), np.ones((1, 1), dtype=complex), 0.2)
    own: Any = Stub(fit=None, estimate=Stub(predicted_by=None), covariance=None)
    question = plans.Question(Stub(columns=("u",)), {0: own}, (), (matter,), 1e5)  # type: ignore[arg-type]
    covariances, _ = question.after(np.zeros((10, 1)), 1.0)
    assert question.goals_reached(covariances).any() == foretold


def kept_within(share: Callable[[Array], float], monkeypatch: Any) -> bool:
    """Is there a plan of a hundred samples, if that share of its moves keeps the limits?"""
    plan = plans.Plan(Moves({0: 1.0}, {0: 10.0}), 100.0)
    monkeypatch.setattr(plans, "_shortest", lambda question, stand, moves: plan)
    monkeypatch.setattr(plans, "_settled", lambda question, stand, plan: plan)
    begun: Any = Stub(bench=Stub(h=1.0, channels=1), slowest=10.0, share=lambda course: (share(course), "PV"))
    question: Any = Stub(longest=480.0)
    return bool(np.isfinite(plans._kept_within(question, begun, plan).length))


@pytest.mark.holds("study.SETTLING")
@pytest.mark.parametrize(("after", "kept"), [(35, False), (70, True)])
def test_limits_are_to_be_kept_for_five_lags_after_the_last_move(after: int, kept: bool, monkeypatch: Any) -> None:
    """A PV that leaves them so many samples after it, where the slowest lag takes ten."""
    assert kept_within(lambda course: 1.0 if len(course) <= 100 + after else 0.0, monkeypatch) is kept


@pytest.mark.holds("study.SIZED_TWICE")
@pytest.mark.parametrize(("rounds", "kept"), [(4, True), (8, False)])
def test_a_plan_is_made_smaller_six_times(rounds: int, kept: bool, monkeypatch: Any) -> None:
    shares = [0.9] * rounds
    assert kept_within(lambda course: shares.pop() if shares else 1.0, monkeypatch) is kept
