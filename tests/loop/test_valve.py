"""Backlash, stick-slip and ends against closed forms, and in the loop against the valve alone."""

from __future__ import annotations

import numpy as np
import pytest

from trueplant.errors import LoopError
from trueplant.loop import PID, Controller, Valve, alternating_steps, simulate
from trueplant.loop.valve import positions_of
from trueplant.lti import TransferMatrix

PLANT = TransferMatrix.of([["2 exp(-2 s)/(10 s + 1)"]], "min")
LAW = Controller.diagonal([PID(Kc=1.0, Ti=10.0, sample_time=0.5)])
MOVES = alternating_steps(800, 0.5, 60.0, [1.0])


def test_backlash_follows_behind_by_half_its_width_and_stays_where_op_turns():
    """OP 3 sin t: the stem is 0.5 behind on its way and stands still for the first unit after each turn."""
    t = np.linspace(0, 4 * np.pi, 4001)
    op = 3 * np.sin(t)
    at = Valve(backlash=1.0).positions(op)
    assert at.max() == pytest.approx(2.5) and at.min() == pytest.approx(-2.5)
    rising = (np.cos(t) > 0) & (t > 2 * np.pi) & (at > -2.5 + 1e-9)
    assert np.allclose(at[rising], op[rising] - 0.5)
    turn = 2 * np.pi + np.arcsin(2 / 3)  # OP is back at 2, one unit below its largest, a little after its turn
    assert np.all(at[(t > 2.5 * np.pi) & (t < 3 * np.pi - (turn - 2 * np.pi))] == pytest.approx(2.5))


def test_a_sticking_stem_jumps_to_op():
    """A ramp by 0.1 a sample with a band of 0.55: the stem jumps at every sixth sample."""
    op = 0.1 * np.arange(61)
    at = Valve(stick=0.55).positions(op)
    assert np.array_equal(np.flatnonzero(np.diff(at)) + 1, np.arange(6, 61, 6))
    assert np.allclose(at[6::6], op[6::6])


def test_a_stem_waits_and_then_jumps_to_op():
    op = np.array([0.0, 0.5, 0.9, 1.2, 1.0, 0.3, 0.1])
    assert Valve(stick=1.0).positions(op).tolist() == [0.0, 0.0, 0.0, 1.2, 1.2, 1.2, 0.1]
    assert Valve().positions(op).tolist() == op.tolist()


def test_a_stem_ends_and_comes_back_with_op():
    """With play it leaves its end as soon as OP is half the play below it."""
    op = np.array([0.0, 2.0, 5.0, 3.0, 2.4, 1.0, -4.0])
    assert Valve(low=-1.0, high=2.5).positions(op).tolist() == [0.0, 2.0, 2.5, 2.5, 2.4, 1.0, -1.0]
    assert Valve(high=2.5).positions(np.array([4.0, 1.0]), start=3.0).tolist() == [2.5, 1.0]
    assert Valve(backlash=1.0, high=2.5).positions(op).tolist() == [0.0, 1.5, 2.5, 2.5, 2.5, 1.5, -3.5]
    assert Valve(stick=0.5, high=2.5).positions(op).tolist() == [0.0, 2.0, 2.0, 2.0, 2.0, 1.0, -4.0]


def test_ends_stay_where_they_are_whatever_op_is_a_deviation_from():
    op = np.random.default_rng(6).standard_normal(200).cumsum()
    for valve in (Valve(high=3.0), Valve(low=-2.0, backlash=0.5), Valve(stick=0.3)):
        (about,) = positions_of([valve], op - 1.5, start=-1.0, origin=1.5)
        assert np.allclose(about + 1.5, valve.positions(op, 0.5))


def test_several_valves_at_once_stand_where_each_does_alone():
    """Each by a walk through Python's own numbers; OP wanders, and starts away from the stems."""
    op = np.random.default_rng(5).standard_normal(400).cumsum()
    valves = [Valve(), Valve(backlash=1.5), Valve(stick=0.8), Valve(0.7, 0.4), Valve(backlash=1e3)]
    for valve, positions in zip(valves, positions_of(valves, op, start=2.0), strict=True):
        at = 2.0
        for sent, found in zip(op.tolist(), positions.tolist(), strict=True):
            wanted = min(max(at, sent - valve.backlash / 2), sent + valve.backlash / 2)
            at = wanted if abs(wanted - at) > valve.stick else at
            assert found == at
    assert np.all(positions == 2.0) and positions_of([], op, start=2.0).shape == (0, 400)


def test_the_loop_sees_the_plant_behind_its_valve():
    """The record's PV is the open response to the stem that the valve alone makes of the record's OP."""
    for valve in (Valve(backlash=0.1), Valve(stick=0.05), Valve(backlash=0.05, stick=0.03), Valve(low=-0.2, high=0.6)):
        closed = simulate(PLANT, LAW, MOVES, 0.5, valves=[valve])
        opened = simulate(PLANT, None, MOVES, 0.5, u=closed.u, valves=[valve])
        moved = valve.positions(closed.u[:, 0], 0.0)[:, None]
        assert np.allclose(opened.y, closed.y, atol=1e-10)
        assert np.allclose(simulate(PLANT, None, MOVES, 0.5, u=moved).y, closed.y, atol=1e-10)
        assert np.max(np.abs(moved - closed.u)) > 0.02
    assert np.array_equal(simulate(PLANT, LAW, MOVES, 0.5, valves=[Valve()]).y, simulate(PLANT, LAW, MOVES, 0.5).y)


def test_what_is_no_valve_is_said():
    with pytest.raises(LoopError, match="not below 0"):
        Valve(backlash=-1)
    with pytest.raises(LoopError, match="below its upper one"):
        Valve(low=1.0, high=1.0)
    with pytest.raises(LoopError, match="valves must be 1"):
        simulate(PLANT, LAW, MOVES, 0.5, valves=[Valve(), Valve()])
