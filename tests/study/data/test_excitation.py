"""Does anything move the plant from outside? All records are simulated."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from support.chance import most
from support.simulated import coloured, random_switching
from trueplant.loop import PID, Controller, simulate
from trueplant.lti import TransferMatrix
from trueplant.record import Segment
from trueplant.study.data.excitation import excited

PLANT = TransferMatrix.of([["2 exp(-3.4 s)/(12 s + 1)"]], "min")
PI = Controller.diagonal([PID(Kc=0.8, Ti=12.0, sample_time=1.0)])
FEED = TransferMatrix.of([["3 exp(-1.2 s)/(4 s + 1)"]], "min")


def opened(seed: int, size: float) -> Segment:
    """An open loop under a feed of many times what OP does to PV, which is many times the noise."""
    rng = np.random.default_rng(seed)
    d, u = coloured(rng, 1200, 1, [1, -0.7], [1], 1.0), random_switching(rng, 1200, 1, 30.0)
    v = coloured(rng, 1200, 1, [1, -0.8], [1], 0.05)
    s = simulate(PLANT, None, np.zeros((1200, 1)), 1.0, u=size * u, d=d, Gd=FEED, v=v)
    free = np.ones((1200, 1), dtype=bool)
    return Segment(0, 1.0, s.t, np.full_like(s.r, np.nan), u, s.y, s.d, free, ("zoh",), closed=False)


def test_moves_of_op_are_seen_beside_a_measured_disturbance_that_moves_pv_more():
    computed = [np.zeros(1, dtype=bool)]
    own = [opened(seed, 0.3) for seed in range(10)]
    assert all(excited([one], computed) for one in own)
    unknown = [replace(one, d=np.zeros_like(one.d)) for one in own]
    assert sum(excited([one], computed) for one in unknown) < 5
    assert sum(excited([opened(seed, 0.0)], computed) for seed in range(96)) <= most(96, 0.05)


def closed(seed: int, size: float, trip: float) -> Segment:
    """A loop whose PV also does what one large upset makes of it."""
    rng = np.random.default_rng(seed)
    r, v = size * random_switching(rng, 1200, 1, 60.0), coloured(rng, 1200, 1, [1, -0.8], [1], 0.2)
    v[500:600] -= trip
    s = simulate(PLANT, PI, r, 1.0, v=v)
    return Segment(0, 1.0, s.t, s.r, s.u, s.y, s.d, np.ones((1200, 1), dtype=bool), ("zoh",))


def test_moves_of_the_set_point_are_seen_beside_one_upset_of_fifty_times_their_size():
    computed = [np.zeros(1, dtype=bool)]
    assert all(excited([closed(seed, 1.0, 50.0)], computed) for seed in range(20))
    beside = [closed(seed, 0.0, 50.0) for seed in range(96)]
    moved = [replace(one, r=closed(1000 + seed, 1.0, 0.0).r) for seed, one in enumerate(beside)]
    assert sum(excited([one], computed) for one in moved) <= most(96, 0.05)
