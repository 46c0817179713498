"""Settings from where closed-loop poles or the loop's crossover should lie, exactly with dead time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from trueplant.arrays import Array, ComplexArray
from trueplant.errors import LoopError
from trueplant.loop import PID, Controller, unstable_poles
from trueplant.lti import TransferFunction, TransferMatrix
from trueplant.tune import levels
from trueplant.tune.forms import series_ratio
from trueplant.tune.response import axis, frequencies, ultimate


def pole_placement(
    g: TransferFunction, omega: float, zeta: float = levels.DAMPING, third: float | None = None, tf: float = 0.0
) -> PID:
    """PI, or PID with a third pole, that puts closed-loop poles at omega (-zeta +- j sqrt(1 - zeta^2)).

    Solves 1 + G Q = 0 there (Persson and Astrom 1992, dominant pole design): exact also with dead time, which leaves
    infinitely many further poles. third: distance of the real pole of a PID from 0, in rad per time unit; tf: filter
    time of its derivative. Parallel form.

    Raises LoopError if omega or zeta make no sense, or if the loop is unstable because the other poles are.
    """
    if not (omega > 0 and 0 < zeta < 1) or (third is not None and not third > 0):
        raise LoopError("omega and third must be above 0, zeta above 0 and below 1")
    places = [omega * complex(-zeta, np.sqrt(1 - zeta**2))]
    if third is not None:
        places.append(complex(-third))
    s = np.array(places, dtype=np.complex128)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        needed = -1 / g(s)
    terms = [np.ones_like(s), 1 / s] + ([s / (tf * s + 1)] if third is not None else [])
    columns = np.stack(terms, axis=1)
    rows = np.concatenate([columns.real, columns.imag[s.imag != 0]])
    values = np.concatenate([needed.real, needed.imag[s.imag != 0]])
    if not np.all(np.isfinite(rows)) or not np.all(np.isfinite(values)):
        raise LoopError("the plant has a pole or a zero where a closed-loop pole is wanted: choose another place")
    solution = np.linalg.solve(rows, values)
    kp, ki = float(solution[0]), float(solution[1])
    pid = PID(form="parallel", Kp=kp, Ki=ki, Kd=float(solution[2]) if third is not None else 0.0, Tf=tf)
    return _stable(g, pid, f"poles at {omega:g} rad per time unit make other poles unstable: choose slower ones")


def loop_shaping(
    g: TransferFunction,
    phase_margin: float = levels.PHASE_MARGIN,
    crossover: float | None = None,
    kind: str = "PI",
    alpha: float = levels.ALPHA,
) -> PID:
    """PI, or ideal PID, whose loop crosses 1 at `crossover` with that phase margin in degrees.

    The response of the controller there is exp(j (phase margin - 180 deg))/G, exactly (Astrom and Hagglund 1995,
    section 4.3); a PID has the shortest Ti relative to Td with a series form (4 Td without filter). Without a
    crossover (rad per time unit) the one with the largest integral gain is taken, found on the plant's grid of
    frequencies below its first -180 degrees.

    Raises LoopError where such a controller would need gains of different sign, or is unstable.
    """
    if kind not in ("PI", "PID"):
        raise LoopError(f'kind must be "PI" or "PID", not {kind!r}')
    if not 0 < phase_margin < 90:
        raise LoopError(f"the phase margin must be between 0 and 90 degrees, not {phase_margin:g}")
    w = _below_180(g) if crossover is None else np.array([float(crossover)])
    needed = np.exp(1j * (np.radians(phase_margin) - np.pi)) / g(1j * w)
    sign = float(np.sign(g.dc_gain)) or 1.0
    kp, ti = _pid_through(sign * needed, w, alpha) if kind == "PID" else _pi_through(sign * needed, w)
    allowed = np.isfinite(ti) & (kp > 0)
    if not np.any(allowed):
        raise LoopError(
            f"no {kind} gives a phase margin of {phase_margin:g} degrees "
            f"{'at any' if crossover is None else 'at that'} crossover: ask for less phase or a lower crossover"
        )
    k = int(np.argmax(np.where(allowed, kp / ti, -np.inf)))
    td = float(ti[k]) / series_ratio(alpha) if kind == "PID" else 0.0
    pid = PID(Kc=sign * float(kp[k]), Ti=float(ti[k]), Td=td, alpha=alpha)
    return _stable(g, pid, "the loop with that crossover is unstable, it crosses 1 again: choose a lower crossover")


def _below_180(g: TransferFunction) -> Array:
    w = frequencies([g])
    try:
        return w[w < 2 * np.pi / ultimate(g, w)[1]]
    except LoopError as error:
        raise LoopError("no crossover is best where the phase never reaches -180 degrees: give one") from error


def _pi_through(needed: ComplexArray, w: Array) -> tuple[Array, Array]:
    """Kc and Ti (nan where impossible) of the PI whose response at w is `needed`."""
    kp, ki = np.asarray(needed.real, dtype=np.float64), np.asarray(-w * needed.imag, dtype=np.float64)
    return kp, np.where((kp > 0) & (ki > 0), kp / np.where(ki > 0, ki, 1.0), np.nan)


def _pid_through(needed: ComplexArray, w: Array, alpha: float) -> tuple[Array, Array]:
    """The same for a PID with Td = c Ti: the angle of 1 + 1/(j x) + j c x/(1 + j alpha c x) at x = w Ti."""
    x = np.geomspace(1e-3, 1e3, 4000)
    law = _shape(x, alpha)[0]
    # the angle rises from -90 degrees to a maximum; only that branch is used
    top = int(np.argmax(np.angle(law)))
    wanted = np.angle(needed)
    ti = np.interp(wanted, np.angle(law[: top + 1]), x[: top + 1], left=np.nan, right=np.nan) / w
    y = np.where(np.isnan(ti), 1.0, ti * w)
    # two Newton steps remove the error of the interpolation
    for _ in range(2):
        value, slope = _shape(y, alpha)
        y = y + (wanted - np.angle(value)) / np.imag(slope / value)
    value, _ = _shape(y, alpha)
    return np.abs(needed) / np.abs(value), np.where(np.isnan(ti), np.nan, y / w)


def _shape(x: Array, alpha: float) -> tuple[ComplexArray, ComplexArray]:
    c = 1j / series_ratio(alpha)
    lag = 1 + c * alpha * x
    return np.asarray(1 - 1j / x + c * x / lag), np.asarray(1j / x**2 + c / lag**2)


def shaped_like(g: TransferFunction, like: PID, wanted: TransferFunction, crossover: float) -> PID:
    """Gains with which the loop over g is as nearly as possible the one of today's controller over another plant.

    like: today's controller; it has the derivative, its filter and its scan. wanted: the plant that it was tuned on.
    Least squares of g Q - wanted Q_today relative to 1 + wanted Q_today, from a twentieth to three times the crossover
    (rad per time unit). Exact where the two plants differ by a factor. Parallel form.

    Raises LoopError if the loop would be unstable.
    """
    _, _, kd, tf = like.parallel
    w = np.geomspace(*levels.LIKE_TODAY, levels.LIKE_TODAY_POINTS) * crossover
    s = axis(w)
    target = wanted(s) * like.feedback(s)
    bare = replace(like, form="parallel", Kc=None, Ti=None, Td=0.0, alpha=0.1, Kp=0.0, Ki=0.0, Kd=0.0, Tf=tf)
    bare = replace(bare, action=None, gain_unit="engineering")
    parts = [replace(bare, Kp=1.0), replace(bare, Ki=1.0)] + ([replace(bare, Kd=1.0)] if kd else [])
    columns = np.stack([g(s) * part.feedback(s) for part in parts], axis=1) / (1 + target)[:, None]
    aim = target / (1 + target)
    rows, right = (np.concatenate([x.real, x.imag]) for x in (columns, aim))
    gains = np.append(np.linalg.lstsq(rows, right, rcond=None)[0], 0.0)
    pid = replace(bare, Kp=float(gains[0]), Ki=float(gains[1]), Kd=float(gains[2]) if kd else 0.0)
    return _stable(g, pid, "the loop would be unstable with the settings that come nearest to the one of old")


def _stable(g: TransferFunction, pid: PID, message: str) -> PID:
    if unstable_poles(TransferMatrix(((g,),)), Controller.diagonal([pid])):
        raise LoopError(message)
    return pid
