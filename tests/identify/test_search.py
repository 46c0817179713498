"""The search on a grid of time scales and dead times, against one dead time after the other, worked out plainly."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from support.simulated import segment_of, wood_berry
from trueplant.identify import Row, Spec, pieces_of
from trueplant.identify.levels import STRETCH
from trueplant.identify.noise import whiten, whitened_valid
from trueplant.identify.search import dead_time_grid, improved_element
from trueplant.lti.structure import Structure

AR = np.array([-0.7, 0.1, 0.05])
FOPDT = Structure.parse("fopdt")
OTHER = np.array([-18.9, 21.0, 3.4])


def row_of(structure: Structure, stride: int, gaps: bool) -> Row:
    """The first row of a simulated column, the element from its first input with this structure."""
    pieces = pieces_of([segment_of(wood_berry(3, samples=900))], 0)
    if gaps:
        valid = pieces[0].valid.copy()
        valid[300:340] = False
        valid[::97] = False
        pieces = (replace(pieces[0], valid=valid, y=np.where(valid, pieces[0].y, 0.0)),)
    return Row((Spec(0, structure), Spec(1, FOPDT)), pieces, stride)


def plainly(row: Row, theta: np.ndarray, stretch: float, dead_time: float) -> float:
    """What element 0, of first order, explains of PV's whitened squares that nothing else does, by projection."""
    piece, (y, valid) = row.pieces[0], row.measured(0)
    use = whitened_valid(AR.size, valid)
    other = FOPDT.response(OTHER, piece.inputs[1], piece.h, "zoh", row.stride)
    known = whiten(AR, np.column_stack([other, row.nuisance(theta, 0)]))[use]
    p = np.array([1.0, theta[1] * stretch, dead_time])
    own = whiten(AR, FOPDT.response(p, piece.inputs[0], piece.h, "zoh", row.stride))[use]
    target = whiten(AR, y)[use]
    basis = np.linalg.qr(known)[0]
    left, wanted = own - basis @ (basis.T @ own), target - basis @ (basis.T @ target)
    return float((left @ wanted) ** 2 / (left @ left))


@pytest.mark.parametrize("gaps", [False, True])
@pytest.mark.parametrize("stride", [1, 3])
def test_the_best_of_all_time_scales_and_dead_times_is_taken(stride: int, gaps: bool) -> None:
    row = row_of(FOPDT, stride, gaps)
    theta = np.concatenate([[10.0, 40.0, 6.0], OTHER])
    found, explained = improved_element(row, theta, AR, 0)
    grid = dead_time_grid(row, 0, np.array([1.0, 40.0, 6.0]), 1.0)
    all_of_them = {(s, int(d)): plainly(row, theta, s, float(d)) for s in STRETCH for d in grid}
    (stretch, dead), most = max(all_of_them.items(), key=lambda item: item[1])
    assert explained == pytest.approx(most, rel=1e-9)
    assert found[1:3] == pytest.approx([40.0 * stretch, dead])


def test_a_lead_is_found_by_its_own_numerator() -> None:
    structure = Structure.parse("sopdt+lead")
    row = row_of(structure, 1, gaps=False)
    theta = np.concatenate([structure.parameters(10.0, np.array([16.7, 0.5]), 1.0, 0.7, 3.0, 1.0), OTHER])
    found, explained = improved_element(row, theta, AR, 0)
    plain, less = improved_element(row_of(FOPDT, 1, gaps=False), np.concatenate([[10.0, 16.7, 1.0], OTHER]), AR, 0)
    assert explained > less
    assert found[structure.is_gain.argmax()] == pytest.approx(plain[0], rel=0.1)
    assert abs(found[:-3][structure.is_lead][0]) < 3.0  # the plant has none
