"""Does a valve stick? The fit of the plant with a sticking valve before it, against the fit without."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from trueplant.detect.causes import Sticking, searched_p, stuck
from trueplant.identify import OutputEstimate, fit_row

BANDS = np.array([0.04, 0.08, 0.12, 0.18, 0.25, 0.35, 0.5])
"""Tried, relative to OP's range from its 1st to its 99th percentile."""
LARGEST = 10_000
"""Longer records are left out: each band costs a fit."""
ITERATIONS = 3


def sticking(estimates: Sequence[OutputEstimate], column: int) -> Sticking | None:
    """A band of sticking in the valve of input `column` that explains the records better than none.

    Every row of the plant is fitted anew with the position of a valve that sticks instead of OP (`stuck`), over a
    grid of bands; the rows' gains in -2 log likelihood are added. None where none of it is significant at 1e-3, where
    OP does not move, or the records are too long. A Hammerstein fit as in Srinivasan, Rengaswamy, Narasimhan and
    Miller (2005), Ind. Eng. Chem. Res. 44, with that simpler valve.
    """
    rows = [e for e in estimates if any(spec.column == column for spec in e.row.specs)]
    if not rows or sum(p.y.size for p in rows[0].row.pieces) > LARGEST:
        return None
    moves = np.concatenate([p.inputs[column] for p in rows[0].row.pieces])
    low, high = np.percentile(moves, [1, 99])
    if high <= low:
        return None
    gains = np.array([sum(_gain(e, column, band * (high - low)) for e in rows) for band in BANDS])
    best = int(np.argmax(gains))
    p = searched_p(gains[best], BANDS.size)
    return Sticking(float(BANDS[best] * (high - low)), p) if p < 1e-3 else None


def _gain(estimate: OutputEstimate, column: int, band: float) -> float:
    """What the sticking valve gains in -2 log likelihood of one output."""
    fit = estimate.fit
    pieces = []
    for piece in fit.row.pieces:
        inputs = piece.inputs.copy()
        inputs[column] = stuck(inputs[column], band)
        pieces.append(replace(piece, inputs=inputs))
    row = replace(fit.row, pieces=tuple(pieces))
    other = fit_row(row, fit.theta, fit.ar, weights=fit.weights, reweight=False, iterations=ITERATIONS)
    return float(fit.count * np.log(max(fit.cost, 1e-300) / max(other.cost, 1e-300)))
