"""A controller's parameters as its vendor shows them, to and from the laws of `loop.PID`.

All conversions are exact, the derivative filter included: two settings are equivalent only if they are the
same transfer function. Where the other form has none, LoopError says so.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from trueplant.errors import LoopError
from trueplant.loop import PID
from trueplant.tune import levels

SECONDS = {"ms": 1e-3, "s": 1.0, "min": 60.0, "h": 3600.0, "d": 86400.0}


def converted(pid: PID, form: str) -> PID:
    """The same law in the form "ideal", "series" or "parallel", in engineering units and without action.

    All that is not a gain or a time (set-point weight, limits, scan, ...) is kept. A series controller is
    given with Ti >= Td. Raises LoopError where the form cannot express the law: ideal needs gains of one
    sign, series a law with real zeros (for an unfiltered ideal controller Ti >= 4 Td).
    """
    kp, ki, kd, tf = pid.parallel
    same = replace(pid, form="parallel", Kc=None, Ti=None, Td=0.0, alpha=0.1, Kp=kp, Ki=ki, Kd=kd, Tf=tf)
    same = replace(same, action=None, gain_unit="engineering")
    if form == "parallel":
        return same
    if form == "ideal":
        gain, ti, td = _ideal(kp, ki, kd)
    elif form == "series":
        gain, ti, td = _series(kp, ki, kd, tf)
    else:
        raise LoopError(f'form must be one of "ideal", "series", "parallel", not {form!r}')
    alpha = tf / td if td else 0.1
    return replace(same, form=form, Kp=None, Ki=0.0, Kd=0.0, Tf=0.0, Kc=gain, Ti=ti, Td=td, alpha=alpha)


def series_ratio(alpha: float) -> float:
    """Smallest Ti/Td of an ideal controller with a series form: 4 without filter, 4.2 with alpha 0.1."""
    return float(2 + alpha + 2 * np.sqrt(1 + alpha))


def _ideal(kp: float, ki: float, kd: float) -> tuple[float, float | None, float]:
    if kp == 0 and (ki or kd):
        raise LoopError("a law without P has no ideal form: keep it parallel")
    if kp * ki < 0 or kp * kd < 0:
        raise LoopError("gains of different sign have no ideal form (its times would be negative): keep it parallel")
    return kp, kp / ki if ki else None, kd / kp if kd else 0.0


def _series(kp: float, ki: float, kd: float, tf: float) -> tuple[float, float | None, float]:
    if kd == 0:
        return _ideal(kp, ki, kd)
    if ki == 0:
        td = tf + kd / kp if kp else 0.0
        if td <= 0:
            raise LoopError("this PD law has no zero in the left half-plane, so no series form: keep it parallel")
        return kp, None, td
    # Kp + Ki/s + Kd s/(Tf s + 1) = Ki (Ti s + 1)(Td s + 1)/(s (Tf s + 1)): sum and product of Ti and Td
    total, product = kp / ki + tf, (kp * tf + kd) / ki
    spread = (total / 2) ** 2 - product
    if spread < -levels.DOUBLE_ROOT * abs(product) or product <= 0 or total <= 0:
        raise LoopError(
            "this law has no series form, its zeros are not real and negative (an unfiltered ideal controller needs "
            "Ti >= 4 Td): lengthen Ti, shorten Td, or keep the form"
        )
    ti = total / 2 + np.sqrt(max(spread, 0.0))
    return float(ki * ti), float(ti), float(product / ti)


@dataclass(frozen=True)
class Notation:
    """How a controller shows its parameters.

    form: as in `loop.PID`. gain: "gain", or "proportional band" in % (100/gain, which needs gains in percent of
    span). integral: "time" (reset time) or "repeats" (repeats per time unit); a parallel form shows the gains Ki
    and Kd per time unit instead. derivative_filter: "ratio" (alpha), "divisor" (N = 1/alpha) or "time" (alpha Td,
    Tf). time_unit: of all these times. shows_action: gains are positive and the action gives their sign
    (reverse is the positive gain of u = Q (r - y)); otherwise gains bear it.

    Raises LoopError for choices that contradict each other.
    """

    form: str = "ideal"
    gain: str = "gain"
    integral: str = "time"
    derivative_filter: str = "ratio"
    time_unit: str = "min"
    shows_action: bool = True
    gain_unit: str = "engineering"
    op_span: float | None = None
    pv_span: float | None = None

    def __post_init__(self) -> None:
        choices = {
            "form": ("ideal", "series", "parallel"),
            "gain": ("gain", "proportional band"),
            "integral": ("time", "repeats"),
            "derivative_filter": ("ratio", "divisor", "time"),
            "time_unit": tuple(SECONDS),
            "gain_unit": ("engineering", "percent of span"),
        }
        for key, allowed in choices.items():
            if getattr(self, key) not in allowed:
                names = ", ".join(map(repr, allowed))
                raise LoopError(f"{key} must be one of {names}, not {getattr(self, key)!r}")
        if self.gain_unit == "percent of span" and not ((self.op_span or 0) > 0 and (self.pv_span or 0) > 0):
            raise LoopError('gain_unit "percent of span" needs op_span and pv_span above 0')
        if self.gain == "proportional band" and self.gain_unit == "engineering":
            raise LoopError('a proportional band is in percent of span: set gain_unit = "percent of span", spans')
        if self.form == "parallel" and self.derivative_filter != "time":
            raise LoopError('the filter of a parallel form is a time: set derivative_filter = "time"')

    @property
    def span_ratio(self) -> float:
        """Engineering gain of a shown gain of 1."""
        return 1.0 if self.gain_unit == "engineering" else (self.op_span or 0.0) / (self.pv_span or 1.0)


@dataclass(frozen=True)
class Settings:
    """The numbers that one writes into the controller.

    gain: gain or proportional band. integral: None for no integral action, else the time, the repeats or Ki.
    derivative: time or Kd. derivative_filter: ratio, divisor or time; None without derivative action, and
    for the divisor of an unfiltered one. action: "reverse", "direct", or None where gains bear the sign.
    """

    gain: float
    integral: float | None
    derivative: float
    derivative_filter: float | None
    action: str | None


def settings_of(pid: PID, notation: Notation, time_unit: str) -> Settings:
    """A law, its times in `time_unit`, in the vendor's notation. Raises LoopError where there is no equivalent."""
    own = converted(pid, notation.form)
    scale = _seconds(time_unit) / SECONDS[notation.time_unit]
    sign = own.sign if notation.shows_action else 1.0
    action = ("direct" if sign < 0 else "reverse") if notation.shows_action else None
    factor = (sign or 1.0) / notation.span_ratio
    if own.form == "parallel":
        # Ki is a gain per time, Kd a gain times a time
        integral = factor * own.Ki / scale if own.Ki else None
        derivative, filtering = factor * own.Kd * scale, own.Tf * scale
    else:
        integral = own.Ti * scale if own.Ti else None
        if integral and notation.integral == "repeats":
            integral = 1 / integral
        derivative, filtering = own.Td * scale, own.alpha
        if notation.derivative_filter == "time":
            filtering = own.alpha * derivative
    shown: float | None = filtering
    if not derivative:
        shown = None
    elif notation.derivative_filter == "divisor":
        shown = 1 / filtering if filtering else None
    gain = factor * ((own.Kp if own.form == "parallel" else own.Kc) or 0.0)
    if notation.gain == "proportional band":
        if gain == 0:
            raise LoopError("a gain of 0 has no proportional band")
        gain = 100 / gain
    return Settings(gain, integral, derivative, shown, action)


def pid_of(settings: Settings, notation: Notation, time_unit: str, like: PID | None = None) -> PID:
    """The law of a vendor's settings, its times in `time_unit`, in engineering units; the rest as in `like`.

    Raises LoopError for settings that have no meaning in the notation.
    """
    if (settings.action is not None) != notation.shows_action or settings.action not in (None, "reverse", "direct"):
        wanted = '"reverse" or "direct"' if notation.shows_action else "None"
        raise LoopError(f"action must be {wanted} in this notation, not {settings.action!r}")
    if notation.gain == "proportional band" and settings.gain == 0:
        raise LoopError("a proportional band of 0 has no meaning: give the band in percent")
    scale = SECONDS[notation.time_unit] / _seconds(time_unit)
    factor = notation.span_ratio * (-1.0 if settings.action == "direct" else 1.0)
    gain = factor * (100 / settings.gain if notation.gain == "proportional band" else settings.gain)
    filtering, derivative = settings.derivative_filter or 0.0, settings.derivative * scale
    rest = like or PID(Kc=1.0)
    blank = replace(rest, form="parallel", Kc=None, Ti=None, Td=0.0, alpha=0.1, Kp=0.0, Ki=0.0, Kd=0.0, Tf=0.0)
    blank = replace(blank, action=None, gain_unit="engineering")
    if notation.form == "parallel":
        ki = factor * (settings.integral or 0.0) / scale
        tf = filtering * scale if settings.derivative else 0.0
        return replace(blank, Kp=gain, Ki=ki, Kd=factor * derivative, Tf=tf)
    if settings.integral is not None and settings.integral <= 0:
        raise LoopError("the integral setting must be above 0, or None for no integral action")
    ti = settings.integral
    if ti is not None:
        ti = (1 / ti if notation.integral == "repeats" else ti) * scale
    alpha = 0.1
    if settings.derivative:
        ways = {"ratio": filtering, "divisor": 1 / filtering if filtering else 0.0}
        alpha = ways.get(notation.derivative_filter, filtering / settings.derivative)
    return replace(blank, form=notation.form, Kp=None, Kc=gain, Ti=ti, Td=derivative, alpha=alpha)


def _seconds(time_unit: str) -> float:
    if time_unit not in SECONDS:
        raise LoopError(f"time_unit must be one of {', '.join(map(repr, SECONDS))}, not {time_unit!r}")
    return SECONDS[time_unit]
