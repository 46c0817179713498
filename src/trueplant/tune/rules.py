"""Tuning rules: each gives the PID of one published rule for a reduced model, or for the ultimate gain and period.

Gains bear the sign of the plant, in the signs of u = Q (r - y). Times are in the plant's time unit. alpha is the
ratio of the derivative filter, which the rules leave open. `kind` is "PI" or "PID". LoopError where a rule
does not apply: without dead time most of them have no finite answer.
"""

from __future__ import annotations

import numpy as np

from trueplant.errors import LoopError
from trueplant.loop import PID
from trueplant.tune.levels import ALPHA
from trueplant.tune.reduce import Reduced


def _kind(kind: str) -> bool:
    """True for a PID."""
    if kind not in ("PI", "PID"):
        raise LoopError(f'kind must be "PI" or "PID", not {kind!r}')
    return kind == "PID"


def _delayed(model: Reduced, rule: str, lag: bool = True) -> None:
    if not model.dead_time > 0:
        raise LoopError(
            f"{rule} needs a dead time above 0, this model has none: use simc or imc with a time of your own"
        )
    if lag and not (model.tau1 > 0 and not model.integrating):
        raise LoopError(
            f"{rule} is for a first-order lag with dead time, this model has no such lag: use simc or amigo"
        )


def ziegler_nichols(ku: float, pu: float, kind: str = "PI", alpha: float = ALPHA) -> PID:
    """From the ultimate gain and period (Ziegler and Nichols, Trans. ASME 64, 1942, 759-768)."""
    if _kind(kind):
        return PID(Kc=0.6 * ku, Ti=pu / 2, Td=pu / 8, alpha=alpha)
    return PID(Kc=ku / 2.2, Ti=pu / 1.2)


def tyreus_luyben(ku: float, pu: float, kind: str = "PI", alpha: float = ALPHA) -> PID:
    """Slower and better damped than Ziegler-Nichols (Tyreus and Luyben, Ind. Eng. Chem. Res. 31, 1992, 2625-2628; PID
    as in Luyben and Luyben, Essentials of Process Control, 1997)."""
    if _kind(kind):
        return PID(Kc=ku / 2.2, Ti=2.2 * pu, Td=pu / 6.3, alpha=alpha)
    return PID(Kc=ku / 3.2, Ti=2.2 * pu)


def reaction_curve(model: Reduced, kind: str = "PI", alpha: float = ALPHA) -> PID:
    """Ziegler and Nichols (1942) from the slope and dead time of the step response."""
    _delayed(model, "the reaction curve", lag=False)
    gain, theta = 1 / (model.slope * model.dead_time), model.dead_time
    if _kind(kind):
        return PID(Kc=1.2 * gain, Ti=2 * theta, Td=theta / 2, alpha=alpha)
    return PID(Kc=0.9 * gain, Ti=theta / 0.3)


def cohen_coon(model: Reduced, kind: str = "PI", alpha: float = ALPHA) -> PID:
    """Decay to a quarter with little offset (Cohen and Coon, Trans. ASME 75, 1953, 827-834)."""
    _delayed(model, "Cohen-Coon")
    theta, ratio = model.dead_time, model.dead_time / model.tau1
    gain = 1 / (model.gain * ratio)
    if _kind(kind):
        ti, td = theta * (32 + 6 * ratio) / (13 + 8 * ratio), theta * 4 / (11 + 2 * ratio)
        return PID(Kc=gain * (4 / 3 + ratio / 4), Ti=ti, Td=td, alpha=alpha)
    return PID(Kc=gain * (0.9 + ratio / 12), Ti=theta * (30 + 3 * ratio) / (9 + 20 * ratio))


def _time(given: float | None, default: float, name: str) -> float:
    value = default if given is None else given
    if not value > 0:
        raise LoopError(f"{name} must be above 0: this model has no dead time that could set it, choose it yourself")
    return value


def imc(model: Reduced, filter_time: float | None = None, kind: str = "PI", alpha: float = ALPHA) -> PID:
    """Internal model control (Rivera, Morari and Skogestad, Ind. Eng. Chem. Process Des. Dev. 25, 1986, 252-265).

    PI is the "improved PI" of the source for a first-order lag, PID its first-order Pade rule; with a second lag PID
    cancels both lags; an integrating model follows a ramp (Chien and Fruehauf, Chem. Eng. Prog. 86(10), 1990,
    33-41). filter_time: lambda (the source's epsilon), by default the least that the sources advise: 1.7 dead
    times for PI, 0.8 for PID, but at least a fifth of the lag; sqrt(10) dead times for an integrating model.
    """
    pid, theta, tau = _kind(kind), model.dead_time, model.tau1
    if model.integrating:
        least = _time(filter_time, np.sqrt(10) * theta, "filter_time")
        ti = 2 * least + theta + (model.tau2 if pid else 0.0)
        gain = ti / (model.gain * (least + theta) ** 2)
        td = (2 * least + theta) * model.tau2 / ti if pid else 0.0
        return PID(Kc=gain, Ti=ti, Td=td, alpha=alpha)
    if pid and model.tau2:
        least = _time(filter_time, max(0.8 * theta, 0.2 * tau), "filter_time")
        total = tau + model.tau2
        return PID(Kc=total / (model.gain * (least + theta)), Ti=total, Td=tau * model.tau2 / total, alpha=alpha)
    least = _time(filter_time, max((0.8 if pid else 1.7) * theta, 0.2 * tau), "filter_time")
    ti = tau + theta / 2
    if pid:
        gain = (2 * tau + theta) / (model.gain * (2 * least + theta))
        return PID(Kc=gain, Ti=ti, Td=tau * theta / (2 * tau + theta), alpha=alpha)
    return PID(Kc=ti / (model.gain * least), Ti=ti)


def lambda_tuning(model: Reduced, closed_loop_time: float | None = None) -> PID:
    """PI for a closed loop of first order (Dahlin 1968; Olsen and Bialkowski, Ind. Eng. Chem. Res. 41, 2002).

    closed_loop_time: lambda, by default three times the larger of lag and dead time; for an integrating model three
    dead times, there the time in which a load disturbance is stopped.
    """
    theta = model.dead_time
    if model.integrating:
        speed = _time(closed_loop_time, 3 * (theta + model.tau2), "closed_loop_time")
        return PID(Kc=(2 * speed + theta) / (model.gain * (speed + theta) ** 2), Ti=2 * speed + theta)
    if not model.tau1 > 0:
        raise LoopError("lambda tuning needs a lag: for a pure dead time use simc")
    speed = _time(closed_loop_time, 3 * max(model.tau1, theta), "closed_loop_time")
    return PID(Kc=model.tau1 / (model.gain * (speed + theta)), Ti=model.tau1)


def simc(model: Reduced, tauc: float | None = None, kind: str = "PI", alpha: float = ALPHA) -> PID:
    """Skogestad's rule (J. Process Control 13, 2003, 291-309); a PID is in series form.

    tauc: closed-loop time constant, by default the dead time ("tight"). PID uses the second lag of the model.
    A model without lag gets an integral controller.
    """
    pid, theta = _kind(kind), model.dead_time
    speed = _time(tauc, theta, "tauc") + theta
    if not model.tau1:
        return PID(form="parallel", Kp=0.0, Ki=1 / (model.gain * speed))
    td = model.tau2 if pid else 0.0
    return PID(form="series", Kc=1 / (model.slope * speed), Ti=min(model.tau1, 4 * speed), Td=td, alpha=alpha)


def improved_simc(model: Reduced, tauc: float | None = None, kind: str = "PI", alpha: float = ALPHA) -> PID:
    """SIMC for long dead times: PI with the lag increased by a third of the dead time, PID with that third as
    derivative time, in series form (Skogestad and Grimholt 2012, in PID Control in the Third Millennium; Grimholt
    and Skogestad, J. Process Control 70, 2018, 36-46).

    tauc: by default the dead time, for PID half of it. For first-order and integrating models.
    """
    pid, theta = _kind(kind), model.dead_time
    if model.tau2:
        raise LoopError("the improved SIMC rule is for one lag and dead time: reduce the element to order 1")
    speed = _time(tauc, theta / 2 if pid else theta, "tauc") + theta
    if pid:
        tight = simc(model, speed - theta)
        if tight.form == "parallel":
            # lag 0: integral action with the zero, Kc (1 + 1/(Ti s))(Td s + 1) with Kc/Ti fixed and Ti -> 0
            return PID(form="parallel", Kp=tight.Ki * theta / 3, Ki=tight.Ki)
        return PID(form="series", Kc=tight.Kc, Ti=tight.Ti, Td=theta / 3, alpha=alpha)
    if model.integrating:
        return simc(model, speed - theta)
    longer = Reduced(model.gain, model.tau1 + theta / 3, 0.0, theta)
    return simc(longer, speed - theta)


def amigo(model: Reduced, kind: str = "PI", alpha: float = ALPHA) -> PID:
    """AMIGO (Astrom and Hagglund, Advanced PID Control, 2006, section 7.5; Ms and Mt about 1.4)."""
    _delayed(model, "AMIGO", lag=False)
    pid, theta, tau = _kind(kind), model.dead_time, model.tau1
    if model.integrating:
        gain = 1 / (model.gain * theta)
        if pid:
            return PID(Kc=0.45 * gain, Ti=8 * theta, Td=theta / 2, alpha=alpha)
        return PID(Kc=0.35 * gain, Ti=13.4 * theta)
    if pid:
        ti, td = theta * (0.4 * theta + 0.8 * tau) / (theta + 0.1 * tau), 0.5 * theta * tau / (0.3 * theta + tau)
        return PID(Kc=(0.2 + 0.45 * tau / theta) / model.gain, Ti=ti, Td=td, alpha=alpha)
    gain = 0.15 + (0.35 - theta * tau / (theta + tau) ** 2) * tau / theta
    ti = 0.35 * theta + 13 * theta * tau**2 / (tau**2 + 12 * theta * tau + 7 * theta**2)
    return PID(Kc=gain / model.gain, Ti=ti)


# (a, b) of Kc K = a x^b, tau/Ti = a x^b (set-point: a + b x) and Td/tau = a x^b, with x = dead time/lag
_MINIMUM = {
    ("load", "ISE", "PI"): ((1.305, -0.959), (0.492, -0.739)),
    ("load", "IAE", "PI"): ((0.984, -0.986), (0.608, -0.707)),
    ("load", "ITAE", "PI"): ((0.859, -0.977), (0.674, -0.680)),
    ("load", "ISE", "PID"): ((1.495, -0.945), (1.101, -0.771), (0.560, 1.006)),
    ("load", "IAE", "PID"): ((1.435, -0.921), (0.878, -0.749), (0.482, 1.137)),
    ("load", "ITAE", "PID"): ((1.357, -0.947), (0.842, -0.738), (0.381, 0.995)),
    ("set-point", "IAE", "PI"): ((0.758, -0.861), (1.020, -0.323)),
    ("set-point", "ITAE", "PI"): ((0.586, -0.916), (1.030, -0.165)),
    ("set-point", "IAE", "PID"): ((1.086, -0.869), (0.740, -0.130), (0.348, 0.914)),
    ("set-point", "ITAE", "PID"): ((0.965, -0.850), (0.796, -0.1465), (0.308, 0.929)),
}


def minimum_error(
    model: Reduced, criterion: str = "IAE", step: str = "load", kind: str = "PI", alpha: float = ALPHA
) -> PID:
    """Published correlations of the least integral error, for dead time/lag from 0.1 to 1.

    criterion: "IAE", "ITAE" or "ISE" (load only); step: "load" (Lopez, Miller, Smith and Murrill, Instrum. Technol.
    14(11), 1967, 57-62) or "set-point" (Rovira, Murrill and Smith, Instrum. Control Syst. 42(12), 1969, 67-69).
    Their PID for set-points is not near the optimum of an ideal controller whose derivative acts on the error:
    at x = 0.2 its IAE is a fifth, its ITAE three times larger.

    Raises LoopError outside the range: `optimal` then finds the settings themselves.
    """
    _delayed(model, "the correlation")
    pid, ratio = _kind(kind), model.dead_time / model.tau1
    if (step, criterion, kind) not in _MINIMUM:
        known = ", ".join(f"{c} for {s}" for s, c, k in _MINIMUM if k == kind)
        raise LoopError(f"there is no correlation of {criterion!r} for {step!r}; there are {known}")
    if not 0.1 * (1 - 1e-9) <= ratio <= 1 + 1e-9:
        raise LoopError(
            f"the correlation holds for dead time/lag from 0.1 to 1, here it is {ratio:.3g}: use optimal() instead"
        )
    table = _MINIMUM[step, criterion, kind]
    power = [a * ratio**b for a, b in table]
    if step == "set-point":
        a, b = table[1]
        power[1] = a + b * ratio
    td = power[2] * model.tau1 if pid else 0.0
    return PID(Kc=power[0] / model.gain, Ti=model.tau1 / power[1], Td=td, alpha=alpha)
