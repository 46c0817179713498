"""Set-points that flicker by what the record does not resolve: no move for anything that asks whether one moved.

The loop is simulated with the flicker in it: its controller acts on every digit, and PV answers beyond chance.
"""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace as Stub
from typing import Any

import numpy as np
import pytest

from support.simulated import BLT, WOOD_BERRY, coloured, segment_of
from trueplant.detect.signals import NotApplicable, signals_of
from trueplant.errors import Refused
from trueplant.identify.instrumental.closed_loop import projected_inputs
from trueplant.loop import Controller, simulate
from trueplant.mismatch import coherence, local_response, periodic_response
from trueplant.record import Segment, excitation
from trueplant.study.data import controller_check, law_windows
from trueplant.study.data.excitation import excited, setpoint_moves, setpoint_rank_note
from trueplant.study.data.setpoints import computed_setpoints
from trueplant.study.experiment.plans import _seen
from trueplant.tracking.usable import outside_moves
from trueplant.tracking.windows import moves_of

SAMPLES, STEP = 3000, 0.1
NONE = np.zeros(2, dtype=bool)


def flickering(size: float = 0.0, quiet: bool = False) -> Segment:
    """Both set-points toggle by a digit, and the first moves by `size` back and forth besides."""
    rng = np.random.default_rng(1)
    moves = size * np.column_stack([np.arange(SAMPLES) // 300 % 2, np.zeros(SAMPLES)])
    r = moves + STEP * rng.integers(0, 2, (SAMPLES, 2))
    v = coloured(rng, SAMPLES, 2, [1, -0.8], [1], 1e-3 if quiet else 0.02)
    return replace(segment_of(simulate(WOOD_BERRY, BLT, r, 1.0, v=v)), settled=moves)


def study_of(segment: Segment) -> Any:
    record = Stub(u=segment.u, t=segment.t)
    return Stub(
        segments=(segment,),
        computed=NONE,
        computed_alone=[NONE],
        screened=[Stub(segments=(segment,), record=record)],
        records=Stub(declared=[BLT]),
        project=Stub(
            outputs=[Stub(limits=(0.0, 100.0))] * 2,
            inputs=[Stub(limits=None)] * 2,
            output_names=("top", "bottom"),
            experiments=[Stub(limits=[None, None])],
        ),
    )


def test_the_loop_answers_to_the_flicker_and_it_is_no_excitation() -> None:
    segment = flickering()
    assert excited([replace(segment, settled=None)], [NONE])
    assert not excited([segment], [NONE])
    assert excited([flickering(2.0)], [NONE])


def test_flicker_counts_for_no_move() -> None:
    still, moving = flickering(), flickering(2.0)
    for segment, count in ((still, 0), (moving, 9)):
        assert excitation([segment]).changes.tolist() == [count, 0]
        assert len(setpoint_moves(segment)) == count
        assert moves_of([segment]).size == count
        assert outside_moves(study_of(segment), 0, 50.0).times.size == count
    (note,) = setpoint_rank_note(study_of(moving))
    assert "set-point of bottom never moves" in note.message
    # half of the move; a part of the instrument's range where there was none
    assert _seen(study_of(moving), True)[0] == 1.0
    assert _seen(study_of(moving), True)[1] > 1.0


@pytest.mark.parametrize("ask", [local_response, periodic_response, coherence, lambda s: projected_inputs(s)])
def test_flicker_alone_is_refused_by_what_needs_a_move(ask: Any) -> None:
    with pytest.raises(Refused, match=r"does not move in any record|no set-point moves"):
        ask([flickering()])
    with pytest.raises(NotApplicable, match="no set-point moves"):
        signals_of([flickering()], WOOD_BERRY)
    assert signals_of([flickering(2.0)], WOOD_BERRY).outer.shape[1] == 1


def test_setpoints_repeat_whatever_their_digits_do() -> None:
    segment = flickering(2.0, quiet=True)
    first = {name: getattr(segment, name)[:, :1] for name in ("r", "settled", "u", "y", "free")}
    one = replace(segment, **first, hold=segment.hold[:1])
    assert periodic_response([one], "joint").periods >= 3
    with pytest.raises(Refused, match="do not repeat"):
        periodic_response([replace(one, settled=None)], "joint")


def test_digits_of_a_copy_of_pv_are_no_moves_to_be_foretold() -> None:
    """A set-point that rests, printed from a PV that hardly moves: nothing is computed, as nothing moves."""
    rng = np.random.default_rng(2)
    y = np.cumsum(rng.standard_normal((SAMPLES, 1)), axis=0)
    segment = replace(flickering(), y=y, r=-0.3 * y, u=y, settled=np.zeros_like(y), free=np.ones_like(y, dtype=bool))
    assert computed_setpoints([replace(segment, settled=None)]).tolist() == [True]
    assert computed_setpoints([segment]).tolist() == [False]


def test_windows_of_the_law_need_a_move_beyond_the_digits() -> None:
    """PV stands still, OP as well: set-points that flicker make no window, one that moves does."""
    r = STEP * np.random.default_rng(3).integers(0, 2, (400, 1)).astype(float)
    still, settled = np.zeros((400, 1)), np.zeros((400, 1))
    good = np.ones(400, dtype=bool)
    law = Controller.diagonal([next(iter(BLT.entries.values()))])
    for levels, windows in ((None, True), (settled, False)):
        stretch = law_windows.Stretch(np.arange(400.0), still[:, 0], r, still, good, 1.0, levels)
        assert (law_windows.cut([stretch], law, 0).samples > 0) is windows


def test_a_stretch_of_the_law_keeps_what_counts_for_moves() -> None:
    segment = flickering(2.0)
    stretch = controller_check._stretch(study_of(segment), 0, BLT, 0, segment)
    np.testing.assert_array_equal(stretch.r, segment.r[-len(stretch.r) :])
    np.testing.assert_array_equal(stretch.setpoints, segment.setpoints[-len(stretch.r) :])
