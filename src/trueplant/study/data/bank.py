"""PV beside its own past and what may have moved it, through a bank of lags: a plant of any kind, to first order."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from trueplant.arrays import Array, BoolArray
from trueplant.identify.noise import whitened_valid
from trueplant.record.levels import NORMAL_MAD
from trueplant.study import levels
from trueplant.study.data.setpoints import unexplained


@dataclass(frozen=True, eq=False)
class Asked:
    """An output beside its own past and what may have moved it, through a bank of lags."""

    columns: Array
    """(n, 1 + order + beside + lags times sources) of all stretches: the output, its past, that of others, the
    sources."""
    order: int
    beside: int
    """Columns of others, now and before."""

    @classmethod
    def of(
        cls, outputs: Sequence[Array], sources: Sequence[Array], beside: Sequence[Array] | None = None
    ) -> Asked | None:
        """None where the output never moves. All (N,) or (N, n), one an element for each stretch."""
        others: Sequence[Array] = [x[:, :0] for x in sources] if beside is None else beside
        samples = sum(y.size for y in outputs)
        step = max(1, samples // levels.ANSWER_SAMPLES)
        outputs = [y[::step] for y in outputs]
        asked, number = levels.ANSWER_LAGS * sources[0].shape[1], others[0].shape[1]
        order = _past([np.isfinite(y) for y in outputs], asked, number)
        poles = np.exp(-1 / np.geomspace(2.0, max(samples / step / 10, 4.0), levels.ANSWER_LAGS))
        rows = []
        for y, d, x in zip(outputs, (one[::step] for one in others), sources, strict=True):
            if y.size > order:
                past = [y[order - k : y.size - k] for k in range(1, order + 1)]
                past += [d[order - k : y.size - k] for k in range(order + 1)]
                bank = [x[0] + lfilter([0.0, 1 - a], [1.0, -a], x[::step] - x[0], axis=0)[order:] for a in poles]
                one = np.column_stack([y[order:], *past, *bank])
                one = one[np.isfinite(one).all(axis=1)]
                rows += [one] if len(one) else []
        if all(np.ptp(one[:, 0]) == 0 for one in rows):
            return None
        return cls(np.vstack(rows), order, number * (order + 1))


def _past(measured: Sequence[BoolArray], asked: int, beside: int) -> int:
    """Samples of an output's own past that are asked for: fewer where too few samples have so many before them.

    `asked` are the columns beside it, `beside` the signals of which as much is asked for.
    """
    size = sum(one.size for one in measured)
    for order in range(min(levels.ANSWER_PAST, size // 10), 0, -1):
        there = sum(int(whitened_valid(order, one).sum()) for one in measured if one.size > order)
        whole = sum(one.size - order for one in measured if one.size > order)
        if there >= min(levels.FEWEST_PER_COEFFICIENT * ((order + 1) * (beside + 1) + asked), whole):
            return order
    return 0


def weighed(joined: Array, weights: Array) -> Array:
    """The rows of `joined` (n, m) about their weighted mean, each as far as its weight (n,) lets it count.

    One mean of all stretches: one of each would bias what an output owes to its past.
    """
    centred: Array = np.sqrt(weights)[:, None] * (joined - weights @ joined / weights.sum())
    return centred


def bounded_weights(joined: Array) -> Array:
    """(n,) by which no row counts for more than some standard deviations of what all columns but the first leave of
    that, and of these themselves, by which a trip would else say alone what PV owes to its past (Huber 1981; Mallows
    1975).

    All alike where most samples are told to the last digit.
    """
    away = np.abs(joined[:, 1:] - np.median(joined[:, 1:], axis=0))
    usual = NORMAL_MAD * np.median(away, axis=0)
    far = np.max(away / np.where(usual > 0, usual, np.inf), axis=1, initial=0.0) / levels.ANSWER_BOUND
    begun: Array = np.maximum(far, 1.0) ** -2
    weights = begun
    for _ in range(levels.ANSWER_ROUNDS):
        rows = weighed(joined, weights)
        errors = np.abs(unexplained(rows[:, 0], rows[:, 1:], rcond=1e-10)) / np.sqrt(weights)
        most = levels.ANSWER_BOUND * NORMAL_MAD * float(np.median(errors))
        if most <= 1e-10 * float(np.linalg.norm(rows[:, 0])):
            return np.ones(len(joined))
        before, weights = weights, begun * (most / np.maximum(errors, most)) ** 2
        if np.max(np.abs(weights - before)) < levels.ANSWER_SETTLED:
            break
    return weights
