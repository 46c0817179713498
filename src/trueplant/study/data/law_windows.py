"""What a record says of the gains of a declared law, by regression of OP on the law's parts.

The samples at which OP was free and PV good are cut into windows. Within each, OP is regressed on what each part of the
law adds, and the states' free responses are projected out: nothing has to be known of how the window began. One-sample
windows would be the increments of OP; longer ones see the integral, and rounding counts less in them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trueplant.arrays import Array, BoolArray, IntArray
from trueplant.loop import Controller, Kind, Sum, law_parts
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
class Windows:
    """Sums over the samples of each window, memory projected out; first axis: window."""

    labels: tuple[Label, ...]
    start: Array
    """Time of the first sample."""
    gram: Array
    """(n_w, m, m) of the parts."""
    moment: Array
    """(n_w, m) of the parts with OP."""
    power: Array
    """Of OP."""
    freedom: IntArray
    """Samples less what was projected out."""
    rounded: Array
    """(n_w, m, m) what the rounding of PV is expected to add to `gram`."""
    op_rounding: float
    """Variance that the rounding of OP leaves."""

    def __len__(self) -> int:
        return int(self.start.size)

    def missed(self) -> Array:
        """(n_w,) power of OP less the law as declared."""
        one = np.ones(len(self.labels))
        return np.asarray(np.maximum(self.power - 2 * self.moment @ one + one @ self.gram @ one, 0.0))

    def pv_rounding(self) -> float:
        """Power that the rounding of PV is expected to leave of the law as declared."""
        return float(self.rounded.sum())

    def usual(self) -> Array:
        """Median over the windows of the gains that each alone tells."""
        enough = self.freedom > 2 * len(self.labels)
        gram = self.gram[enough if enough.any() else slice(None)]
        moment = self.moment[enough if enough.any() else slice(None)]
        ridge = np.finfo(float).eps * np.trace(gram, axis1=1, axis2=2)[:, None, None] + np.finfo(float).tiny
        alone = np.linalg.solve(gram + ridge * np.eye(gram.shape[1]), moment[..., None])[..., 0]
        return np.asarray(np.median(alone, axis=0))

    def fit(self, part: slice = slice(None)) -> Fit:
        """The gains that fit a part of the windows best, without the bias that rounded PVs bring.

        Rounding cannot have brought more than the share of the residual that OP's own rounding leaves for it: where the
        controller acted on the rounded PV itself, it brought nothing. A part that does not move stays as declared, its
        variance infinite.
        """
        size = np.einsum("wmm->m", self.gram[part])
        moves = size > np.finfo(float).eps * size.sum()
        live = np.ix_(range(len(self.gram[part])), moves, moves)
        gram, rounded, moment = self.gram[part][live], self.rounded[part][live], self.moment[part][:, moves]
        gains, covariances = np.ones(moves.size), np.full((2, moves.size, moves.size), np.inf)
        G, E, g = gram.sum(axis=0), rounded.sum(axis=0), moment.sum(axis=0)
        power, freedom = float(self.power[part].sum()), max(float(self.freedom[part].sum()) - g.size, 1.0)

        def left(k: Array) -> float:
            value: float = power - 2 * k @ g + k @ G @ k
            return float(max(value, 0.0) / freedom)

        scale = np.sqrt(np.diag(G))
        ridge = np.diag(np.finfo(float).eps * scale**2)
        plain = np.linalg.solve(G + ridge, g)
        brought = plain @ E @ plain / freedom
        share = float(np.clip((left(plain) - self.op_rounding) / brought, 0.0, 1.0)) if brought > 0 else 0.0
        corrected = G - share * E
        if not g.size or np.linalg.eigvalsh(corrected / np.outer(scale, scale))[0] <= 0:
            gains[moves] = plain
            return Fit(gains, covariances, float(np.sqrt(left(plain))), share)
        inverse = np.linalg.inv(corrected + ridge)
        gains[moves] = inverse @ g
        # without one window at a time: windows that differ, and errors that are not white, are in it
        others = corrected + ridge - (gram - share * rounded)
        without = np.linalg.solve(others + ridge, (g - moment)[..., None])[..., 0] - gains[moves]
        covariances[0][np.ix_(moves, moves)] = without.T @ without * (1 - 1 / len(gram))
        white = inverse @ G @ inverse * left(gains[moves])
        covariances[1][np.ix_(moves, moves)] = 0.0 if len(gram) >= levels.LAW_WINDOWS else white
        doubt = levels.ROUNDING_LEFT * (gains[moves] - plain)
        covariances[(slice(None), *np.ix_(moves, moves))] += np.outer(doubt, doubt)
        return Fit(gains, covariances, float(np.sqrt(left(gains[moves]))), share)


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
    steps = cuts.pv_steps
    tables, labels = [], tuple[Label, ...]()
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
        inside = np.arange(cuts.longest) < length[:, None]
        known = np.linalg.qr(basis * inside[..., None])[0]
        freedom = length - np.minimum(basis.shape[1], length)
        columns = _without(known, np.column_stack([stretch.u, x])[place] * inside[..., None])
        gram = np.swapaxes(columns, 1, 2) @ columns
        noise = np.zeros((begin.size, x.shape[1], x.shape[1]))
        for _ in range(levels.ROUNDING_DRAWS if steps.any() else 0):
            y = stretch.y + steps * (rng.random(stretch.y.shape) - 0.5)
            moved = _without(known, (values(y)[0] - x)[place] * inside[..., None])
            noise += np.swapaxes(moved, 1, 2) @ moved / levels.ROUNDING_DRAWS
        tables.append((stretch.t[begin], gram[:, 1:, 1:], gram[:, 1:, 0], gram[:, 0, 0], freedom, noise))
    joined = [np.concatenate(column) for column in zip(*tables, strict=True)]
    start, gram, moment, power, freedom, noise = joined
    return Windows(labels, start, gram, moment, power, freedom, noise, cuts.op_step**2 / 12)


def _orthonormal(memory: Array) -> Array:
    """(steps, n) a basis of the free responses, without those that others contain."""
    scaled = memory / np.maximum(np.linalg.norm(memory, axis=0), np.finfo(float).tiny)
    left, size, _ = np.linalg.svd(scaled, full_matrices=False)
    return np.asarray(left[:, size > 1e-9 * size[0]])


def _without(basis: Array, x: Array) -> Array:
    return np.asarray(x - basis @ (np.swapaxes(basis, 1, 2) @ x))
