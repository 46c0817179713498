"""Which samples an estimate looks at: real updates of PV, no finer than the lags deserve, in blocks."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from trueplant.arrays import Array
from trueplant.identify import levels
from trueplant.identify.blocks import block_length, most_moved
from trueplant.identify.estimate import estimate_row
from trueplant.identify.row import Row, Spec
from trueplant.record.types import Segment


@dataclass(frozen=True)
class Sampling:
    """Which samples of the records an estimate takes, and how well their instants are known."""

    stride: int = 1
    """Samples from one prediction error to the next (`choose_stride`)."""
    update: int = 1
    """Samples for which PV is held by its instrument or historian (`samples_per_update`)."""
    block: int | None = None
    """Samples of the blocks into which long records are cut (`choose_block`); None: they are not cut."""
    timing: float = 0.0
    """Standard error, in time units, of the instants at which OP acts or PV is read. No fit can see it: it is added to
    that of every dead time."""

    def timing_of(self, segments: Sequence[Segment]) -> Array:
        """(n_columns,) the same of each input, of the measured disturbances their own added."""
        first = segments[0]
        own = np.max([segment.d_timing or (0.0,) * first.d.shape[1] for segment in segments], axis=0)
        timing: Array = np.hypot(self.timing, np.concatenate([np.zeros(first.u.shape[1]), own]))
        return timing


def choose_stride(segments: Sequence[Segment], specs: Sequence[Spec], update_interval: float) -> int:
    """Samples from one prediction error to the next: real updates of PV only, no finer than the lags deserve.

    `specs` are all elements of the matrix: rows that share a stride can be compared.
    """
    h = segments[0].h
    held = samples_per_update(update_interval, h)
    samples = sum(len(segment) for segment in segments)
    wanted = int(min((a for a in _answers(specs) if a > 0), default=0.0) / levels.SAMPLES_PER_LAG / h)
    return held * max(1, min(wanted, samples // levels.ENOUGH_SAMPLES) // held)


def within_dead_times(
    stride: int, segments: Sequence[Segment], update: int, rows: Callable[[int], Sequence[Row]]
) -> int:
    """A stride no longer than the dead times allow that are found with it, in the `rows` at each.

    In closed loop OP acts on what PV does between two samples that are looked at. Its answer may not show in the
    second, or OP would tell what the disturbance did meanwhile.
    """
    while stride > update and any(segment.closed for segment in segments):
        shortest = min((_shortest_dead_time(row) for row in rows(stride)), default=np.inf)
        allowed = update * max(1, int(min(shortest / levels.STRIDES_PER_DEAD_TIME / segments[0].h, stride)) // update)
        if allowed >= stride:
            break
        stride = allowed
    return stride


def choose_block(segments: Sequence[Segment], specs: Sequence[Spec]) -> int:
    """Samples of the blocks into which long records are cut: many times the longest lag of the matrix."""
    return block_length(max(_answers(specs), default=0.0), segments[0].h)


def typical_lag(specs: Sequence[Spec]) -> float | None:
    """Median lag of the elements that the model has; None where it has none with a lag."""
    lags = [s.structure.lag(np.array(s.initial)) for s in specs if s.initial is not None]
    return float(np.median([lag for lag in lags if lag > 0])) if any(lag > 0 for lag in lags) else None


def samples_per_update(update_interval: float, h: float) -> int:
    """For how many samples PV is held, at least 1."""
    return max(1, round(update_interval / h)) if np.isfinite(update_interval) else 1


def _answers(specs: Sequence[Spec]) -> list[float]:
    """How long each element of the model takes to answer, dead time included; without a model as far as is guessed."""
    initial = [(spec.structure, spec.guess if spec.initial is None else spec.initial) for spec in specs]
    known = [(structure, np.array(p)) for structure, p in initial if p is not None]
    return [structure.lag(p) + structure.longest_dead_time(p) for structure, p in known]


def _shortest_dead_time(row: Row) -> float:
    """Of its elements, as they are estimated where the inputs move most."""
    row = replace(row, per_look=1)  # looked for as short as they may be
    theta = estimate_row(most_moved(row), row.guessed_time_scale).theta
    parts = zip(row.specs, row.slices, strict=True)
    return min((float(np.min(spec.structure.dead_times(theta[part]))) for spec, part in parts), default=np.inf)
