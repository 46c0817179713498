"""How a measured disturbance runs between its samples, found by what fits where it was not declared.

The estimates take it to run in straight lines. Each output that it moves is then fitted with a held disturbance, from
where the first fit ended: a held signal is half a sample late, so that dead times begin that much shorter. Straight
lines flatten a smooth signal twice as much as steps do, and steps half a sample early would pass for a smooth signal:
so it is fitted with a smooth curve through the samples too, of which straight lines are the plain stand-in, and the
held one has to beat both.

All of them have as many parameters. Between two such rivals the difference of -2 log likelihood bears the wrong sign
beyond the chi-square quantile of a level in at most half of that level, however clearly the record could tell them
(each is a restriction by one degree of freedom of the signal that is so much one and so much the other). What the ways
not taken would move counts in covariance and intervals by the share that the likelihood leaves them, all being as
likely beforehand.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import IntEnum

import numpy as np
from scipy.special import softmax
from scipy.stats import chi2

from trueplant.arrays import Array
from trueplant.identify import levels
from trueplant.identify.blocks import most_moved
from trueplant.identify.estimate import best_dead_times
from trueplant.identify.fit import RowFit, fit_row
from trueplant.identify.moments import in_row
from trueplant.identify.output import OutputEstimate, at_median
from trueplant.identify.pieces import Piece
from trueplant.identify.row import Row
from trueplant.lti.sampled import sampled_response
from trueplant.lti.transfer import TransferFunction, TransferMatrix
from trueplant.record.types import Segment
from trueplant.result.budget import Source


class Way(IntEnum):
    """What is compared, in this order."""

    STRAIGHT = 0
    SMOOTH = 1
    HELD = 2


@dataclass(frozen=True, eq=False)
class FoundHold:
    """How one measured disturbance runs, and what the other ways would do to the outputs that it moves."""

    deviances: Array
    """(3,) -2 log likelihood of each way over all outputs, from that of straight lines on."""
    held: Mapping[int, RowFit]
    """By output: the fit with a held disturbance."""
    thetas: Mapping[int, Array]
    """By output: (3, size) the parameters with each way."""

    @property
    def gain(self) -> float:
        """By how much -2 log likelihood is lower where it is held than where it runs on."""
        return float(min(self.deviances[Way.STRAIGHT], self.deviances[Way.SMOOTH]) - self.deviances[Way.HELD])

    @property
    def decided(self) -> bool:
        """Do the likelihoods differ beyond chance?"""
        return bool(abs(self.gain) > chi2.isf(levels.HOLD, 1))

    @property
    def hold(self) -> str:
        """The one with the higher likelihood, or straight lines where the difference is within chance."""
        return "zoh" if self.decided and self.gain > 0 else "linear"

    @property
    def shares(self) -> Array:
        """(3,) probability of each way."""
        return np.asarray(softmax(-0.5 * self.deviances))

    def shifts(self, i: int) -> Array:
        """(3, size) by how much the parameters of an output are larger with each way than with the one taken."""
        return np.asarray(self.thetas[i] - self.thetas[i][Way.HELD if self.hold == "zoh" else Way.STRAIGHT])


def find_holds(
    estimates: Mapping[int, OutputEstimate], model: TransferMatrix, columns: Sequence[int]
) -> dict[int, FoundHold]:
    """How the measured disturbances in these columns run; none for one that moves no output that was estimated.

    The estimates take them to run in straight lines. `model` (n_y, n_u + n_d) has the elements that were not estimated.
    """
    found = {}
    for column in columns:
        deviances, held, thetas = np.zeros(3), {}, {}
        for i, estimate in estimates.items():
            own = any(spec.column == column for spec in estimate.row.specs)
            if estimate.fit.count and (own or not model[i, column].is_zero):
                ways = _ways(estimate.fit, column, None if own else model[i, column])
                costs = np.array([max(way.cost, 1e-300) for way in ways])
                rises = ways[Way.STRAIGHT].left * np.log(costs / costs[Way.STRAIGHT])
                deviances += rises / estimate.ratio_factor.mean()
                held[i], thetas[i] = ways[Way.HELD], np.array([way.theta for way in ways])
        if held:
            found[column] = FoundHold(deviances, held, thetas)
    return found


def _ways(fit: RowFit, column: int, kept: TransferFunction | None) -> tuple[RowFit, RowFit, RowFit]:
    """The fit of that part of a record in which inputs move most, with each way."""
    straight = _refitted(most_moved(fit.row), fit.theta, fit)
    smooth = _refitted(_smooth(straight.row, column, kept), straight.theta, straight)
    held = _refitted(_held(straight.row, column, kept), _earlier(straight, column), straight)
    return straight, smooth, held


def _refitted(row: Row, theta: Array, fit: RowFit) -> RowFit:
    """The fit of the row from given parameters, with the noise model that another fit ended with as a start."""
    low, high = row.bounds()
    again = fit_row(row, np.clip(theta, low, high), fit.ar, weights=_weights(row, fit), reweight=False)
    return best_dead_times(again, reach=1, rounds=1)


def _weights(row: Row, fit: RowFit) -> Array | None:
    """Those of the fit, where the row has the same pieces."""
    return fit.weights if len(row.pieces) == fit.weights.size else None


def _earlier(fit: RowFit, column: int) -> Array:
    """theta with the dead times of one column half a sample shorter."""
    theta, row = fit.theta.copy(), fit.row
    for spec, part in zip(row.specs, row.slices, strict=True):
        if spec.column == column:
            theta[part] -= np.where(spec.structure.is_dead_time, 0.5 * row.pieces[0].h, 0.0)
    return theta


def _held(row: Row, column: int, kept: TransferFunction | None) -> Row:
    """The row with one input held between its samples; what a `kept` element makes of it is taken off PV that way."""

    def other(piece: Piece) -> Piece:
        hold = (*piece.hold[:column], "zoh", *piece.hold[column + 1 :])
        return _with_input(piece, column, piece.inputs[column], hold, kept)

    return replace(row, pieces=tuple(map(other, row.pieces)))


def _smooth(row: Row, column: int, kept: TransferFunction | None) -> Row:
    """The row with straight lines through a signal so much sharper than one input as these flatten a smooth one.

    Straight lines through its samples take (w h)^2/12 of an oscillation of the frequency w; a twelfth of its second
    differences makes up for that.
    """

    def other(piece: Piece) -> Piece:
        d = piece.inputs[column]
        sharper = d.copy()
        sharper[1:-1] -= (d[2:] - 2 * d[1:-1] + d[:-2]) / 12
        return _with_input(piece, column, sharper, piece.hold, kept)

    return replace(row, pieces=tuple(map(other, row.pieces)))


def _with_input(
    piece: Piece, column: int, signal: Array, hold: tuple[str, ...], kept: TransferFunction | None
) -> Piece:
    """The piece with another signal or hold in one column."""
    inputs, y = piece.inputs.copy(), piece.y
    inputs[column] = signal
    if kept is not None:
        was = sampled_response(kept, piece.inputs[column], piece.h, piece.hold[column])
        would = sampled_response(kept, signal, piece.h, hold[column])
        y = np.where(piece.valid, y + was - would, 0.0)
    return replace(piece, inputs=inputs, hold=hold, y=y)


def held_or_straight(held: Mapping[int, OutputEstimate], straight: Mapping[int, OutputEstimate]) -> bool | None:
    """Which of two estimates, with held disturbances and with straight lines, is likelier; None within chance."""
    deviances = np.zeros(3)
    for i in straight.keys() & held.keys():
        one, other = held[i].fit, straight[i].fit
        # an error has a longer noise model's past before it more seldom: so many of each as there are of both
        rise = min(one.left, other.left) * (one.deviance / one.left - other.deviance / other.left)
        deviances[Way.HELD] += rise / straight[i].ratio_factor.mean()
    found = FoundHold(deviances, {}, {})
    return found.gain > 0 if found.decided else None


def held_fits(holds: Mapping[int, FoundHold]) -> dict[int, RowFit]:
    """By output: a fit with a disturbance that was found to be held."""
    return {i: fit for found in holds.values() if found.hold == "zoh" for i, fit in found.held.items()}


def with_holds(segments: Sequence[Segment], holds: Mapping[int, FoundHold]) -> tuple[Segment, ...]:
    """The segments, saying how their measured disturbances were found to run."""
    out = []
    for segment in segments:
        every = list(segment.holds)
        for column, found in holds.items():
            every[column] = found.hold
        out.append(replace(segment, d_hold=tuple(every[segment.u.shape[1] :])))
    return tuple(out)


def over_open_holds(
    estimates: Mapping[int, OutputEstimate], holds: Mapping[int, FoundHold], confidence: float
) -> dict[int, OutputEstimate]:
    """The medians over the ways that disturbances may run, as far as the likelihood leaves them open."""
    out = dict(estimates)
    for found in holds.values():
        for i in found.thetas.keys() & out.keys():
            shifts = in_row(found.shifts(i), found.held[i], out[i].row, out[i].theta)
            out[i] = at_median(out[i], shifts, found.shares, confidence, Source.HOLD)
    return out
