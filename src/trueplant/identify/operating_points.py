"""The level that an output has of its own in each experiment, for inputs of 0, and how surely."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from trueplant.arrays import Array
from trueplant.identify.fit import RowFit, linearised
from trueplant.identify.linear_algebra import inverse
from trueplant.identify.noise import whiten
from trueplant.identify.row import Row


@dataclass(frozen=True, eq=False)
class OperatingPoints:
    """Levels of one output, one for each experiment."""

    experiments: tuple[int, ...]
    levels: Array
    """(n,) that the output settles at for inputs of 0."""
    covariance: Array
    """(n, n) by the noise and by what is not known of the plant."""


def operating_points(
    fit: RowFit, theta: Array, covariance: Array, starts: Mapping[int, Array], fixed: Array
) -> OperatingPoints:
    """Levels by generalised least squares: what PV shows of them beside free responses, as the noise model weighs it.

    theta (size,) and covariance (size, size) are of the row's elements, none of which integrates. `starts` has the
    inputs (n_columns,) at the first sample of each piece that counts, one an experiment; `fixed` (n_columns,) the
    gains of the elements that are not in the row. The noise decides how much a level says: of one that is next to a
    random walk the variance is very large.
    """
    gains = fixed.copy()
    experiments, points, slopes, spread = [], [], [], []
    for spec, part in zip(fit.row.specs, fit.row.slices, strict=True):
        gains[spec.column] = theta[part][spec.structure.is_gain].sum()
    for piece in linearised(fit.row, theta, fit.ar, fit.weights):
        if piece.number not in starts:
            continue
        start, data = starts[piece.number], fit.row.pieces[piece.number]
        unknown = fit.row.unknown(theta, piece.number)
        # a level may be anything; a free response is no larger than the inputs can have left it
        least = fit.variance / np.maximum(unknown.largest, np.finfo(float).tiny) ** 2
        least[0] = 0.0
        y, valid = fit.row.measured(piece.number)
        v = np.where(valid, y - fit.row.response(theta, piece.number), 0.0)
        seen = np.column_stack([unknown.columns, v, piece.moved.T])
        columns = piece.weight * whiten(fit.ar, seen)[piece.use]
        shown, rest = np.split(columns, [len(unknown.rows)], axis=1)
        inverted = inverse(shown.T @ shown + np.diag(least))
        level, *by_theta = (inverted @ shown.T @ rest)[0]
        experiments.append(data.experiment)
        points.append(data.y[data.valid].mean() + level - gains @ start)
        slopes.append(-np.array(by_theta) - _by_gains(fit.row, start))
        spread.append(fit.variance * inverted[0, 0])
    by_plant = np.array(slopes).reshape(-1, theta.size)
    whole = by_plant @ covariance @ by_plant.T + np.diag(spread)
    return OperatingPoints(tuple(experiments), np.array(points), whole)


def _by_gains(row: Row, start: Array) -> Array:
    """(size,) what the inputs' first values do to the output, by theta."""
    columns = np.concatenate([np.full(len(spec.structure.names), spec.column) for spec in row.specs])
    return np.where(row.is_gain, start[columns], 0.0)
