"""Long records: cut into blocks, searched on a part, fitted on the whole."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from support.simulated import WOOD_BERRY, coloured, random_switching, segment_of
from trueplant.identify import Row, Sampling, Spec, fit_row, identify_output, pieces_of
from trueplant.identify.blocks import block_length, in_blocks, most_moved
from trueplant.identify.levels import SEARCHED_ERRORS, SHORTEST_BLOCK
from trueplant.identify.validate import residual_tests
from trueplant.loop import PID, Controller, simulate
from trueplant.lti.structure import Structure, structure_of

FOPDT = Structure.parse("fopdt")
TRUTH = np.concatenate([structure_of(WOOD_BERRY[0, j])[1] for j in range(2)])
SPECS = tuple(Spec(j, FOPDT, tuple(TRUTH[3 * j : 3 * j + 3] * [1.3, 0.7, 1.5])) for j in range(2))


def record(samples, seed=5):
    rng = np.random.default_rng(seed)
    law = Controller.diagonal([PID(Kc=0.375, Ti=8.29, sample_time=1.0), PID(Kc=-0.0754, Ti=23.6, sample_time=1.0)])
    r = random_switching(rng, samples, 2, 20.0)
    return segment_of(simulate(WOOD_BERRY, law, r, 1.0, v=coloured(rng, samples, 2, [1, -0.8], [1], 0.3)))


@pytest.fixture(scope="module")
def long():
    return record(3 * SEARCHED_ERRORS)


def test_blocks_are_the_record_and_begin_at_updates(long):
    (piece,) = pieces_of([long], 0)
    blocks = in_blocks([piece], 7001, 6)
    assert np.array_equal(np.concatenate([block.y for block in blocks]), piece.y)
    sizes = [block.y.size for block in blocks]
    assert len(blocks) == piece.y.size // 7001
    assert all(size % 6 == 0 for size in sizes[:-1]) and min(sizes) > 0.99 * max(sizes)
    assert [block.start for block in blocks] == pytest.approx(np.cumsum([0, *sizes[:-1]]) * piece.h)
    assert all(not np.any(block.inputs[:, 0]) for block in blocks)
    assert in_blocks([piece], piece.y.size // 2 + 1, 6) == (piece,)


def test_blocks_are_long_beside_the_plant():
    assert block_length(20.0, 1.0) == SHORTEST_BLOCK
    assert block_length(20.0, 0.01) == 300 * 2000


def test_blocks_tell_what_the_whole_record_tells(long):
    """Their operating points and initial states cost next to nothing of the information.

    The initial states have to be told although elements that work against each other hide them from PV, and whatever
    the order of the noise model.
    """
    pieces = pieces_of([long], 0)
    for ar in ([-0.8], [-0.8, 0.0, 0.0], [-0.8, 0.0, 0.0, 0.0, 0.0, 0.0]):
        whole, cut = (
            fit_row(Row(SPECS, p).without_unseen(TRUTH), TRUTH, np.array(ar), reweight=False)
            for p in (pieces, in_blocks(pieces, len(long) // 30, 1))
        )
        sigma = np.sqrt(np.diag(whole.covariance))
        assert np.all(np.abs(cut.theta - whole.theta) < 0.2 * sigma)
        assert np.sqrt(np.diag(cut.covariance)) == pytest.approx(sigma, rel=0.03)


def test_the_part_is_where_all_inputs_move(long):
    quiet = replace(long, u=long.u.copy())
    first, second = SEARCHED_ERRORS, 2 * SEARCHED_ERRORS
    quiet.u[:first, 0] = quiet.u[0, 0]
    quiet.u[second:, 1] = quiet.u[second, 1]
    part = most_moved(Row(SPECS, pieces_of([quiet], 0)))
    assert [(piece.start, piece.y.size) for piece in part.pieces] == [(first, SEARCHED_ERRORS)]


def test_short_records_and_inputs_that_never_move_are_left_alone(long):
    short = Row(SPECS, pieces_of([record(500)], 0))
    assert most_moved(short) is short
    still = replace(long, u=np.zeros_like(long.u))
    assert most_moved(Row(SPECS, pieces_of([still], 0))).pieces[0].y.size == SEARCHED_ERRORS


def test_the_whole_of_a_long_record_is_used(long):
    """Errors are within four standard errors, which shrink with the root of the number of samples."""
    part = replace(long, **{name: getattr(long, name)[:SEARCHED_ERRORS] for name in ("t", "r", "u", "y", "d", "free")})
    found = identify_output([long], 0, SPECS, sampling=Sampling(block=len(long) // 3))
    fewer = identify_output([part], 0, SPECS)
    sigma, wider = (np.sqrt(np.diag(one.covariance)) for one in (found, fewer))
    assert np.all(np.abs(found.theta - TRUTH) < 4 * sigma)
    gains = [0, 1, 3, 4]
    assert wider[gains] / sigma[gains] == pytest.approx(np.sqrt(3), rel=0.15)
    assert residual_tests(found.fit).whiteness_p > 0.01
    assert found.fit.count > len(long) - 100
