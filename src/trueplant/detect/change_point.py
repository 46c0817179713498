"""When did the plant change: one likelihood of the raw record with the old parameters before and the new ones after.

The output follows the old plant up to the instant and the new one from there on, each driven by the whole recorded
input; a level and the free responses of the changed elements may begin with the change. That covers a sensor, whose
change acts at once, as well as an actuator or the process itself, whose state runs on: the instant is when PV begins
to follow the new parameters, for a change at the actuator one dead time after it.

The likelihood has a kink at the true instant, not a parabola. The interval holds all instants whose likelihood ratio
stays below -2 log(1 - sqrt(confidence)): the distribution of the ratio of a two-sided random walk with drift (Hansen
2000, Econometrica 68, for thresholds; Eo and Morley 2015 for breaks), 7.35 for 95 %. For large changes it is
conservative.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trueplant.arrays import Array, BoolArray
from trueplant.detect import levels
from trueplant.identify.noise import choose_order, fit_ar, whiten, whitened_valid
from trueplant.identify.row import Row


@dataclass(frozen=True, eq=False)
class ChangePoint:
    """The instant at which the row goes from one set of parameters to another."""

    time: float
    interval: tuple[float, float]
    before: Array
    after: Array
    """(size,) parameters; those that were not allowed to change are equal."""
    gain: float
    """Likelihood ratio of the change against none, as 2 log L."""


@dataclass(frozen=True, eq=False)
class _Parts:
    """What does not depend on the instant, all pieces on top of each other."""

    t: Array
    piece: NDArray[np.intp]
    valid: BoolArray
    target: Array
    """(n,) measured output minus the response of the old plant."""
    difference: Array
    """(n,) response of the new plant minus that of the old one."""
    common: Array
    """(n, c) derivatives by what does not change, offsets and free responses."""
    old: Array
    """(n, m) derivatives by the parameters that change, before and after."""
    new: Array
    lags: tuple[float, ...]

    @property
    def finite(self) -> bool:
        """Do both plants answer with numbers that can be squared? Steps may have led to one that runs beyond all."""
        every = self.target, self.difference, self.common, self.old, self.new
        with np.errstate(over="ignore"):
            return all(np.isfinite(np.linalg.norm(x)) for x in every)


def critical(confidence: float) -> float:
    """The likelihood ratio up to which an instant belongs to the interval."""
    return float(-2 * np.log(1 - np.sqrt(confidence)))


def change_point(
    row: Row,
    clock: Array,
    before: Array,
    after: Array,
    changing: BoolArray,
    ar: Array,
    search: tuple[float, float],
    confidence: float = 0.95,
) -> ChangePoint | None:
    """The best instant within `search` and its interval; None where the record has no place for one, or the guesses
    answer beyond all numbers.

    `clock` (n_pieces,) is added to each piece's own time. `before` and `after` (size,) are initial guesses,
    `changing` marks those that may differ, `ar` is that of the noise model.
    """
    low, high = row.bounds()
    before, after = before.copy(), np.where(changing, after, before)
    found = None
    for _ in range(levels.CHANGE_ROUNDS):
        parts = _parts(row, clock, before, after, changing)
        if not parts.finite:
            return found
        filtered = _Filtered(parts, ar)
        places = filtered.places(search)
        if places.size < 3:
            return None
        tried, deviance = _profile(filtered, places, critical(confidence))
        here = int(np.argmin(deviance))
        inside = np.flatnonzero(deviance - deviance[here] <= critical(confidence))
        edges = filtered.edges
        best, gain = float(edges[tried[here]]), filtered.constant - float(deviance[here])
        interval = (float(edges[tried[inside[0]] - 1]), float(edges[tried[inside[-1]]]))
        step, errors = filtered.solve(tried[here])
        size, moving = before.size, int(changing.sum())
        shared = np.zeros(size)
        shared[~changing] = step[: size - moving]
        old, new = shared.copy(), shared.copy()
        old[changing], new[changing] = step[-2 * moving : -moving], step[-moving:]
        with np.errstate(over="ignore"):  # beyond all numbers it has moved too
            moved = max(float(np.max(np.abs(s) / (np.abs(p) + 1e-12))) for s, p in ((old, before), (new, after)))
        found = ChangePoint(best, interval, before, after, gain)
        before, after = (np.clip(_limited(p, s), low, high) for p, s in ((before, old), (after, new)))
        ar = _noise(errors, parts, row)
        if moved < levels.CHANGE_SETTLED:
            break
    return None if found is None else replace(found, before=before, after=after)


def _limited(theta: Array, step: Array) -> Array:
    """No parameter by more than half of its size at once; dead times near 0 may leave it."""
    most = np.maximum(np.abs(theta) / 2, 1e-3 * np.abs(theta).max())
    return theta + np.clip(step, -most, most)


def _parts(row: Row, clock: Array, before: Array, after: Array, changing: BoolArray) -> _Parts:
    columns: list[list[NDArray[Any]]] = [[] for _ in range(7)]
    sizes = [row.nuisance(before, k).shape[1] for k in range(len(row.pieces))]
    for k, piece in enumerate(row.pieces):
        y, valid = row.measured(k)
        response, gradient = row.response_and_gradient(before, k)
        other, gradient_after = row.response_and_gradient(after, k)
        nuisance = np.zeros((y.size, sum(sizes)))
        nuisance[:, sum(sizes[:k]) : sum(sizes[: k + 1])] = row.nuisance(before, k)
        t = clock[k] + piece.start + piece.h * row.stride * np.arange(y.size)
        found = (t, np.full(y.size, k), valid, np.where(valid, y - response, 0.0), other - response)
        derivatives = np.hstack([gradient[:, ~changing], nuisance])
        for part, column in zip(
            columns, (*found, derivatives, np.stack([gradient[:, changing], gradient_after[:, changing]])), strict=True
        ):
            part.append(column)
    t, piece_of, valid, target, difference, common = (np.concatenate(part) for part in columns[:6])
    old, new = np.concatenate(columns[6], axis=1)
    lags = [
        float(lag)
        for spec, part in zip(row.specs, row.slices, strict=True)
        if changing[part].any()
        for lag in after[part][spec.structure.is_lag]
    ]
    return _Parts(t, piece_of, valid, target, difference, common, old, new, tuple(lags))


class _Filtered:
    """The parts through the inverse noise model, and the least squares at each instant."""

    def __init__(self, parts: _Parts, ar: Array) -> None:
        self.parts, self.ar, order = parts, ar, ar.size
        starts = np.flatnonzero(np.diff(parts.piece, prepend=-1))
        self.bounds = [*starts.tolist(), parts.t.size]
        use = [
            np.concatenate([np.zeros(min(order, b - a), dtype=bool), whitened_valid(order, parts.valid[a:b])])
            for a, b in zip(self.bounds[:-1], self.bounds[1:], strict=True)
        ]
        self.use: BoolArray = np.concatenate(use)
        self.edges = parts.t
        self.common = self._white(parts.common)
        self.nothing = self._white(np.column_stack([parts.old, parts.target]))
        freedom = self.use.sum() - self.common.shape[1] - 2 * parts.old.shape[1] - order
        self.left = max(int(freedom), 1)
        columns = np.hstack([self.common, self.nothing[:, :-1]])
        self.constant = self.left * float(np.log(_remainder(columns, self.nothing[:, -1])))

    def _white(self, x: Array) -> Array:
        """(n used, ...) filtered; each piece by itself."""
        order = self.ar.size
        out = [
            np.concatenate([np.zeros((min(order, b - a), x.shape[1])), whiten(self.ar, x[a:b])])[: b - a]
            for a, b in zip(self.bounds[:-1], self.bounds[1:], strict=True)
        ]
        return np.concatenate(out)[self.use]

    def places(self, search: tuple[float, float]) -> NDArray[np.intp]:
        """Samples that may be the first of the new plant."""
        seen = np.cumsum(self.use)
        t = self.parts.t
        inside = (t > search[0]) & (t <= search[1]) & (seen >= levels.BESIDE) & (seen <= seen[-1] - levels.BESIDE)
        inside[0] = False
        return np.flatnonzero(inside)

    def _own(self, place: int) -> tuple[Array, Array]:
        """(N, m) the columns that depend on the instant, and (N,) what all columns have to explain."""
        parts = self.parts
        late = np.arange(parts.t.size) >= place
        after = late[:, None]
        since = np.where(late, parts.t - parts.t[place], 0.0)
        begun = [late.astype(float)] + [np.where(late, np.exp(-since / lag), 0.0) for lag in parts.lags]
        columns = np.column_stack([*begun, np.where(after, 0.0, parts.old), np.where(after, parts.new, 0.0)])
        return columns, parts.target - np.where(late, parts.difference, 0.0)

    def _system(self, place: int) -> tuple[Array, Array]:
        white = self._white(np.column_stack(self._own(place)))
        return np.hstack([self.common, white[:, :-1]]), white[:, -1]

    def deviance(self, place: int) -> float:
        return self.left * float(np.log(_remainder(*self._system(place))))

    def solve(self, place: int) -> tuple[Array, Array]:
        """All coefficients at an instant, and the output errors (n,) that they leave."""
        columns, target = self._system(place)
        scale = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
        step = np.linalg.lstsq(columns / scale, target, rcond=1e-9)[0] / scale
        own, raw_target = self._own(place)
        errors = raw_target - np.hstack([self.parts.common, own]) @ step
        return step, np.where(self.parts.valid, errors, 0.0)


def _remainder(columns: Array, target: Array) -> float:
    """Mean square of what the columns leave of the target."""
    scale = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    u, s, _ = np.linalg.svd(columns / scale, full_matrices=False)
    basis = u[:, s > 1e-9 * s[0]]
    rest = target - basis @ (basis.T @ target)
    return max(float(rest @ rest) / target.size, 1e-300)


def _profile(filtered: _Filtered, places: NDArray[np.intp], threshold: float) -> tuple[NDArray[np.intp], Array]:
    """Instants tried, in order, and the deviance at each: coarse first, then every sample where it matters."""
    found: dict[int, float] = {}
    wanted = places[np.unique(np.linspace(0, places.size - 1, levels.FIRST_PASS).astype(int))]
    while True:
        for place in wanted:
            if int(place) not in found:
                found[int(place)] = filtered.deviance(int(place))
        tried = np.array(sorted(found))
        deviance = np.array([found[int(k)] for k in tried])
        near = np.flatnonzero(deviance <= deviance.min() + 2 * threshold + 10)
        low = tried[max(near[0] - 1, 0)]
        high = tried[min(near[-1] + 1, tried.size - 1)]
        between = places[(places >= low) & (places <= high)]
        wanted = between[np.unique(np.linspace(0, between.size - 1, levels.CLOSER_PASS).astype(int))]
        if all(int(k) in found for k in wanted) or len(found) > levels.FIRST_PASS + 6 * levels.CLOSER_PASS:
            return tried, deviance


def _noise(errors: Array, parts: _Parts, row: Row) -> Array:
    """The noise model of the output errors, of the order that the Bayesian criterion chooses."""
    pieces = [parts.piece == k for k in range(len(row.pieces))]
    signals, valid = [errors[p] for p in pieces], [parts.valid[p] for p in pieces]
    return fit_ar(signals, valid, choose_order(signals, valid, levels.CHANGE_LARGEST_ORDER))[0]
