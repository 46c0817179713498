"""Does a valve stick? The fit of the plant with a sticking valve before it, against the fit without."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2

from trueplant.detect import levels
from trueplant.identify import OutputEstimate, fit_row
from trueplant.loop import Valve


@dataclass(frozen=True)
class Sticking:
    """A valve that stays until OP is farther away than a band, and then jumps to it."""

    band: float
    """In the unit of OP."""
    p_value: float
    """That there is none, with what a search over bands finds in noise taken off."""


def searched_p(gain: float, tried: int, degrees: int = 1) -> float:
    """p-value of the largest of `tried` likelihood-ratio statistics (Bonferroni)."""
    return float(min(1.0, tried * chi2.sf(max(gain, 0.0), degrees)))


def sticking(estimates: Sequence[OutputEstimate], column: int) -> Sticking | None:
    """A band of sticking in the valve of input `column` that explains the records better than none.

    Every row of the plant is fitted anew with the position of a valve that sticks instead of OP (`Valve`), over a
    grid of bands; the rows' gains in -2 log likelihood are added. None where none of it is significant at 1e-3, where
    OP does not move, or the records are too long. A Hammerstein fit as in Srinivasan, Rengaswamy, Narasimhan and
    Miller (2005), Ind. Eng. Chem. Res. 44, with that simpler valve.
    """
    rows = [e for e in estimates if any(spec.column == column for spec in e.row.specs)]
    if not rows or sum(p.y.size for p in rows[0].row.pieces) > levels.STICTION_LONGEST:
        return None
    moves = np.concatenate([p.inputs[column] for p in rows[0].row.pieces])
    low, high = np.percentile(moves, [1, 99])
    if high <= low:
        return None
    gains = np.array([sum(_gain(e, column, band * (high - low)) for e in rows) for band in levels.BANDS])
    best = int(np.argmax(gains))
    p = searched_p(gains[best], levels.BANDS.size)
    return Sticking(float(levels.BANDS[best] * (high - low)), p) if p < levels.STICTION else None


def _gain(estimate: OutputEstimate, column: int, band: float) -> float:
    """What the sticking valve gains in -2 log likelihood of one output."""
    fit = estimate.fit
    pieces = []
    for piece in fit.row.pieces:
        inputs = piece.inputs.copy()
        inputs[column] = Valve(stick=band).positions(inputs[column])
        pieces.append(replace(piece, inputs=inputs))
    row = replace(fit.row, pieces=tuple(pieces))
    other = fit_row(row, fit.theta, fit.ar, weights=fit.weights, reweight=False, iterations=levels.STICTION_ITERATIONS)
    return float(fit.count * np.log(max(fit.cost, 1e-300) / max(other.cost, 1e-300)))
