"""Prediction errors of all outputs under a vector autoregression, weighted, and what moves them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from trueplant.arrays import Array, BoolArray
from trueplant.identify.linear_algebra import eliminated, identifiable_columns
from trueplant.identify.noise import lagged, whitened_valid
from trueplant.identify.row import Row


@dataclass(frozen=True, eq=False)
class PieceErrors:
    """Those of one piece."""

    plain: Array
    """(n - order, n_y) not weighted, 0 where they do not exist."""
    exist: BoolArray
    """(n - order,)"""
    weighted: Array
    """(n_used n_y,)"""
    ar: Array
    root: Array
    basis: Array
    """(n_used n_y, n_z) of what operating points and initial states do to the weighted ones."""
    jacobian: Array
    """(n_used n_y, size) of theta and ar, without what those do; (n_used n_y, 0) where it was not asked for."""

    def fallen(self, i: int, responses: Array) -> Array:
        """(k, n_used n_y) by how much weighted errors are smaller where output i responds by (k, n) more."""
        moved = _stacked(self.root, _filtered(self.ar, responses.T, i), self.exist)
        return np.asarray(moved - self.basis @ (self.basis.T @ moved)).T


def piece_errors(
    rows: Sequence[Row], theta: Array, ar: Array, root: Array, derivatives: bool = True
) -> Iterator[PieceErrors]:
    """Piece by piece; `root` weights the errors where operating points and initial states are taken out of them."""
    order, n_y = ar.shape[0], len(rows)
    places, size = places_of(rows), theta.size + ar.size
    for k in range(len(rows[0].pieces)):
        measured = [row.measured(k) for row in rows]
        whole = np.all([ok for _, ok in measured], axis=0)
        use = whitened_valid(order, whole)
        n = whole.size
        if not use.any():
            none = np.zeros((max(n - order, 0), n_y))
            yield PieceErrors(none, use, np.zeros(0), ar, root, np.zeros((0, 0)), np.zeros((0, size)))
            continue
        parts = [theta[place] for place in places]
        responses = [row.response_and_gradient(part, k) for row, part in zip(rows, parts, strict=True)]
        v = np.column_stack([y - f for (y, _), (f, _) in zip(measured, responses, strict=True)])
        unknown = [row.unknown(part, k) for row, part in zip(rows, parts, strict=True)]
        nuisance = [of_row.columns for of_row in unknown]
        filtered = [_filtered(ar, z, i) for i, z in enumerate(nuisance)]
        columns = _stacked(root, np.concatenate(filtered, axis=2), use)
        e = _stacked(root, _prediction_errors(ar, v)[:, :, None], use)[:, 0]
        identifiable = identifiable_columns(columns, e[::n_y], np.concatenate([of_row.largest for of_row in unknown]))
        columns, all_weights = columns[:, identifiable], np.zeros(identifiable.size)
        all_weights[identifiable], basis = eliminated(columns, e)
        weights = np.split(all_weights, np.cumsum([z.shape[1] for z in nuisance])[:-1])
        v -= np.column_stack([z @ w for z, w in zip(nuisance, weights, strict=True)])
        v[~whole] = 0.0
        plain = _prediction_errors(ar, v)
        plain[~use] = 0.0
        weighted = _stacked(root, plain[:, :, None], use)[:, 0]
        jacobian = np.zeros((weighted.size, 0))
        if derivatives:
            moved = [(place, responses[i][1] + unknown[i].gradient(weights[i])) for i, place in enumerate(places)]
            jacobian = _stacked(root, _derivatives(ar, moved, v, size), use)
            jacobian -= basis @ (basis.T @ jacobian)
        yield PieceErrors(plain, use, weighted, ar, root, basis, jacobian)


def _derivatives(ar: Array, moved: Sequence[tuple[slice, Array]], v: Array, size: int) -> Array:
    """(n - order, n_y, size) by theta and ar; `moved` has those of the responses (n, n_p), output by output."""
    (order, n_y), n = ar.shape[:2], len(v)
    jacobian = np.zeros((n - order, n_y, size))
    for i, (place, gradient) in enumerate(moved):
        jacobian[:, :, place] = -_filtered(ar, gradient, i)
    past = lagged(v, order).reshape(n - order, order, n_y)
    of_ar = np.zeros((n - order, n_y, order, n_y, n_y))
    for i in range(n_y):
        of_ar[:, i, :, i, :] = past
    jacobian[:, :, size - ar.size :] = of_ar.reshape(n - order, n_y, -1)
    return jacobian


def _stacked(root: Array, x: Array, use: BoolArray) -> Array:
    """(n n_y, columns) of x (n, n_y, columns) where all outputs were measured, weighted by root."""
    return np.asarray(np.matmul(root, x[use])).reshape(-1, x.shape[2])


def _prediction_errors(ar: Array, v: Array) -> Array:
    """(n - order, n_y) of output errors v (n, n_y)."""
    order, n = ar.shape[0], len(v)
    out = v[order:].copy()
    for k in range(order):
        out += v[order - k - 1 : n - k - 1] @ ar[k].T
    return out


def _filtered(ar: Array, x: Array, source: int) -> Array:
    """(n - order, n_y, columns): what columns x (n, columns) in output `source` do to all prediction errors."""
    order, n_y = ar.shape[:2]
    n = len(x)
    out = np.zeros((n - order, n_y, x.shape[1]))
    out[:, source] = x[order:]
    for k in range(order):
        out += ar[k, :, source][None, :, None] * x[order - k - 1 : n - k - 1][:, None, :]
    return out


def places_of(rows: Sequence[Row]) -> list[slice]:
    """Where theta of each row is among those of all, one after the other."""
    ends = np.cumsum([row.size for row in rows])
    return [slice(int(end) - row.size, int(end)) for row, end in zip(rows, ends, strict=True)]
