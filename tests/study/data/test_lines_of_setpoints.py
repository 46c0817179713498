"""Are set-points computed from the PVs, and do PVs answer to them? Each line is held from both of its sides."""

from __future__ import annotations

from types import SimpleNamespace as Stub

import numpy as np
import pytest
from numpy.typing import NDArray

from support.simulated import segment_of
from trueplant.record import Segment
from trueplant.study.data import excitation, setpoints

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


def asked(samples: int) -> excitation.Asked:
    found = excitation.Asked.of([walk(samples)], [walk(samples)[:, None]])
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
