"""Two stretches of the same data: was the plant the same in both, was the noise?

What a plant that moved leaves unexplained passes for another noise, and another noise for another plant. Each stretch
is therefore fitted alone, plant, noise model and starts, and each question is put with the other one left open. No
error is taken to be normal or of one size: covariances are those of the sandwich, and sizes are compared by ranks.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.stats import chi2, norm, rankdata, t

from trueplant.arrays import Array, IntArray
from trueplant.detect import levels
from trueplant.detect.change_point import change_point
from trueplant.identify import RowFit, fit_row
from trueplant.identify.covariance import inflation, scaled
from trueplant.identify.estimate import fit_noise
from trueplant.identify.fit import linearised, residuals
from trueplant.identify.levels import SAMPLES_PER_PARAMETER, UNDERMODELLED
from trueplant.identify.likelihood import held_at, rise
from trueplant.identify.linear_algebra import inverse
from trueplant.identify.noise import fit_ar, whiten
from trueplant.identify.pieces import Piece
from trueplant.identify.row import Row
from trueplant.identify.sandwich import noise_covariance, plant_covariance
from trueplant.identify.validate import residual_tests


@dataclass(frozen=True, eq=False)
class TwoFits:
    """Two stretches of one output, each fitted alone."""

    one: RowFit
    other: RowFit

    @classmethod
    def of(cls, fit: RowFit, one: Sequence[Piece], other: Sequence[Piece]) -> TwoFits | None:
        """Started from the fit of both; None where one of them is too short to be fitted alone."""
        fits = [_alone(fit, pieces) for pieces in (one, other)]
        return None if fits[0] is None or fits[1] is None else cls(fits[0], fits[1])

    def plant_p(self, confidence: float) -> float:
        """p-value that the plant is the same in both, whatever the noise; `confidence` as in `inflation`.

        The less convinced counts of two tests: Wald, which knows what errors of uneven size do, and the likelihood
        ratio, which does not take the likelihood to be a parabola.
        """
        free = np.flatnonzero(self.one.free & self.other.free)
        if not free.size:
            return 1.0
        factors = [inflation(fit, confidence) for fit in self._both]
        weights = [
            inverse(scaled(plant_covariance(fit), factor)[np.ix_(free, free)])
            for fit, factor in zip(self._both, factors, strict=True)
        ]
        moved = (self.other.theta - self.one.theta)[free]
        wald = float(moved @ inverse(inverse(weights[0]) + inverse(weights[1])) @ moved)
        mean = self.one.theta.copy()
        mean[free] += inverse(weights[0] + weights[1]) @ weights[1] @ moved
        risen = min(self._rise(free, theta, factors) for theta in (mean, self.one.theta, self.other.theta))
        return float(chi2.sf(min(wald, risen), free.size))

    @cached_property
    def size_p(self) -> float:
        """p-value that the prediction errors are as large in one as in the other, whatever their distribution.

        The scores of Fligner and Killeen (1976): normal ones of the ranks of sizes. Sizes that come in bursts are
        related over time: the variance of a mean is its long-run one.
        """
        sizes = [np.abs(e) for e in self._errors]
        count = sizes[0].size
        ranks = rankdata(np.concatenate(sizes))
        scores = norm.ppf(0.5 + ranks / (2 * (ranks.size + 1)))
        parts = scores[:count], scores[count:]
        apart = float(parts[1].mean() - parts[0].mean())
        order = levels.CHANGE_LARGEST_ORDER
        variances = np.array([max(_level_variance(part, order), levels.SMALLEST_VARIANCE) for part in parts])
        # A spectral density from an autoregression has n/(2 order) degrees of freedom (Berk 1974); Satterthwaite's sum.
        freedom = variances.sum() ** 2 / sum(
            v**2 * 2 * order / part.size for v, part in zip(variances, parts, strict=True)
        )
        return float(2 * t.sf(abs(apart) / np.sqrt(variances.sum()), freedom))

    @cached_property
    def colour_p(self) -> float:
        """p-value that one noise model, its size apart, suits both."""
        order = self.one.ar.size
        if not order:
            return 1.0
        covariance = noise_covariance(self.one) + noise_covariance(self.other)
        moved = self.other.ar - self.one.ar
        return float(chi2.sf(float(moved @ inverse(covariance) @ moved), order))

    @property
    def noise_p(self) -> float:
        """p-value that the noise is the same in both, whatever the plant."""
        return min(1.0, 2 * min(self.size_p, self.colour_p))

    def deviance(self, variance: float) -> float:
        """-2 log likelihood up to a constant, of errors relative to this variance: to lose one of them is no gain."""
        return sum(fit.deviance - fit.left * float(np.log(variance)) for fit in self._both)

    @property
    def explained(self) -> bool:
        """Do the prediction errors follow no input? Else what is left is not noise alone."""
        return all(float(np.min(residual_tests(fit).cross_p)) >= UNDERMODELLED for fit in self._both)

    @property
    def std(self) -> tuple[float, float]:
        """Standard deviations of the disturbance."""
        one, other = (float(np.std(np.concatenate(vs))) for vs in self._output_errors)
        return one, other

    @property
    def correlation(self) -> tuple[float, float]:
        """Of the disturbance from one sample to the next."""
        one, other = (_correlation(vs) for vs in self._output_errors)
        return one, other

    @property
    def _both(self) -> tuple[RowFit, RowFit]:
        return self.one, self.other

    @property
    def _errors(self) -> list[Array]:
        """Prediction errors (n,), with what was fitted to them given back."""
        return [
            np.concatenate([e[there] for _, e, there in residuals(fit)]) * np.sqrt(fit.count / fit.left)
            for fit in self._both
        ]

    @property
    def _output_errors(self) -> list[list[Array]]:
        return [[v[np.isfinite(v)] for v, _, _ in residuals(fit)] for fit in self._both]

    def _rise(self, free: IntArray, theta: Array, factors: Sequence[Array]) -> float:
        """By how much -2 log likelihood rises if both have this plant."""
        fits = zip(self._both, factors, strict=True)
        return float(sum(rise(fit, held_at(fit, free, theta[free])) / np.mean(factor[free]) for fit, factor in fits))


@dataclass(frozen=True, eq=False)
class Moved:
    """Where in a record two plants fit best, one before and one after, if there are two at all."""

    fit: RowFit
    place: int
    """The first sample of the second, over all pieces on end."""
    near: tuple[int, int]
    """The neighbours that were tried."""
    tried: int
    """Instants."""
    sides: TwoFits

    def p_value(self, confidence: float) -> float:
        """That the plant is the same before and after, the search over the instants counted (Bonferroni)."""
        return min(1.0, self.tried * self.sides.plant_p(confidence))

    @property
    def time(self) -> float:
        piece, sample = _local(self.fit.row, self.place)
        return piece.start + piece.h * sample

    def refined(self) -> Moved:
        """To the sample (`change_point`), where it was one of `near`'s neighbours."""
        row, sides = self.fit.row, self.sides
        h = row.pieces[0].h
        begins = np.cumsum([0, *(piece.y.size for piece in row.pieces)])
        clock = h * begins[:-1] - np.array([piece.start for piece in row.pieces])
        low, high = (h * (at - 0.5) for at in self.near)
        args = (sides.one.theta, sides.other.theta, self.fit.free, self.fit.ar)
        found = change_point(row, clock, *args, (low, high))
        if found is None:
            return self
        place = round(found.time / h)
        again = _two_fits(self.fit, place)
        return self if again is None else replace(self, place=place, sides=again)

    def beside(self, fit: RowFit) -> TwoFits | None:
        """The plant of a fit of the same record, as it is, on both sides."""
        return _two_fits(replace(fit, free=np.zeros(fit.theta.size, dtype=bool), ar=self.fit.ar), self.place)

    def stretch(self, begin: int, end: int) -> tuple[Piece, ...]:
        """The part of a stretch on one side of the instant, the longer one: on it the plant is one and the same."""
        if not begin < self.place < end:
            return self.fit.row.between(begin, end)
        parts = self.fit.row.between(begin, self.place), self.fit.row.between(self.place, end)
        return max(parts, key=lambda pieces: sum(int(piece.valid.sum()) for piece in pieces))


def likeliest_change(fit: RowFit) -> Moved | None:
    """The instant at which two plants fit best by one step of Gauss and Newton from that of the whole record.

    None where no instant leaves enough on both sides.
    """
    blocks, fewest, free = list(_blocks(fit)), _fewest(fit), fit.free
    scores = np.cumsum([b.score[free] for b in blocks], axis=0)
    information = np.cumsum([b.information[np.ix_(free, free)] for b in blocks], axis=0)
    count = np.cumsum([b.count for b in blocks])
    inner = [k for k in range(len(blocks) - 1) if fewest < count[k] < count[-1] - fewest]
    if not inner:
        return None
    gains = [
        _power(scores[k], information[k]) + _power(scores[-1] - scores[k], information[-1] - information[k])
        for k in inner
    ]
    best = inner[int(np.argmax(gains))]
    place, ends = blocks[best + 1].begin, (blocks[best].begin, blocks[min(best + 2, len(blocks) - 1)].begin)
    sides = _two_fits(fit, place)
    return None if sides is None else Moved(fit, place, ends, len(inner), sides)


def _two_fits(fit: RowFit, place: int) -> TwoFits | None:
    return TwoFits.of(fit, *fit.row.parted(place))


def _local(row: Row, place: int) -> tuple[Piece, int]:
    """The piece in which a sample of all pieces on end lies, and where."""
    starts = np.cumsum([0, *(piece.y.size for piece in row.pieces)])
    k = min(int(np.searchsorted(starts, place, side="right")) - 1, len(row.pieces) - 1)
    return row.pieces[k], place - int(starts[k])


@dataclass(frozen=True, eq=False)
class _Block:
    begin: int
    """Its first sample, over all pieces on end."""
    score: Array
    """(size,)"""
    information: Array
    """(size, size)"""
    count: int
    """Prediction errors."""


def _blocks(fit: RowFit) -> Iterator[_Block]:
    """The record in about as many blocks as instants are tried, none of them over two pieces."""
    size, row = fit.theta.size, fit.row
    starts = np.cumsum([0, *(piece.y.size for piece in row.pieces)])
    length = -(-int(starts[-1]) // (row.stride * levels.FIRST_PASS))
    for part in linearised(row, fit.theta, fit.ar, fit.weights):
        total = len(range(0, row.pieces[part.number].y.size, row.stride))
        places = fit.ar.size + np.arange(total - fit.ar.size)[part.use]
        for begin in range(0, total, length):
            a, b = np.searchsorted(places, [begin, begin + length])
            own = part.jacobian[:size, a:b]
            first = int(starts[part.number]) + begin * row.stride
            yield _Block(first, own @ part.errors[a:b], own @ own.T, int(b - a))


def _power(score: Array, information: Array) -> float:
    return float(score @ inverse(information, levels.DEGENERATE) @ score)


def _alone(fit: RowFit, pieces: Sequence[Piece]) -> RowFit | None:
    """A stretch fitted alone, without the samples that answer to what OP did before it."""
    if not pieces:
        return None
    row = replace(fit.row, pieces=tuple(pieces))
    if sum(int(row.measured(k)[1].sum()) for k in range(len(pieces))) <= _fewest(fit):
        return None
    row = row.without_unseen(fit.theta)
    # A free response that a noise model cancels is left out (`identifiable_columns`): there can be a minimum with it
    # and one without. Hence one start from the noise of the whole record, and one from that of the stretch.
    still = fit_row(row, fit.theta, np.zeros(0), free=np.zeros(fit.theta.size, dtype=bool))
    order = fit.ar.size
    starts = [fit.ar, fit_noise(still, order, order)]
    return min((fit_row(row, fit.theta, ar, free=fit.free) for ar in starts if ar.size == order), key=lambda f: f.cost)


def _fewest(fit: RowFit) -> int:
    """Samples that a stretch needs to be fitted alone."""
    return int(SAMPLES_PER_PARAMETER * (fit.theta.size + fit.ar.size))


def _correlation(signals: Sequence[Array]) -> float:
    centred = [v - v.mean() for v in signals if v.size]
    power = sum(float(v @ v) for v in centred)
    return float(sum(v[1:] @ v[:-1] for v in centred) / max(power, levels.SMALLEST_VARIANCE))


def _level_variance(v: Array, order: int) -> float:
    """Variance of the mean of v (N,): its long-run variance by an autoregression, over N."""
    centred = v - np.mean(v)
    ar = fit_ar([centred], [np.ones(v.size, dtype=bool)], order)[0]
    e = whiten(ar, centred)
    gain = 1 / max(abs(1 + float(np.sum(ar))), 1e-3)
    return float(np.mean(e**2) * gain**2 / v.size)
