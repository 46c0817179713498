"""Loops that answer within a sample, with and without a dead time, simulated: gains, and what is said of the rest."""

from __future__ import annotations

import numpy as np
import pytest

import trueplant as tp
from support.simulated import coloured, random_switching
from trueplant import Result
from trueplant.loop import PID, Controller, simulate
from trueplant.lti import TransferMatrix
from trueplant.notebook.loops import project_of
from trueplant.study.pipeline import analyse


def analysed(plant: str, seed: int, walk: bool) -> Result:
    """2,000 samples of 1 s under PI control, AR(1) or a random walk on PV; some moves of the set-point last 1 to 3.

    The model is right.
    """
    rng = np.random.default_rng(seed)
    dead_time = max((term.dead_time for term in tp.tf(plant).terms), default=0.0)
    law = PID(Kc=0.15, Ti=1.0 + 2 * dead_time, sample_time=1.0)
    r = random_switching(rng, 2000, 1, 40.0)
    v = np.cumsum(rng.normal(0, 0.01, (2000, 1)), axis=0) if walk else coloured(rng, 2000, 1, [1, -0.9], [1], 0.1)
    s = simulate(TransferMatrix.of([[plant]], "s"), Controller.diagonal([law]), r, 1.0, v=v)
    frame = {"time": s.t, "sp": s.r[:, 0] + 50, "op": s.u[:, 0] + 40, "pv": s.y[:, 0] + 50}
    loops = [tp.Loop("L", pv="pv", sp="sp", op="op", controller=law)]
    return analyse(project_of(["record"], loops, {("L", "L"): {"tf": plant}}, None, "s", {}), frames=[frame])


@pytest.mark.parametrize("walk", [False, True])
def test_a_gain_is_found_by_all_methods_alike(walk):
    """Three records each: no other method disagrees, nor does the plant lie outside of the band without structure."""
    for seed in range(1, 4):
        result = analysed("2", seed, walk)
        (element,) = result.elements
        low, high = element.parameters[0].ci
        assert element.verdict == "unchanged" and low < 2 < high
        assert not {"methods", "outside-band", "structure"} & {str(note.code) for note in result.notes}
        assert result.methods.answers.keys() >= {"joint", "closed-form"}


@pytest.mark.parametrize("dead_time", [3.4, 20.4])
def test_a_dead_time_without_a_lag_is_no_change_of_structure(dead_time):
    """Its model has no lag either: four records each, none called changed, and no gain that is given is wrong."""
    for seed, walk in ((1, False), (3, False), (0, True), (4, True)):
        result = analysed(f"2 exp(-{dead_time} s)", seed, walk)
        (element,) = result.elements
        assert element.verdict != "changed" and element.structure == "fopdt" and not element.rejected_structure
        assert [p.model for p in element.parameters] == [2.0, 0.0, dead_time]
        gain = element.parameters[0].ci
        assert gain is None or gain[0] < 2 < gain[1]
