"""Samples of a trend that were left out: which they are, and what is drawn of them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from trueplant.arrays import Array, BoolArray
from trueplant.result import Curves, Trend


def spans_of(curves: Curves, trend: Trend, signal: str) -> list[tuple[float, float, str]]:
    """(from, to, reason) of what was left out of `signal`; a span that names no signal concerns all of them."""
    signals = (*curves.outputs, *curves.inputs)
    return [
        (low, high, reason) for low, high, named, reason in trend.excluded if named == signal or named not in signals
    ]


def used(curves: Curves, trend: Trend, signal: str) -> BoolArray:
    """(N,) samples of `signal` that were not left out; all of them where none would be left."""
    found = ~_within(trend.t, [(low, high) for low, high, _ in spans_of(curves, trend, signal)])
    return found if found.any() else ~found


def drawn(trend: Trend, signal: str, values: Array) -> Array:
    """`values` (N,) with gaps where this very signal was struck; what was left out of all signals is still drawn."""
    struck = _within(trend.t, [(low, high) for low, high, named, _ in trend.excluded if named == signal])
    return np.where(struck, np.nan, values) if not struck.all() else values


def _within(t: Array, spans: Sequence[tuple[float, float]]) -> BoolArray:
    """(N,) instants that lie in one of the spans, both ends counted."""
    change = np.zeros(t.size + 1, dtype=np.int64)
    if spans and t.size:
        low, high = np.array(spans).T
        np.add.at(change, np.searchsorted(t, low, side="left"), 1)
        np.add.at(change, np.searchsorted(t, high, side="right"), -1)
    return np.asarray(np.cumsum(change)[:-1] > 0)
