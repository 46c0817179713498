"""One entry of a controller: a PID in the forms that vendors use, or any transfer function.

Every PID is reduced to the parallel form ``Kp + Ki/s + Kd s/(Tf s + 1)`` in engineering units with the
signs of ``u = Q (r - y)``; all else in this room works with that.

A sampled entry (``sample_time`` h) is its continuous law with s replaced by ``(1 - z^-1)/h``: integral
by backward Euler with the present error, filtered derivative by backward difference. The simulator
runs that recursion and the frequency functions evaluate it, so both agree to rounding.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from trueplant.arrays import Array, ComplexArray
from trueplant.errors import LoopError
from trueplant.lti.transfer import TransferFunction

PvTransform = Callable[[ArrayLike], Array]
Limits = tuple[float, float]

_IDEAL_KEYS = ("Kc", "Ti", "Td")
_PARALLEL_KEYS = ("Kp", "Ki", "Kd", "Tf")


def backward_difference(s: ArrayLike, h: float) -> ComplexArray:
    """``(1 - e^(-s h))/h``, what s becomes in a law sampled at h."""
    z = np.asarray(s, dtype=np.complex128)
    return np.asarray(-np.expm1(-z * h) / h, dtype=np.complex128)


def hold(s: ArrayLike, h: float) -> ComplexArray:
    """``(1 - e^(-s h))/(s h)``: the zero-order hold over h relative to one sample."""
    z = np.asarray(s, dtype=np.complex128) * h
    safe = np.where(z == 0, 1.0, z)
    value: ComplexArray = np.where(z == 0, 1.0, -np.expm1(-safe) / safe)
    return value


def _checked_sampling(sample_time: float | None, limits: Limits | None) -> None:
    if sample_time is not None and not (np.isfinite(sample_time) and sample_time > 0):
        raise LoopError(f"sample_time must be above 0, not {sample_time:g}; leave it out for a continuous controller")
    if limits is not None and not limits[0] < limits[1]:
        raise LoopError(f"limits must be (low, high) with low below high, not {limits}")


@dataclass(frozen=True)
class PID:
    """A PID controller from one PV to one OP.

    Forms: "ideal" ``Kc (1 + 1/(Ti s) + Td s/(alpha Td s + 1))``; "series"
    ``Kc (1 + 1/(Ti s)) (Td s + 1)/(alpha Td s + 1)``; "parallel" ``Kp + Ki/s + Kd s/(Tf s + 1)``.
    Ti of None, 0 or infinity means no integral action. Times are in the time unit of the plant.

    action: "direct" multiplies all gains by -1, "reverse" and None leave the signs of u = Q (r - y).
    gain_unit: "engineering" (OP unit per PV unit) or "percent of span" with op_span and pv_span.
    setpoint_weight acts on the P of the parallel form, setpoint_filter on the set-point as a whole,
    derivative_on "pv" leaves the set-point out of D.
    limits: of OP, in its own units. anti_windup "clamp" keeps the integral term itself (which carries
    the operating point of OP) within them; "back-calculation" lets it track the limited OP with the time
    constant Ti, or sqrt(Ti Td) with derivative action (Astrom and Hagglund 1995, section 3.5).
    pv_transform: the controller acts on transform(set-point) - transform(pv).

    Raises LoopError for settings that contradict each other.
    """

    form: str = "ideal"
    Kc: float | None = None
    Ti: float | None = None
    Td: float = 0.0
    alpha: float = 0.1
    Kp: float | None = None
    Ki: float = 0.0
    Kd: float = 0.0
    Tf: float = 0.0
    action: str | None = None
    gain_unit: str = "engineering"
    op_span: float | None = None
    pv_span: float | None = None
    setpoint_weight: float = 1.0
    setpoint_filter: TransferFunction | None = None
    derivative_on: str = "error"
    sample_time: float | None = None
    anti_windup: str = "none"
    limits: Limits | None = None
    pv_transform: PvTransform | None = None

    def __post_init__(self) -> None:
        choices = {
            "form": ("ideal", "series", "parallel"),
            "action": (None, "reverse", "direct"),
            "gain_unit": ("engineering", "percent of span"),
            "derivative_on": ("error", "pv"),
            "anti_windup": ("none", "clamp", "back-calculation"),
        }
        for key, allowed in choices.items():
            if getattr(self, key) not in allowed:
                names = ", ".join(repr(a) for a in allowed if a is not None)
                raise LoopError(f"{key} must be one of {names}, not {getattr(self, key)!r}")
        own, foreign = (_PARALLEL_KEYS, _IDEAL_KEYS) if self.form == "parallel" else (_IDEAL_KEYS, _PARALLEL_KEYS)
        strangers = [key for key in foreign if getattr(self, key)]
        if strangers:
            raise LoopError(f'form "{self.form}" uses {", ".join(own)}: remove {", ".join(strangers)} or change form')
        if (self.Kp if self.form == "parallel" else self.Kc) is None:
            raise LoopError(f'form "{self.form}" needs {own[0]}')
        for key in (*own, "alpha", "setpoint_weight"):
            value = getattr(self, key)
            if value is not None and not np.isfinite(value) and not (key == "Ti" and value == np.inf):
                raise LoopError(f"{key} must be a finite number, not {value}")
        negative = [key for key in ("Ti", "Td", "alpha", "Tf") if (getattr(self, key) or 0.0) < 0]
        if negative:
            raise LoopError(f"{negative[0]} is a time or a ratio and cannot be negative; give the sign to the gain")
        if self.gain_unit == "percent of span" and not ((self.op_span or 0) > 0 and (self.pv_span or 0) > 0):
            raise LoopError(
                'gain_unit "percent of span" needs op_span and pv_span above 0: give the limits of OP and PV'
            )
        if self.anti_windup != "none" and self.limits is None:
            raise LoopError(f'anti_windup "{self.anti_windup}" needs limits of OP')
        _checked_sampling(self.sample_time, self.limits)

    @property
    def parallel(self) -> tuple[float, float, float, float]:
        """(Kp, Ki, Kd, Tf) in engineering units, signs of u = Q (r - y)."""
        factor = -1.0 if self.action == "direct" else 1.0
        if self.gain_unit == "percent of span":
            factor *= (self.op_span or 0.0) / (self.pv_span or 1.0)
        if self.form == "parallel":
            return factor * (self.Kp or 0.0), factor * self.Ki, factor * self.Kd, self.Tf
        gain = factor * (self.Kc or 0.0)
        ki = gain / self.Ti if self.Ti else 0.0
        lag = self.alpha * self.Td
        if self.form == "ideal":
            return gain, ki, gain * self.Td, lag
        # partial fractions of Kc (1 + 1/(Ti s)) (Td s + 1)/(lag s + 1)
        kp = gain + ki * (self.Td - lag)
        return kp, ki, gain * self.Td - kp * lag, lag

    @property
    def tracking_time(self) -> float:
        """Time constant of back-calculation: |Kp/Ki|, or the geometric mean with |Kd/Kp| if there is a D."""
        kp, ki, kd, _ = self.parallel
        if ki == 0:
            return np.inf
        ti = abs(kp / ki) or 1.0
        return float(np.sqrt(ti * abs(kd / kp))) if kd and kp else ti

    @property
    def sign(self) -> float:
        """Sign of the gain that counts at low frequency."""
        kp, ki, kd, _ = self.parallel
        return float(np.sign(ki or kp or kd))

    @property
    def one_degree(self) -> bool:
        """True if the law acts on r - y alone."""
        kp, _, kd, _ = self.parallel
        return (
            (self.setpoint_weight == 1 or kp == 0)
            and self.setpoint_filter is None
            and (self.derivative_on == "error" or kd == 0)
        )

    def feedback(self, s: ComplexArray) -> ComplexArray:
        """Q(s), the law from -y; for a sampled entry with its hold."""
        h = self.sample_time
        if h is None:
            return self._law(s, 1.0, 1.0)
        return self._law(backward_difference(s, h), 1.0, 1.0) * hold(s, h)

    def reference(self, s: ComplexArray) -> ComplexArray:
        """Law from the set-point; for a sampled entry from the transform of the held set-point."""
        sd = s if self.sample_time is None else backward_difference(s, self.sample_time)
        value = self._law(sd, self.setpoint_weight, 1.0 if self.derivative_on == "error" else 0.0)
        return value if self.setpoint_filter is None else value * self.setpoint_filter(sd)

    def _law(self, s: ComplexArray, on_p: float, on_d: float) -> ComplexArray:
        kp, ki, kd, tf = self.parallel
        value = np.full(s.shape, on_p * kp, dtype=complex)
        with np.errstate(divide="ignore", invalid="ignore"):
            if ki:
                value = value + ki / s
            if kd and on_d:
                value = value + on_d * kd * s / (tf * s + 1)
        return value

    def linearised(self, pv: float) -> PID:
        """The law for small changes about a PV: its gains times the slope of pv_transform there."""
        if self.pv_transform is None:
            return self
        step = 1e-5 * max(abs(pv), 1.0)
        ends = np.asarray(self.pv_transform(np.array([pv - step, pv + step])))
        slope = float((ends[1] - ends[0]) / (2 * step))
        if not np.isfinite(slope) or slope == 0:
            raise LoopError(f"pv_transform has no finite slope other than 0 at a PV of {pv:g}: check the transform")
        kp, ki, kd, tf = self.parallel
        return replace(
            self,
            form="parallel",
            Kc=None,
            Ti=None,
            Td=0.0,
            Kp=kp * slope,
            Ki=ki * slope,
            Kd=kd * slope,
            Tf=tf,
            action=None,
            gain_unit="engineering",
            pv_transform=None,
        )


@dataclass(frozen=True)
class Linear:
    """Any other law u = Q (r - y), given as a transfer function; sampled as a PID is if it has a scan."""

    tf: TransferFunction
    sample_time: float | None = None
    limits: Limits | None = None

    def __post_init__(self) -> None:
        _checked_sampling(self.sample_time, self.limits)

    @property
    def sign(self) -> float:
        """Sign of the gain that counts at low frequency."""
        return float(np.sign(self.tf.dc_gain))

    @property
    def one_degree(self) -> bool:
        """Always: the law acts on r - y alone."""
        return True

    def feedback(self, s: ComplexArray) -> ComplexArray:
        """Q(s), the law from -y; for a sampled entry with its hold."""
        value = self.reference(s)
        return value if self.sample_time is None else value * hold(s, self.sample_time)

    def reference(self, s: ComplexArray) -> ComplexArray:
        """Law from the set-point; for a sampled entry from the transform of the held set-point."""
        if self.sample_time is None:
            return self.tf(s)
        sd = backward_difference(s, self.sample_time)
        total = np.zeros(s.shape, dtype=complex)
        with np.errstate(divide="ignore", invalid="ignore"):
            for term in self.tf.terms:
                total = total + np.polyval(term.num, sd) / np.polyval(term.den, sd) * np.exp(-term.dead_time * s)
        return total


Entry = PID | Linear
