"""The data that are kept back to try an estimate on. All records are simulated."""

from __future__ import annotations

import numpy as np
import pytest

from support.simulated import WOOD_BERRY, segment_of, wood_berry
from trueplant.identify import specs_of
from trueplant.identify.blocks import in_blocks
from trueplant.identify.fit import fit_row
from trueplant.identify.pieces import pieces_of
from trueplant.identify.row import Row
from trueplant.identify.validate import validate

SPECS = tuple(spec for (i, _), spec in sorted(specs_of(WOOD_BERRY).items()) if i == 0)
THETA = np.concatenate([np.array(spec.initial) for spec in SPECS])
AR = np.array([-0.8])


@pytest.mark.parametrize("block", [600, 1000, 2400])
def test_the_last_third_is_that_of_all_pieces(block):
    pieces = in_blocks(pieces_of([segment_of(wood_berry(3, 2400))], 0), block, 1)
    found = validate(fit_row(Row(SPECS, pieces), THETA, AR))
    assert found.kind == "last third"
    assert sum(p.y.size for p in found.trained.row.pieces) == 1600
    assert sum(p.y.size for p in found.pieces) == 800 and found.pieces[0].start == 1600
    assert found.fit_percent == pytest.approx(found.fit_percent_same_data, abs=1)


def test_what_the_estimate_holds_is_held_without_those_data_too():
    free = np.array([True, True, False, True, True, True])
    theta = np.where(free, THETA, 0.0)
    found = validate(fit_row(Row(SPECS, pieces_of([segment_of(wood_berry(3, 2400))], 0)), theta, AR, free=free))
    assert found.trained.theta[2] == 0.0 and found.trained.free.tolist() == free.tolist()


def test_pieces_too_short_to_tell_are_not_tried_on():
    pieces = pieces_of([segment_of(wood_berry(3, 2400))], 0)
    cut = (pieces[0].from_sample(0, 2380), pieces[0].from_sample(2380))
    found = validate(fit_row(Row(SPECS, cut), THETA, AR))
    assert [p.y.size for p in found.pieces] == [780]
