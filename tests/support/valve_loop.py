"""One loop under PI whose valve may not follow OP, and the valves that are found in its record."""

from __future__ import annotations

import numpy as np

from support.simulated import coloured, random_switching, segment_of
from trueplant.identify import identify_matrix, specs_of, sticking, try_valves
from trueplant.loop import PID, Controller, Valve, simulate
from trueplant.lti import TransferMatrix

PLANT = TransferMatrix.of([["2 exp(-3.3 s)/(10 s + 1)"]], "min")
LAW = Controller.diagonal([PID(Kc=0.66, Ti=10.0, sample_time=1.0)])


def record(seed, share=0.0, kind="backlash", std=0.02, samples=2000):
    """A loop whose valve has a band of this share of OP's span (simulated), and the band."""
    rng = np.random.default_rng(seed)
    r, v = random_switching(rng, samples, 1, 40.0), coloured(rng, samples, 1, [1, -0.8], [1], std)
    band = share * float(np.ptp(simulate(PLANT, LAW, r, 1.0, v=v).u))
    return segment_of(simulate(PLANT, LAW, r, 1.0, v=v, valves=[Valve(**{kind: band})])), band


def valves_of(segment):
    return sticking(try_valves(identify_matrix([segment], PLANT, specs_of(PLANT)), [0]))
