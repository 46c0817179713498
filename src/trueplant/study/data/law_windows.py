"""What a record says of the gains of a declared law, by regression of OP on the law's parts.

The samples at which OP was free and PV good are cut into windows. Within each, OP is regressed on what each part of the
law adds, and the states' free responses are projected out: nothing has to be known of how the window began. One-sample
windows would be the increments of OP; longer ones see the integral, and rounding counts less in them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike
from scipy.signal import lfilter

from trueplant.arrays import Array, BoolArray, IntArray
from trueplant.loop import Controller, Kind, Part, Sum, law_parts
from trueplant.record.runs import true_runs
from trueplant.record.sensor import quantum
from trueplant.study import levels

Label = tuple[int, Kind]
"""Output and kind of a part."""
Sums = tuple[Sum, Sum]
"""How integrals, and how all else, are summed up."""


@dataclass(frozen=True, eq=False)
class Stretch:
    """A segment at the scan of a law; signals are finite throughout, and true where `good`."""

    t: Array
    u: Array
    """(N,) the one OP."""
    r: Array
    y: Array
    """(N, n_y)"""
    good: BoolArray
    """(N,) True where OP was free and the law's set-points and PVs are known."""
    h: float
    settled: Array | None = None
    """(N, n_y) as that of a segment."""

    @property
    def setpoints(self) -> Array:
        """(N, n_y) as they count for moves."""
        return self.r if self.settled is None else self.settled


@dataclass(frozen=True, eq=False)
class Fit:
    """Gains of a law's parts relative to the declared ones."""

    gains: Array
    covariances: Array
    """(2, m, m) by the jackknife over windows, and where these are few by errors that are white."""
    rms: float
    """Of OP less the fitted law."""
    share: float
    """Of the rounding of PV that is taken to stand between the record and what the law acted on."""

    def std(self, direction: Array) -> float:
        """Standard error of a combination of the gains, the larger of the two."""
        along = direction[direction != 0]
        used = self.covariances[:, direction != 0][:, :, direction != 0]
        if not np.isfinite(used).all():
            return float("inf")
        return float(np.sqrt(max(0.0, *(along @ c @ along for c in used))))


@dataclass(frozen=True, eq=False)
class Moments:
    """Sums over the samples of each window, memory projected out; first axis: window."""

    gram: Array
    """(n_w, m, m) of the parts."""
    moment: Array
    """(n_w, m) of the parts with OP."""
    power: Array
    """Of OP."""
    rounded: Array
    """(n_w, m, m) what the rounding of PV is expected to add to `gram`."""
    op_rounding: float
    """Variance that the rounding of OP leaves."""

    def of(self, part: slice, moves: BoolArray) -> Moments:
        """Of some of the windows and parts."""
        gram, rounded = (x[part][:, moves][:, :, moves] for x in (self.gram, self.rounded))
        return Moments(gram, self.moment[part][:, moves], self.power[part], rounded, self.op_rounding)

    def left(self, gains: Array) -> float:
        """Power of OP less the law with these gains."""
        whole = self.power.sum() - 2 * gains @ self.moment.sum(axis=0) + gains @ self.gram.sum(axis=0) @ gains
        return float(max(whole, 0.0))


@dataclass(frozen=True, eq=False)
class Windows:
    """What the windows of a record say of a law."""

    labels: tuple[Label, ...]
    start: Array
    """Time of the first sample."""
    freedom: IntArray
    """Samples less what was projected out."""
    plain: Moments
    """Of OP as it was recorded."""
    weighted: Moments
    """Of OP behind the filter that makes white noise of what rounding does to it: gains are known best by these."""
    slowness: float = 0.0
    """Correlation of the rounding errors of a PV from one sample to the next, below 1."""

    def __len__(self) -> int:
        return int(self.start.size)

    def missed(self) -> Array:
        """(n_w,) power of OP less the law as declared."""
        one, of = np.ones(len(self.labels)), self.plain
        return np.asarray(np.maximum(of.power - 2 * of.moment @ one + one @ of.gram @ one, 0.0))

    def pv_rounding(self) -> float:
        """Power that the rounding of PV is expected to leave of the law as declared."""
        return float(self.plain.rounded.sum())

    def usual(self) -> Array:
        """Median over the windows of the gains that each alone tells."""
        enough = self.freedom > 2 * len(self.labels)
        chosen = enough if enough.any() else slice(None)
        gram, moment = self.weighted.gram[chosen], self.weighted.moment[chosen]
        ridge = np.finfo(float).eps * np.trace(gram, axis1=1, axis2=2)[:, None, None] + np.finfo(float).tiny
        alone = np.linalg.solve(gram + ridge * np.eye(gram.shape[1]), moment[..., None])[..., 0]
        return np.asarray(np.median(alone, axis=0))

    def fit(self, part: slice = slice(None)) -> Fit:
        """The gains that fit a part of the windows best, without the bias that rounded PVs bring.

        Rounding cannot have brought more than the share of the residual that OP's own rounding leaves for it: where the
        controller acted on the rounded PV itself, it brought nothing. A part that does not move stays as declared, its
        variance infinite.
        """
        size = np.einsum("wmm->m", self.plain.gram[part])
        moves = size > np.finfo(float).eps * size.sum()
        sums, plain = self.weighted.of(part, moves), self.plain.of(part, moves)
        gains, covariances = np.ones(moves.size), np.full((2, moves.size, moves.size), np.inf)
        G, E, g = sums.gram.sum(axis=0), sums.rounded.sum(axis=0), sums.moment.sum(axis=0)
        freedom = max(float(self.freedom[part].sum()) - g.size, 1.0)

        def found(share: float) -> Fit:
            return Fit(gains, covariances, float(np.sqrt(plain.left(gains[moves]) / freedom)), share)

        scale = np.sqrt(np.diag(G))
        ridge = np.diag(np.finfo(float).eps * scale**2)
        sizes, lost = np.outer(scale, scale), np.sqrt(np.finfo(float).eps)
        biased = np.linalg.pinv(G / sizes, rcond=lost, hermitian=True) @ (g / scale) / scale
        brought = biased @ E @ biased / freedom
        over = sums.left(biased) / freedom - sums.op_rounding
        share = float(np.clip(over / brought, 0.0, 1.0)) if brought > 0 else 0.0
        corrected = G - share * E
        if not g.size or np.linalg.eigvalsh(corrected / sizes)[0] <= lost:
            gains[moves] = biased
            return found(share)
        inverse = np.linalg.inv(corrected + ridge)
        gains[moves] = inverse @ g
        # without one window at a time: windows that differ, and errors that are not white, are in it
        others = corrected + ridge - (sums.gram - share * sums.rounded)
        without = np.linalg.solve(others + ridge, (g - sums.moment)[..., None])[..., 0] - gains[moves]
        n = len(sums.gram)
        covariances[0][np.ix_(moves, moves)] = without.T @ without * (1 - 1 / n)
        white = inverse @ G @ inverse * sums.left(gains[moves]) / freedom
        covariances[1][np.ix_(moves, moves)] = 0.0 if n >= levels.LAW_WINDOWS else white
        # slow errors have so much more power where it is that of a gain
        doubt = (levels.ROUNDING_LEFT + 2 * self.slowness / (1 - self.slowness)) * (gains[moves] - biased)
        covariances[(slice(None), *np.ix_(moves, moves))] += np.outer(doubt, doubt)
        return found(share)


@dataclass(frozen=True, eq=False)
class Cuts:
    """Where the windows lie in their stretches: they are the same however the law is summed up."""

    stretches: tuple[Stretch, ...]
    begin: tuple[IntArray, ...]
    length: tuple[IntArray, ...]
    longest: int
    """Samples."""
    pv_steps: Array
    """(n_y,) in which the PVs were recorded; 0 for those that the law does not act on ..."""
    op_step: float
    """... and OP."""

    @property
    def samples(self) -> int:
        return int(sum(n.sum() for n in self.length))

    @cached_property
    def slowness(self) -> float:
        """Correlation of a PV's rounding errors from one sample to the next, of the slowest PV.

        A PV that moves by normal increments of standard deviation s has errors that correlate by the sum of exp(-2 (pi
        k s/q)^2)/k^2 over the sum of 1/k^2 (Sripad and Snyder 1977). The mean move of the rounded PV is that of PV
        itself.
        """
        moves = [np.abs(np.diff(one.y, axis=0))[one.good[1:] & one.good[:-1]] for one in self.stretches]
        coarse, k = self.pv_steps > 0, np.arange(1.0, 100.0)[:, None]
        s = np.sqrt(np.pi / 2) * np.mean(np.concatenate(moves), axis=0)[coarse] / self.pv_steps[coarse]
        correlations = np.sum(np.exp(-2 * (np.pi * k * s) ** 2) / k**2, axis=0) / np.sum(1 / k**2)
        return float(min(np.max(correlations, initial=0.0), 1 - np.finfo(float).eps))


def cut(stretches: Sequence[Stretch], controller: Controller, i: int) -> Cuts:
    """Windows of good samples in which a set-point or a PV that writes OP i moves by more than its rounding."""
    outputs = sorted({j for row, j in controller.entries if row == i})
    runs = [true_runs(s.good) for s in stretches]
    longest = max(sum(int(n.sum()) for _, n in runs) // levels.LAW_WINDOWS, levels.LAW_WINDOW)
    quanta = np.zeros(controller.n_y)
    for j in outputs:
        quanta[j] = _step(np.concatenate([np.zeros(0), *(s.y[s.good, j] for s in stretches)]))
    op_step = _step(np.concatenate([np.zeros(0), *(s.u[s.good] for s in stretches)]))
    begins, lengths = [], []
    for stretch, run in zip(stretches, runs, strict=True):
        first, size = _pieces(*run, longest)
        moves = np.zeros(first.size, dtype=bool)
        for j in outputs:
            span = [_spans(x[:, j], first, size) for x in (stretch.y, stretch.setpoints)]
            moves |= (span[0] > levels.MOVED_QUANTA * quanta[j]) | (span[1] > 0)
        begins.append(first[moves])
        lengths.append(size[moves])
    return Cuts(tuple(stretches), tuple(begins), tuple(lengths), longest, quanta, op_step)


def _step(x: Array) -> float:
    """The step in which a signal was recorded; its smallest move where that is not clear; 0 if it never moves."""
    moves = np.abs(np.diff(x))
    return quantum(x) or float(np.min(moves[moves > 0], initial=np.inf if (moves > 0).any() else 0.0))


def _pieces(begin: IntArray, length: IntArray, longest: int) -> tuple[IntArray, IntArray]:
    """First index and length of the nearly equal pieces into which runs are cut."""
    count = -(-length // longest)
    piece = -(-length // np.maximum(count, 1))
    place = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
    first = np.repeat(begin, count) + place * np.repeat(piece, count)
    return first, np.minimum(np.repeat(piece, count), np.repeat(begin + length, count) - first)


def _spans(x: Array, first: IntArray, size: IntArray) -> Array:
    """Largest less smallest value of x in each window; windows are in order and do not overlap."""
    if not first.size:
        return np.zeros(0)
    edges = np.minimum(np.column_stack([first, first + size]).ravel(), x.size - 1)
    ends = x[first + size - 1]
    top = np.maximum(np.maximum.reduceat(x, edges)[::2], ends)
    return np.asarray(top - np.minimum(np.minimum.reduceat(x, edges)[::2], ends))


def windows_of(cuts: Cuts, controller: Controller, i: int, sums: Sums) -> Windows:
    """The sums of every window for OP i of a controller."""
    rng = np.random.default_rng(0)
    steps, filters = cuts.pv_steps, (_Filter(), _whitening(cuts, controller, i, sums))
    start, freedom, labels = list[Array](), list[IntArray](), tuple[Label, ...]()
    tables: tuple[list[Moments], ...] = [], []
    for stretch, begin, length in zip(cuts.stretches, cuts.begin, cuts.length, strict=True):
        if not begin.size:
            continue

        def values(y: Array, s: Stretch = stretch) -> tuple[Array, Array]:
            nonlocal labels
            parts = law_parts(controller, i, s.r, y, s.h, *sums, cuts.longest)
            labels = tuple((p.place[1], p.kind) for p in parts)
            memory = np.hstack([np.ones((cuts.longest, 1)), *(p.memory for p in parts)])
            return np.column_stack([p.values for p in parts]), memory

        x, memory = values(stretch.y)
        basis = _orthonormal(memory)
        place = np.minimum(begin[:, None] + np.arange(cuts.longest), stretch.u.size - 1)
        inside = (np.arange(cuts.longest) < length[:, None])[..., None]
        start.append(stretch.t[begin])
        freedom.append(length - np.minimum(basis.shape[1], length))
        columns = np.column_stack([stretch.u, x])[place] * inside
        draws = range(levels.ROUNDING_DRAWS if steps.any() else 0)
        shaken = [values(stretch.y + steps * (rng.random(stretch.y.shape) - 0.5))[0] - x for _ in draws]
        moved = [one[place] * inside for one in shaken]
        for behind, table in zip(filters, tables, strict=True):
            known = np.linalg.qr(behind(basis * inside) * inside)[0]
            own, *noise = (_without(known, behind(one) * inside) for one in (columns, *moved))
            table.append(_moments(own, noise, cuts.op_step**2 / 12 * behind.power(cuts.longest)))
    plain, weighted = map(_joined, tables)
    return Windows(labels, np.concatenate(start), np.concatenate(freedom), plain, weighted, cuts.slowness)


def _moments(columns: Array, noise: Sequence[Array], op_rounding: float) -> Moments:
    """Of OP and the parts (n_w, samples, 1 + m), and of what simulated roundings add to the parts."""
    gram, rounded = _gram(columns), [_gram(one) for one in noise]
    expected = np.mean(rounded, axis=0) if rounded else np.zeros_like(gram[:, 1:, 1:])
    return Moments(gram[:, 1:, 1:], gram[:, 1:, 0], gram[:, 0, 0], expected, op_rounding)


def _gram(x: Array) -> Array:
    return np.asarray(np.swapaxes(x, 1, 2) @ x)


def _joined(some: Sequence[Moments]) -> Moments:
    arrays = zip(*((one.gram, one.moment, one.power, one.rounded) for one in some), strict=True)
    gram, moment, power, rounded = (np.concatenate(one) for one in arrays)
    return Moments(gram, moment, power, rounded, some[0].op_rounding)


@dataclass(frozen=True, eq=False)
class _Filter:
    """Polynomials in 1/z, of the numerator and the denominator."""

    above: Array = field(default_factory=lambda: np.ones(1))
    below: Array = field(default_factory=lambda: np.ones(1))

    def __call__(self, x: Array) -> Array:
        """Along the samples of each window (n_w, samples, n), from rest."""
        return x if self.above.size == 1 else np.asarray(lfilter(self.above, self.below, x, axis=1))

    def power(self, samples: int) -> float:
        """Variance of what it makes of white noise of variance 1."""
        return float(np.sum(lfilter(self.above, self.below, np.eye(1, samples)[0]) ** 2))


def _whitening(cuts: Cuts, controller: Controller, i: int, sums: Sums) -> _Filter:
    """Behind which white noise is left of what rounding does to OP.

    OP's own rounding is white, and that of a PV reaches OP through the law. Behind the law's recursion both are moving
    averages; the filter divides by their spectral factor, the roots within the unit circle.
    """
    steps, own = cuts.pv_steps, [s for s, begin in zip(cuts.stretches, cuts.begin, strict=True) if begin.size]
    if not own or not steps.any():
        return _Filter()
    rest = np.median(np.concatenate([s.y[s.good] for s in own]), axis=0)

    def struck(by: Array, samples: int) -> tuple[Part, ...]:
        still = np.tile(rest, (samples, 1))
        return law_parts(controller, i, still, still + by * np.eye(samples, 1), own[0].h, *sums, 1)

    recursion = recursion_of([part.poles for part in struck(0 * steps, 1)])
    size = recursion.size
    answers = [np.sum([p.values for p in struck(by, size)], axis=0) for by in (0 * steps, *np.diag(steps)[steps > 0])]
    averages = [np.convolve(one - answers[0], recursion)[:size] for one in answers[1:]]
    spectrum = np.sum([np.convolve(one, one[::-1]) for one in (*averages, cuts.op_step * recursion)], axis=0)
    roots = np.roots(spectrum)
    return _Filter(recursion, np.atleast_1d(np.real(np.poly(roots[np.argsort(np.abs(roots))][: size - 1]))))


def recursion_of(poles: Sequence[ArrayLike]) -> Array:
    """The polynomial in 1/z behind which a law with these poles has no memory."""
    each = np.unique(np.round(np.concatenate([np.zeros(0), *poles]), 12))
    return np.atleast_1d(np.real(np.poly(each)))


def _orthonormal(memory: Array) -> Array:
    """(steps, n) a basis of the free responses, without those that others contain."""
    scaled = memory / np.maximum(np.linalg.norm(memory, axis=0), np.finfo(float).tiny)
    left, size, _ = np.linalg.svd(scaled, full_matrices=False)
    return np.asarray(left[:, size > 1e-9 * size[0]])


def _without(basis: Array, x: Array) -> Array:
    return np.asarray(x - basis @ (np.swapaxes(basis, 1, 2) @ x))
