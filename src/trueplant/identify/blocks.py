"""Long records: cut into blocks that are worked through one after another, and searched on a part that says enough."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from trueplant.identify import levels
from trueplant.identify.fit import RowFit, fit_row
from trueplant.identify.pieces import Piece
from trueplant.identify.row import Row


def block_length(longest: float, h: float) -> int:
    """Samples of a block, from the longest lag (with dead time) of the plant."""
    return max(levels.SHORTEST_BLOCK, int(levels.LAGS_PER_BLOCK * longest / h))


def in_blocks(pieces: Sequence[Piece], length: int, stride: int) -> tuple[Piece, ...]:
    """Pieces of two blocks (of `length` samples) or more, cut into equal ones of whole strides."""
    found: list[Piece] = []
    for piece in pieces:
        count = piece.y.size // length
        if count < 2:
            found.append(piece)
            continue
        size = -(-piece.y.size // (count * stride)) * stride
        edges = [*range(0, piece.y.size, size), piece.y.size]
        found += [piece.from_sample(a, b) for a, b in pairwise(edges)]
    return tuple(found)


def most_moved(row: Row) -> Row:
    """The row on those stretches of its pieces in which all inputs move most, SEARCHED_ERRORS errors in all.

    The row itself where it has not many more.
    """
    counts = [len(range(0, piece.y.size, row.stride)) for piece in row.pieces]
    if sum(counts) <= 2 * levels.SEARCHED_ERRORS:
        return row
    size = levels.SEARCHED_ERRORS * row.stride
    stretches = [
        piece.from_sample(first, min(first + size, piece.y.size))
        for piece in row.pieces
        for first in range(0, max(piece.y.size - size // 2, 1), size)
    ]
    columns = [spec.column for spec in row.specs]
    moves = np.array([np.var(piece.inputs[columns], axis=1) for piece in stretches])
    moves = moves[:, np.any(moves > 0, axis=0)]
    order = np.argsort(-np.min(moves / moves.mean(axis=0), axis=1, initial=np.inf), kind="stable")
    taken, total = [], 0
    for k in order:
        if total >= levels.SEARCHED_ERRORS:
            break
        taken.append(stretches[k])
        total += stretches[k].y.size // row.stride
    return replace(row, pieces=tuple(taken))


def of_a_part(fit: RowFit) -> RowFit:
    """The fit of that part of a long record in which the inputs move most."""
    row = most_moved(fit.row)
    return fit if row is fit.row else fit_row(row, fit.theta, fit.ar, free=fit.free)
