"""A measured step response: step coefficients or an impulse response (FIR), as model predictive controllers keep them.

An element y(t) after a unit step of its input at t = 0, known at 0, h, 2 h, ..., n h. After that it stays, or, where it
integrates, goes on with the slope of its last tenth. Between two coefficients it is a straight line.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from trueplant.arrays import Array, ComplexArray
from trueplant.errors import FormulaError
from trueplant.lti import levels
from trueplant.lti.sampled import sampled_response
from trueplant.lti.transfer import TransferFunction

Kind = Literal["step", "fir"]


@dataclass(frozen=True, eq=False)
class MeasuredStep:
    """One element as the response to a unit step. Raises FormulaError for values that are no response."""

    values: Array
    """(n + 1,) at 0, h, ..., n h, in output units per input unit; the first is what answers at once, mostly 0."""
    sample_time: float
    """h."""
    integrating: bool = False
    """The slope of the last tenth continues."""

    def __post_init__(self) -> None:
        values = np.array(self.values, dtype=float)
        if values.ndim != 1 or values.size < 2:
            raise FormulaError("a step response needs its values as one list of at least two numbers")
        bad = np.flatnonzero(~np.isfinite(values))
        if bad.size:
            raise FormulaError(f"coefficient {bad[0]} of the step response is no finite number: correct it")
        if not (np.isfinite(self.sample_time) and self.sample_time > 0):
            raise FormulaError(f"the sample time of a step response must be above 0, not {self.sample_time:g}")
        values.flags.writeable = False
        object.__setattr__(self, "values", values)

    @classmethod
    def of(
        cls, coefficients: ArrayLike, sample_time: float, kind: Kind = "step", integrating: bool = False
    ) -> MeasuredStep:
        """From coefficients (n,) at h, 2 h, ..., n h: of the step response, or of the impulse response ("fir")."""
        given = np.asarray(coefficients, dtype=float)
        after = np.cumsum(given) if kind == "fir" else given
        return cls(np.concatenate([[0.0], after]), sample_time, integrating)

    @classmethod
    def of_system(cls, system: TransferFunction, sample_time: float, count: int) -> MeasuredStep:
        """The first `count` coefficients of a transfer function, exact; it integrates where its gain is infinite.

        Raises FormulaError for an improper system.
        """
        values = sampled_response(system, np.ones(count + 1), sample_time)
        return cls(values, sample_time, bool(np.isinf(system.dc_gain)))

    @property
    def fir(self) -> Array:
        """(n + 1,) coefficients of the held input of 0, 1, ..., n samples ago: y[k] = sum fir[i] u[k - i]."""
        return np.asarray(np.diff(self.values, prepend=0.0), dtype=float)

    @property
    def t(self) -> Array:
        """(n + 1,) instants of the values."""
        return np.asarray(np.arange(self.values.size) * self.sample_time, dtype=float)

    @property
    def size(self) -> float:
        """What errors are a share of: the largest value, which is the gain unless the response overshoots."""
        return float(np.max(np.abs(self.values)))

    @property
    def slope(self) -> float:
        """Per time unit, after the last coefficient: that of the last tenth, as single differences are mostly noise."""
        if not self.integrating:
            return 0.0
        return float(self.values[-1] - self.values[-1 - self._tenth]) / (self._tenth * self.sample_time)

    @property
    def _tenth(self) -> int:
        return max(self.values.size // 10, 1)

    @property
    def settled(self) -> bool:
        """Whether the end is at rest: its last tenth lies where the tenth before does."""
        return self._end[0] <= levels.UNSETTLED * self.size

    @property
    def settled_is_unclear(self) -> bool:
        """Whether noise of the coefficients could make `settled` what it is."""
        change, scatter = self._end
        return abs(change - levels.UNSETTLED * self.size) <= levels.END_SCATTER * scatter

    @property
    def _end(self) -> tuple[float, float]:
        """How far apart the last two tenths lie, and how the values there scatter around a straight line."""
        tail = self.values[-2 * self._tenth :]
        before, last = np.split(tail, 2)
        line = np.polynomial.Polynomial.fit(np.arange(tail.size), tail, 1)
        return float(abs(last.mean() - before.mean())), float(np.std(tail - line(np.arange(tail.size))))

    def __call__(self, t: ArrayLike) -> Array:
        """The response at any time t, of the shape of t: straight lines between the coefficients."""
        at = np.asarray(t, dtype=float)
        inside = np.interp(at, self.t, self.values)
        return np.where(at < 0, 0.0, inside + self.slope * np.maximum(at - self.t[-1], 0.0))

    def sampled_frequency_response(self, w: ArrayLike) -> ComplexArray:
        """(n_w,) between samples h apart of a held input and of the output, exact; w in rad per time unit.

        What integrates is infinite at w = 0: begin above it.
        """
        z = np.exp(-1j * np.asarray(w, dtype=float) * self.sample_time)
        value = np.polyval(self.fir[::-1], z)
        if self.integrating:
            value = value + self.slope * self.sample_time * z**self.values.size / (1 - z)
        return np.asarray(value, dtype=complex)

    def frequency_response(self, w: ArrayLike) -> ComplexArray:
        """(n_w,) of the response with straight lines between its coefficients, at w (n_w,) above 0.

        It says nothing beyond pi/h, where it is NaN.
        """
        w = np.asarray(w, dtype=float)
        x = w * self.sample_time
        z = np.exp(-1j * x)
        after = self.sampled_frequency_response(w) - self.values[0]
        value = self.values[0] + after * (1 - z) / (1j * x * z)
        return np.asarray(np.where(x <= np.pi, value, np.nan), dtype=complex)

    def __mul__(self, factor: float) -> MeasuredStep:
        return replace(self, values=self.values * factor)

    __rmul__ = __mul__


def largest_difference(measured: MeasuredStep, system: TransferFunction) -> tuple[float, float]:
    """Of the step responses as a share of the measured one's `size`, and the time at which it is reached.

    At the coefficients and, where they come to rest, of the gains (at the last coefficient). Raises FormulaError for an
    improper system.
    """
    apart = np.abs(measured.values - sampled_response(system, np.ones(measured.values.size), measured.sample_time))
    if not measured.integrating:
        apart[-1] = max(apart[-1], abs(measured.values[-1] - system.dc_gain))
    worst = int(np.argmax(apart))
    if apart[worst] <= levels.ROUNDING * measured.size:
        return 0.0, 0.0
    return float(apart[worst] / measured.size) if measured.size else np.inf, float(measured.t[worst])
