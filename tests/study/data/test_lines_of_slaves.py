"""What counts as held, as moved and as known of the slave of a cascade: each line held from both sides."""

from __future__ import annotations

from types import SimpleNamespace as Stub
from typing import Any

import numpy as np
import pytest

from support.simulated import segment_of
from trueplant.record.types import Segment
from trueplant.study.data import cascade

Array = np.ndarray


def segment(u: Array, y: Array) -> Segment:
    """A record (simulated) of one set-point and one measurement of a slave."""
    columns = {"r": u[:, None], "u": u[:, None], "y": y[:, None]}
    return segment_of(Stub(h=1.0, t=np.arange(u.size, dtype=float), **columns))  # type: ignore[arg-type]


@pytest.mark.holds("study.SLAVE_KNOWN")
@pytest.mark.parametrize(("share", "looked_at"), [(0.86, False), (0.93, True)])
def test_a_stretch_is_looked_at_in_which_nine_tenths_of_a_slaves_setpoint_are_known(
    share: float, looked_at: bool
) -> None:
    n = 200
    sp = np.where(np.arange(n) < share * n, np.sin(np.arange(n) / 10), np.nan)[:, None]
    whole = segment(np.zeros(n), np.zeros(n))
    record: Any = Stub(t=whole.t, slave_sp=sp, slave_pv=np.zeros((n, 1)))
    assert bool(cascade._segments(record, [whole], 0)) is looked_at


@pytest.mark.holds("study.AT_LEVEL")
@pytest.mark.parametrize(("end", "held"), [(0.85, True), (0.91, False)])
def test_a_slave_is_held_at_an_end_that_lies_well_within_what_is_asked_of_it(end: float, held: bool) -> None:
    """Its set-point goes from 0 to 1 and clearly beyond where it stops, or not."""
    sp = np.linspace(0.0, 1.0, 2000)
    high, _ = cascade._held([segment(sp, np.minimum(sp, end))])
    assert (high > 0) is held


@pytest.mark.holds("study.CLEARLY")
@pytest.mark.parametrize(("moved", "held"), [(0.18, False), (0.35, True)])
def test_a_slave_is_held_while_its_setpoint_moves_by_five_times_what_it_may_move_itself(
    moved: float, held: bool
) -> None:
    """By 0.05."""
    sp, pv = np.zeros(200), np.zeros(200)
    pv[100:150], sp[100:150] = 1.0, np.linspace(1.2, 1.2 + moved, 50)
    assert (cascade._share(sp, pv, 0.05) > 0) is held
