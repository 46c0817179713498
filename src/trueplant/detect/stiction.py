"""Does a valve stick? The fit of the plant with a sticking valve before it, against the fit without."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numba import njit
from scipy.stats import chi2

from trueplant.arrays import Array
from trueplant.detect import levels
from trueplant.identify import OutputEstimate, fit_row


@dataclass(frozen=True)
class Sticking:
    """A valve that stays until OP is farther away than a band, and then jumps to it."""

    band: float
    """In the unit of OP."""
    p_value: float
    """That there is none, with what a search over bands finds in noise taken off."""


def stuck(op: Array, band: float) -> Array:
    """Position (N,) of a valve that follows OP (N,) only when it is farther than `band` away, and then fully.

    The model with one parameter of Stenman, Gustafsson and Forsman (2003), Int. J. Adapt. Control Signal Process. 17.
    """
    return np.asarray(_follow(np.ascontiguousarray(op, dtype=float), float(band)))


def searched_p(gain: float, tried: int, degrees: int = 1) -> float:
    """p-value of the largest of `tried` likelihood-ratio statistics (Bonferroni)."""
    return float(min(1.0, tried * chi2.sf(max(gain, 0.0), degrees)))


@njit(cache=True)
def _follow(op: Array, band: float) -> Array:
    """Position (N,) that takes OP's value whenever it is farther than `band` from it, and stays otherwise."""
    out = np.empty(op.size)
    at = op[0]
    for k in range(op.size):
        if abs(op[k] - at) > band:
            at = op[k]
        out[k] = at
    return out


def sticking(estimates: Sequence[OutputEstimate], column: int) -> Sticking | None:
    """A band of sticking in the valve of input `column` that explains the records better than none.

    Every row of the plant is fitted anew with the position of a valve that sticks instead of OP (`stuck`), over a
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
        inputs[column] = stuck(inputs[column], band)
        pieces.append(replace(piece, inputs=inputs))
    row = replace(fit.row, pieces=tuple(pieces))
    other = fit_row(row, fit.theta, fit.ar, weights=fit.weights, reweight=False, iterations=levels.STICTION_ITERATIONS)
    return float(fit.count * np.log(max(fit.cost, 1e-300) / max(other.cost, 1e-300)))
