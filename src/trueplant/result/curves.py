"""What is drawn of an analysis, as arrays."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from trueplant.arrays import Array, ComplexArray, IntArray
from trueplant.calendar import Calendar
from trueplant.result.codec import ABSENT
from trueplant.result.element import Interval


@dataclass(frozen=True, eq=False)
class Trend:
    """One experiment for the report; arrays time first."""

    name: str
    t: Array
    r: Array
    y: Array
    u: Array
    model: Array
    """(N, n_y) simulated output of the model, driven by the recorded OP; offset fitted, of a level the slope too."""
    plant: Array
    """(N, n_y) the same for the estimated plant."""
    excluded: tuple[tuple[float, float, str, str], ...]
    """(from, to, signal, reason)."""
    start: str | None = field(default=None, metadata=ABSENT)
    """Time stamp of time 0."""
    time_zone: str | None = field(default=None, metadata=ABSENT)
    thinned_from: int | None = field(default=None, metadata=ABSENT)
    """Samples that there were, where only the extremes are kept."""

    def decimated(self, most: int) -> Trend:
        """At most about so many samples: of each stretch those at which any signal is highest or lowest."""
        if self.t.size <= most:
            return self
        signals = np.hstack([self.r, self.y, self.u, self.model, self.plant])
        kept = np.unique([0, self.t.size - 1, *_extremes(signals, most // (2 * signals.shape[1]))])
        names = ("t", "r", "y", "u", "model", "plant")
        thin = {name: getattr(self, name)[kept] for name in names}
        return replace(self, **thin, thinned_from=self.thinned_from or self.t.size)


@dataclass(frozen=True, eq=False)
class Residuals:
    """Prediction errors of one output, and the tests on them."""

    output: str
    t: Array
    e: Array
    lags: IntArray
    acf: Array
    acf_bound: float
    ccf: Mapping[str, Array]
    """Cross-correlation with each input at `ccf_lags`."""
    ccf_lags: IntArray
    ccf_bound: float
    thinned_from: int | None = field(default=None, metadata=ABSENT)
    """Prediction errors that there were, where only the extremes are kept."""

    def decimated(self, most: int) -> Residuals:
        """At most about so many prediction errors, as `Trend.decimated`."""
        if self.t.size <= most:
            return self
        kept = np.unique([0, self.t.size - 1, *_extremes(self.e[:, None], most // 2)])
        return replace(self, t=self.t[kept], e=self.e[kept], thinned_from=self.thinned_from or self.t.size)


def _extremes(signals: Array, stretches: int) -> list[int]:
    """Samples at which any of the signals (N, m) is highest or lowest in each of so many stretches."""
    edges = np.linspace(0, len(signals), max(stretches, 1) + 1).astype(int)
    found: list[int] = []
    for a, b in pairwise(edges):
        part = signals[a:b][:, np.isfinite(signals[a:b]).any(axis=0)]
        if part.size:
            found += (a + np.nanargmin(part, axis=0)).tolist() + (a + np.nanargmax(part, axis=0)).tolist()
    return found


@dataclass(frozen=True, eq=False)
class MuCurves:
    """Nominal performance, robust stability and robust performance of today's loop over frequency."""

    system: str
    """"model" and "plant" under the declared uncertainty, "estimate" for the plant under that of its parameters."""
    w: Array
    """(n_w,) rad per time unit; the first stands for the limit towards 0."""
    bounds: Mapping[str, Array]
    """By test, "NP", "RS", "RP": (n_w, 2) lower and upper bound."""
    peaks: Mapping[str, Interval]
    """By test: frequency (0 for the limit towards 0) and upper bound."""


@dataclass(frozen=True, eq=False)
class CoherenceCurves:
    """What of each output the set-points (or OP) explain over frequency."""

    w: Array
    multiple: Array
    """(n_w, n_y) between 0 and 1."""
    level: float
    """What noise alone exceeds at a share `significance` of the frequencies."""
    significance: float
    setpoints: bool


@dataclass(frozen=True, eq=False)
class RetuningCurves:
    """One loop before and after retuning, on the plant as estimated, the other loops closed likewise.

    All tables are by "before" and "after"; (n_t, 3): low, value, high over plants drawn from the estimate.
    """

    input: str
    output: str
    method: str
    t: Array
    setpoint: Mapping[str, Array]
    """PV after a unit step of the set-point."""
    load: Mapping[str, Array]
    """PV after a unit step at the plant's input."""
    op_setpoint: Mapping[str, Array]
    op_load: Mapping[str, Array]
    replay_t: Array
    replay: Mapping[str, Array]
    """Control error r - y (n,) under the disturbance recovered from the record; also "record", as it was. Empty where
    no stretch of the record allows it."""


@dataclass(frozen=True, eq=False)
class Curves:
    """What is drawn. Everything here can be recomputed from the data and result.json."""

    outputs: tuple[str, ...]
    inputs: tuple[str, ...]
    output_units: tuple[str, ...]
    input_units: tuple[str, ...]
    time_unit: str
    step_t: Array
    step_model: Array
    """(n_t, n_y, n_u)."""
    step_plant: Array
    step_low: Array
    step_high: Array
    w: Array
    bode_model: ComplexArray
    """(n_w, n_y, n_u); w in rad per time unit."""
    bode_plant: ComplexArray
    bode_std: Array
    """(n_w, n_y, n_u) standard error of |G| relative to |G| (also of the phase, in rad)."""
    band: tuple[tuple[Interval | None, ...], ...]
    """[n_y][n_u]: the frequencies in which the data speak, or None."""
    np_w: Array
    np_value: ComplexArray
    """(n_w2, n_y, n_u) non-parametric estimate; NaN where there is none."""
    np_std: Array
    np_label: str
    trends: tuple[Trend, ...]
    residuals: tuple[Residuals, ...]
    condition_w: Array
    condition: Array
    """Condition number of the set-points' (or inputs') excitation at `condition_w`."""
    mu: tuple[MuCurves, ...] = ()
    retuning: tuple[RetuningCurves, ...] = ()
    coherence: CoherenceCurves | None = None

    def calendar(self, trend: Trend | None) -> Calendar:
        """The times of a trend in words; without one those of several experiments, which are numbers."""
        return Calendar(self.time_unit) if trend is None else Calendar.of(self.time_unit, trend.start, trend.time_zone)

    def points(self, i: int, j: int) -> tuple[ComplexArray, Array]:
        """(n_w2,) non-parametric estimate of one element, its standard error; JSON keeps no shape of what is empty."""
        if not self.np_w.size:
            return np.zeros(0, dtype=complex), np.zeros(0)
        return self.np_value[:, i, j], self.np_std[:, i, j]

    def decimated(self, most: int) -> Curves:
        """With at most about so many samples of each trend and of each output's prediction errors."""
        trends = tuple(trend.decimated(most) for trend in self.trends)
        return replace(self, trends=trends, residuals=tuple(found.decimated(most) for found in self.residuals))
