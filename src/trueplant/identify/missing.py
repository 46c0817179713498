"""Elements that the model lacks and the record shows: prediction errors that answer to an input give them away.

An input left out does not only go unseen: where the controllers tie it to the others, their elements take on
what it does, and are confidently wrong; a noise model that is slow takes on the rest. So what an element would gain is
asked with plant and noise free: the errors' correlation with the input over a few samples does not show slow elements.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from trueplant.arrays import Array
from trueplant.identify import levels
from trueplant.identify.first import SELF_REGULATING, absence
from trueplant.identify.fit import RowFit, Whitening
from trueplant.identify.likelihood import ratio_p
from trueplant.identify.linear_algebra import orthonormal
from trueplant.identify.output import OutputEstimate
from trueplant.identify.row import Spec


@dataclass(frozen=True, eq=False)
class Completed:
    """An output with the elements that the model lacks and the record shows."""

    estimate: OutputEstimate
    doubtful: tuple[int, ...] = ()
    """Columns of which the fit shows an element, but not beside the largest noise model: they are left out."""


def with_missing(
    estimate: OutputEstimate,
    absent: Sequence[int],
    again: Callable[[Sequence[Spec]], OutputEstimate | None],
    tested: int,
    confidence: float = 0.95,
) -> Completed:
    """The estimate, with first-order elements from those of the `absent` columns that the record shows to act.

    `again` estimates the row with other elements. An element is tried if to first order it gains more than a search in
    noise would, and taken in if the fit with it does so for certain, beside the largest noise model as well. `tested`
    is the number of absent elements in the whole matrix.
    """
    if not absent:
        return Completed(estimate)
    left, doubtful = list(absent), []
    freedom = levels.SEARCHED_FREEDOM + len(SELF_REGULATING.names)
    level = levels.MISSING_ELEMENT / tested
    while left and estimate.fit.ar.size:
        gains = _Scan(estimate.fit)
        gained = [gains.of(column) for column in left]
        column = left.pop(int(np.argmax(gained)))
        if ratio_p(max(gained), freedom) * tested >= levels.MISSING_TRIED:
            break
        specs = sorted([*estimate.row.specs, Spec(column, SELF_REGULATING)], key=lambda spec: spec.column)
        wider = again(specs)
        if wider is None:
            continue
        if absence(wider, [column], level, confidence)[column] < level:
            estimate = wider
        elif wider.absence_p([spec.column for spec in specs].index(column)) < level:
            doubtful.append(column)
    return Completed(estimate, tuple(doubtful))


class _Scan:
    """The prediction errors of a fit, with what its plant, its noise model and its unknowns can explain taken out."""

    def __init__(self, fit: RowFit) -> None:
        self._fit = fit
        self._pieces = [(k, whitening) for k, whitening in enumerate(Whitening.of(fit)) if whitening is not None]
        free = np.concatenate([fit.free, np.ones(fit.ar.size, dtype=bool)])
        self._basis = orthonormal(np.hstack([whitening.jacobian[free] for _, whitening in self._pieces]).T)
        self._errors = self._beyond(np.concatenate([whitening.errors for _, whitening in self._pieces]))

    def _beyond(self, x: Array) -> Array:
        return np.asarray(x - self._basis @ (self._basis.T @ x))

    def of(self, column: int) -> float:
        """What the best first-order element from this column would gain in -2 log likelihood, to first order."""
        row = self._fit.row
        variance = max(float(self._errors @ self._errors) / self._fit.left, np.finfo(float).tiny)
        longest = max(piece.h * piece.y.size for piece in row.pieces) / levels.SLOW_SPANS
        best, lag = 0.0, row.pieces[0].h * row.stride
        while lag < longest:
            for dead_time in np.multiply(levels.MISSING_DEAD_TIMES, lag):
                answer = self._answer(column, np.array([1.0, lag, dead_time]))
                told = self._beyond(answer)
                size = float(told @ told)
                if size > levels.LOAD_TOLD * float(answer @ answer):
                    best = max(best, float(told @ self._errors) ** 2 / size / variance)
            lag *= levels.MISSING_LAGS_APART
        return best

    def _answer(self, column: int, theta: Array) -> Array:
        """(n,) what an element with these parameters takes off the prediction errors of all pieces."""
        row, found = self._fit.row, []
        for k, whitening in self._pieces:
            piece = row.pieces[k]
            y = SELF_REGULATING.response(theta, piece.inputs[column], piece.h, piece.hold[column], row.stride)
            found.append(whitening(y[None])[0])
        return np.concatenate(found)
