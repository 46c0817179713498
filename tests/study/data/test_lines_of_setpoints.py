"""Where the lines are in the search for set-points that are computed from the PVs: each held from both of its sides."""

from __future__ import annotations

from types import SimpleNamespace as Stub
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from support.simulated import segment_of
from trueplant.study.data import excitation, setpoints

Array = NDArray[np.float64]


def computed(r: Array, y: Array) -> bool:
    columns = {name: x[:, None] for name, x in (("r", r), ("u", r - y), ("y", y))}
    sim: Any = Stub(h=1.0, t=np.arange(r.size, dtype=float), **columns)
    return bool(setpoints.computed_setpoints([segment_of(sim)])[0])


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


@pytest.mark.holds("study.ANSWER_PAST")
def test_an_answer_to_setpoints_is_what_ten_samples_of_its_own_past_leave() -> None:
    asked = excitation.Asked.of([walk(1000)], [walk(1000)[:, None]])
    assert asked is not None
    assert 7 < asked.order < 15
