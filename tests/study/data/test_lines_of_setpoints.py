"""Are set-points computed from the PVs, and do PVs answer to them? Each line is held from both of its sides."""

from __future__ import annotations

from types import SimpleNamespace as Stub
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from support.simulated import segment_of
from trueplant.record import Segment
from trueplant.study.data import bank, excitation, setpoints, timing

Array = NDArray[np.float64]


def record(r: Array, y: Array) -> Segment:
    columns = {name: x[:, None] for name, x in (("r", r), ("u", r - y), ("y", y))}
    return segment_of(Stub(h=1.0, t=np.arange(r.size, dtype=float), **columns))  # type: ignore[arg-type]


def computed(r: Array, y: Array) -> bool:
    return bool(setpoints.computed_setpoints([record(r, y)])[0])


def walk(samples: int) -> Array:
    return np.cumsum(np.random.default_rng(1).standard_normal(samples))


@pytest.mark.holds("study.SETPOINT_LAGS")
@pytest.mark.parametrize(("late", "seen"), [(8, True), (15, False)])
def test_a_setpoint_may_be_computed_from_the_pv_of_ten_samples_ago(late: int, seen: bool) -> None:
    y = walk(2000)
    assert computed(-0.3 * np.concatenate([np.full(late, y[0]), y[:-late]]), y) is seen


@pytest.mark.holds("study.SETPOINT_LEVELS")
@pytest.mark.parametrize(("back", "seen"), [(3, True), (6, False)])
def test_it_may_be_computed_from_four_of_its_own_levels_beside(back: int, seen: bool) -> None:
    y, r = walk(2000), np.zeros(2000)
    for k in range(back, r.size):
        r[k] = 0.9 * r[k - back] - 0.3 * y[k]
    assert computed(r, y) is seen


@pytest.mark.holds("study.PREDICTED")
@pytest.mark.parametrize(("size", "counts"), [(0.7e-6, False), (1e-6, True)])
def test_a_sine_is_foretold_by_its_own_past_to_a_millionth(size: float, counts: bool) -> None:
    """A PV and a set-point that is computed from it, with so little noise that neither tells who was first."""
    t = np.arange(4000)
    y = np.sin(2 * np.pi * t / 4) + size * np.random.default_rng(1).standard_normal(t.size)
    assert computed(-0.3 * y, y) is counts


@pytest.mark.holds("study.SETPOINT_MOVES")
def test_a_setpoint_that_always_moves_is_asked_at_its_last_twenty_thousand_moves() -> None:
    y = walk(60_000)
    found = setpoints._rows(record(-0.3 * y, y), 0, True)
    assert found is not None
    assert 14_000 < len(found[0]) < 28_000
    assert found[0][-1] == -0.3 * y[-1] + 0.3 * y[-2]


def asked(samples: int) -> bank.Asked:
    found = bank.Asked.of([walk(samples)], [walk(samples)[:, None]])
    assert found is not None
    return found


@pytest.mark.holds("study.ANSWER_PAST", "study.ANSWER_LAGS")
def test_an_answer_is_what_six_lags_of_a_setpoint_add_to_ten_samples_of_a_pvs_own_past() -> None:
    found = asked(1000)
    assert 7 < found.order < 15
    assert 4 < found.columns.shape[1] - 1 - found.order < 9


@pytest.mark.holds("study.ANSWER_SAMPLES")
def test_it_is_looked_for_in_twenty_thousand_samples_of_a_long_record() -> None:
    assert 14_000 < len(asked(60_000).columns) < 28_000


@pytest.mark.holds("study.ANSWER_BOUND")
def test_a_sample_counts_for_three_standard_deviations_at_most() -> None:
    e = np.random.default_rng(4).standard_normal(20_000)
    e[::500] = 100.0
    weights = bank.bounded_weights(e[:, None])
    assert 2.2 < float(np.max(np.sqrt(weights) * np.abs(e))) < 4.2
    assert np.mean(weights < 1) < 0.02


@pytest.mark.holds("study.MOVES_PER_REGRESSOR")
@pytest.mark.parametrize(("moves", "computed"), [(10, False), (20, True)])
def test_fourteen_moves_are_enough_to_say_that_a_setpoint_is_computed(moves: int, computed: bool) -> None:
    """From PV alone, which takes five regressors: twice that and four."""
    every = 20
    n = every * (moves + 2)
    y = np.cumsum(np.random.default_rng(3).standard_normal(n))
    at = every * (np.arange(n) // every)
    r = np.where(at > 0, -0.3 * y[np.maximum(at - 1, 0)], 0.0)
    assert setpoints._follows([record(r, y)], 0, few=True) is computed


@pytest.mark.holds("study.SAME_PROPORTION")
@pytest.mark.parametrize(("apart", "said"), [(1.4e-3, True), (3e-3, False)])
def test_setpoints_move_in_one_proportion_if_a_thousandth_of_their_moves_is_their_own(
    apart: float, said: bool, monkeypatch: Any
) -> None:
    """Half of what tells the second from the first, beside what both have in common."""
    monkeypatch.setattr(excitation, "computed_somewhere", lambda study: np.zeros(2, dtype=bool))
    common, own = np.tile([1.0, 1.0, -1.0, -1.0], 50), np.tile([1.0, -1.0, -1.0, 1.0], 50)
    r = np.cumsum(np.column_stack([common, common + apart * own]), axis=0)
    study: Any = Stub(segments=[Stub(closed=True, r=r, setpoints=r)], project=Stub(output_names=("y1", "y2")))
    assert bool(excitation.setpoint_rank_note(study)) is said


@pytest.mark.holds("study.OFF_GRID")
@pytest.mark.parametrize(("interval", "stale"), [(2.03, False), (2.08, True)])
def test_a_pv_that_is_updated_every_other_sample_is_not_stale(interval: float, stale: bool) -> None:
    screened = [Stub(refusal=None, update_interval=np.array([interval]))]
    study: Any = Stub(screened=screened, segments=[Stub(h=1.0)], between=False)
    assert (timing.timing_error(study) > 0) is stale
