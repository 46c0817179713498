"""What else could explain prediction errors, to first order: a gain that varies with OP, a richer structure."""

from __future__ import annotations

import numpy as np
from scipy.signal import lfilter

from trueplant.arrays import Array
from trueplant.identify import levels
from trueplant.identify.fit import RowFit
from trueplant.identify.row import Piece


def element_response(fit: RowFit, m: int, piece: Piece, u: Array) -> Array:
    """Response (n,) of element m to u (N,) at the strided samples."""
    row = fit.row
    spec, part = row.specs[m], row.slices[m]
    return spec.structure.response(fit.theta[part], u, piece.h, piece.hold[spec.column], row.stride)


def rivals(fit: RowFit, m: int, piece: Piece) -> Array:
    """(n_rivals, n) what else could explain the errors: a gain that varies with OP, another structure."""
    op = piece.inputs[fit.row.specs[m].column]
    squared = element_response(fit, m, piece, (op - op.mean()) ** 2)
    return np.vstack([squared, _beyond(fit, m, piece)])


def _beyond(fit: RowFit, m: int, piece: Piece) -> Array:
    """(n_directions, n) what a structure richer than that of element m adds to its response, to first order."""
    row, spec = fit.row, fit.row.specs[m]
    answer = element_response(fit, m, piece, piece.inputs[spec.column])
    step = row.stride * piece.h
    faster = np.gradient(answer, step)
    directions = [faster, np.gradient(faster, step)]
    own = spec.structure.lag(fit.theta[row.slices[m]])
    longest = max(of.span for of in row.pieces) / levels.SLOW_SPANS
    for times in levels.RICHER_LAGS:
        pole = float(np.exp(-step / np.clip(times * own, step, max(longest, step))))
        directions.append(np.asarray(lfilter([1 - pole], [1.0, -pole], answer)))
    return np.array(directions)
