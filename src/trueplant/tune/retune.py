"""All rules by name, applied to one loop in the form and with the scan that its controller has."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from trueplant.errors import LoopError
from trueplant.loop import PID, Controller, unstable_poles
from trueplant.lti import TransferFunction, TransferMatrix
from trueplant.tune import rules
from trueplant.tune.forms import converted
from trueplant.tune.integral import Limits, max_ki
from trueplant.tune.optimal import optimal
from trueplant.tune.reduce import reduced
from trueplant.tune.response import ultimate
from trueplant.tune.shaping import loop_shaping, pole_placement


@dataclass(frozen=True)
class Retuned:
    """What one rule says for a loop."""

    method: str
    pid: PID | None
    """In engineering units, signs of u = Q (r - y); None where the rule has no answer."""
    note: str
    """Why there is none, or what is different from the controller at hand; else empty."""


Rule = Callable[[TransferFunction, str, float, Limits], PID]


def _ultimate_rule(rule: Callable[[float, float, str, float], PID]) -> Rule:
    return lambda g, kind, alpha, limits: rule(*ultimate(g), kind, alpha)


def _minimum(criterion: str) -> Rule:
    return lambda g, kind, alpha, limits: rules.minimum_error(reduced(g), criterion, "load", kind, alpha)


def _optimal(criterion: str) -> Rule:
    return lambda g, kind, alpha, limits: optimal(g, criterion, "load", kind, limits, alpha)


def _placed(g: TransferFunction, kind: str, alpha: float, limits: Limits) -> PID:
    """Poles at half the inverse of the effective dead time, damping 0.7, the third at twice that frequency."""
    theta = reduced(g).dead_time
    if not theta > 0:
        raise LoopError("without dead time the poles can lie anywhere: use pole_placement with a frequency of your own")
    if kind == "PID":
        return pole_placement(g, 0.5 / theta, 0.7, 1 / theta, alpha * theta / 3)
    return pole_placement(g, 0.5 / theta, 0.7)


METHODS: dict[str, Rule] = {
    "ziegler-nichols": _ultimate_rule(rules.ziegler_nichols),
    "tyreus-luyben": _ultimate_rule(rules.tyreus_luyben),
    "reaction-curve": lambda g, kind, alpha, limits: rules.reaction_curve(reduced(g), kind, alpha),
    "cohen-coon": lambda g, kind, alpha, limits: rules.cohen_coon(reduced(g), kind, alpha),
    "imc": lambda g, kind, alpha, limits: rules.imc(reduced(g, _order(kind)), None, kind, alpha),
    "lambda": lambda g, kind, alpha, limits: rules.lambda_tuning(reduced(g)),
    "simc": lambda g, kind, alpha, limits: rules.simc(reduced(g, _order(kind)), None, kind, alpha),
    "improved-simc": lambda g, kind, alpha, limits: rules.improved_simc(reduced(g), None, kind, alpha),
    "amigo": lambda g, kind, alpha, limits: rules.amigo(reduced(g), kind, alpha),
    "minimum-iae": _minimum("IAE"),
    "minimum-itae": _minimum("ITAE"),
    "minimum-ise": _minimum("ISE"),
    "optimal-iae": _optimal("IAE"),
    "optimal-itae": _optimal("ITAE"),
    "max-ki": lambda g, kind, alpha, limits: max_ki(g, limits, kind, alpha),
    "pole-placement": _placed,
    "loop-shaping": lambda g, kind, alpha, limits: loop_shaping(g, 60.0, None, kind, alpha),
}
"""The rules by name, with their default choices. Lambda tuning always gives a PI."""


def _order(kind: str) -> int:
    return 2 if kind == "PID" else 1


def retune(
    g: TransferFunction,
    like: PID,
    methods: Sequence[str] | None = None,
    *,
    kind: str | None = None,
    limits: Limits | None = None,
) -> tuple[Retuned, ...]:
    """Settings for one loop by several rules, by default all in `METHODS`.

    like: the controller at hand. Its form, derivative filter, scan, limits and the rest are kept, only gains and times
    change; half its scan counts as dead time. kind: "PI" or "PID", by default as `like`. limits on Ms and Mt (1.59
    each by default) are for the rules that take them. A rule without an answer for this plant, or that leaves it
    unstable, says so in its note.

    Raises LoopError for unknown names, and for a controller with a pv_transform: linearise it first.
    """
    chosen = list(METHODS) if methods is None else list(methods)
    unknown = [name for name in chosen if name not in METHODS]
    if unknown:
        raise LoopError(f"unknown tuning method {unknown[0]!r}: use {', '.join(METHODS)}")
    if like.pv_transform is not None:
        raise LoopError("a controller with a pv_transform is tuned at one PV: use controller.linearised(pv)")
    _, _, kd, tf = like.parallel
    alpha = (like.alpha if like.form != "parallel" and like.Td else 0.1) or 0.1
    if like.form == "parallel" and kd and tf and like.Kp:
        alpha = float(np.clip(tf * abs(like.Kp) / abs(like.Kd), 0.01, 1.0))
    seen = g * TransferFunction.rational([1.0], [1.0], (like.sample_time or 0.0) / 2)
    wanted, bounds = kind or ("PID" if kd else "PI"), limits or Limits(1.59, 1.59)
    return tuple(_one(name, g, seen, like, wanted, alpha, bounds) for name in chosen)


def _one(
    name: str, g: TransferFunction, seen: TransferFunction, like: PID, kind: str, alpha: float, limits: Limits
) -> Retuned:
    try:
        pid = METHODS[name](seen, kind, alpha, limits)
    except LoopError as error:
        return Retuned(name, None, str(error))
    note = ""
    try:
        pid = converted(pid, like.form)
    except LoopError:
        note = f'in the form "{pid.form}": there is no equivalent in the form "{like.form}"'
    settings = {key: getattr(pid, key) for key in ("form", "Kc", "Ti", "Td", "alpha", "Kp", "Ki", "Kd", "Tf")}
    pid = replace(like, **settings, action=None, gain_unit="engineering")
    if unstable_poles(TransferMatrix(((g,),)), Controller.diagonal([pid])):
        return Retuned(name, None, "the loop would be unstable with these settings")
    return Retuned(name, pid, note)
