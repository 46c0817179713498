"""Signals whose samples were stored when they changed, on one even grid: what happened in between is reconstructed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueplant.arrays import Array, BoolArray
from trueplant.calendar import unit_seconds
from trueplant.errors import DataError
from trueplant.record import levels
from trueplant.record.layout import Layout


@dataclass(frozen=True)
class Grid:
    """An even grid of moments in seconds, and how far a value reaches."""

    moments: Array
    step: float
    max_gap: float

    @classmethod
    def of(cls, layout: Layout, stamps: dict[str, Array], source: str) -> Grid:
        """From the first to the last event of a PV or disturbance. Raises DataError for one that is too long."""
        assert layout.sample_time is not None
        assert layout.max_gap is not None
        unit = unit_seconds(layout.time_unit)
        step, gap = layout.sample_time * unit, layout.max_gap * unit
        own = [stamps[name] for name in layout.continuous if name in stamps]
        first, last = min(float(s[0]) for s in own), max(float(s[-1]) for s in own)
        count = int(np.floor((last - first) / step * (1 + levels.STAMP) + levels.STAMP)) + 1
        if count * len(stamps) > layout.most:
            raise DataError(
                f"{source}: a grid of {step:g} s has {count:,} rows of {len(stamps):,} tags, and {layout.most:,} cells "
                "are the most that are read: take a longer data.sample_time, a shorter stretch, or set data.max_samples"
            )
        return cls(first + step * np.arange(count, dtype=float), step, gap)

    def linear(self, stamps: Array, values: Array) -> Array:
        """values (n,) at increasing stamps (n,) on straight lines between them.

        NaN beside a value that is NaN, before the first and after the last one, and where two are further apart than
        `max_gap`.
        """
        at = self.moments
        before = np.clip(np.searchsorted(stamps, at, side="right") - 1, 0, stamps.size - 1)
        after = np.clip(np.searchsorted(stamps, at, side="left"), 0, stamps.size - 1)
        apart = stamps[after] - stamps[before]
        share = np.divide(at - stamps[before], apart, out=np.zeros(at.size), where=apart > 0)
        # of one and the same event nothing is added, whatever lies beside it
        rise = np.where(apart > 0, values[after] - values[before], 0.0)
        inside = (at >= stamps[0]) & (at <= stamps[-1]) & (apart <= self._reach)
        return np.where(inside, values[before] + share * rise, np.nan)

    def held(self, stamps: Array, limited: bool) -> NDArray[np.int64]:
        """(N,) which of the events each moment takes its value from, -1 for none: the last one.

        Not one that is older than `max_gap` where that is `limited`.
        """
        last = np.searchsorted(stamps, self.moments, side="right") - 1
        if limited:
            last = np.where(self.moments - stamps[np.maximum(last, 0)] <= self._reach, last, -1)
        return last

    def reconstructed(self, stamps: Array) -> BoolArray:
        """(N,) moments without an event within half a step."""
        at = np.clip(np.searchsorted(stamps, self.moments), 1, max(stamps.size - 1, 1))
        near = np.abs(stamps[np.minimum(at, stamps.size - 1)] - self.moments)
        return np.minimum(np.abs(stamps[at - 1] - self.moments), near) > 0.5 * self.step * (1 + levels.STAMP)

    @property
    def _reach(self) -> float:
        return self.max_gap * (1 + levels.STAMP) + levels.STAMP
