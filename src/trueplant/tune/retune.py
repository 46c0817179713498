"""All rules by name, applied to one loop in the form and with the scan that its controller has."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from trueplant.errors import LoopError
from trueplant.loop import PID, Controller, unstable_poles
from trueplant.lti import TransferFunction, TransferMatrix
from trueplant.tune import levels, rules
from trueplant.tune.forms import converted
from trueplant.tune.integral import Limits, max_ki
from trueplant.tune.optimal import optimal
from trueplant.tune.reduce import Reduced, reduced
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


_LIMITS = Limits(levels.PEAK, levels.PEAK)


@dataclass(frozen=True)
class Choices:
    """What rules leave open."""

    kind: str = "PI"
    alpha: float = levels.ALPHA
    limits: Limits = _LIMITS
    closed_loop_time: float | None = None
    """tauc or lambda of SIMC, IMC and lambda tuning; None for each rule's own."""


Rule = Callable[[TransferFunction, Choices], PID]


def _ultimate_rule(rule: Callable[[float, float, str, float], PID]) -> Rule:
    return lambda g, c: rule(*ultimate(g), c.kind, c.alpha)


def _first_order(rule: Callable[[Reduced, str, float], PID]) -> Rule:
    return lambda g, c: rule(reduced(g), c.kind, c.alpha)


def _timed(rule: Callable[[Reduced, float | None, str, float], PID], most: int = 2) -> Rule:
    """PID from a model of order `most`, PI from the first order."""
    return lambda g, c: rule(reduced(g, most if c.kind == "PID" else 1), c.closed_loop_time, c.kind, c.alpha)


def _minimum(criterion: str) -> Rule:
    return lambda g, c: rules.minimum_error(reduced(g), criterion, "load", c.kind, c.alpha)


def _optimal(criterion: str) -> Rule:
    return lambda g, c: optimal(g, criterion, "load", c.kind, c.limits, c.alpha)


def _placed(g: TransferFunction, choices: Choices) -> PID:
    """Poles at half the inverse of the effective dead time, damping 0.7, the third at twice that frequency."""
    theta = reduced(g).dead_time
    if not theta > 0:
        raise LoopError("without dead time the poles can lie anywhere: use pole_placement with a frequency of your own")
    if choices.kind == "PID":
        third = 2 * levels.PLACED / theta
        return pole_placement(g, levels.PLACED / theta, levels.DAMPING, third, choices.alpha * theta / 3)
    return pole_placement(g, levels.PLACED / theta, levels.DAMPING)


METHODS: dict[str, Rule] = {
    "ziegler-nichols": _ultimate_rule(rules.ziegler_nichols),
    "tyreus-luyben": _ultimate_rule(rules.tyreus_luyben),
    "reaction-curve": _first_order(rules.reaction_curve),
    "cohen-coon": _first_order(rules.cohen_coon),
    "imc": _timed(rules.imc),
    "lambda": lambda g, c: rules.lambda_tuning(reduced(g), c.closed_loop_time),
    "simc": _timed(rules.simc),
    "improved-simc": _timed(rules.improved_simc, 1),
    "amigo": _first_order(rules.amigo),
    "minimum-iae": _minimum("IAE"),
    "minimum-itae": _minimum("ITAE"),
    "minimum-ise": _minimum("ISE"),
    "optimal-iae": _optimal("IAE"),
    "optimal-itae": _optimal("ITAE"),
    "optimal-ise": _optimal("ISE"),
    "max-ki": lambda g, c: max_ki(g, c.limits, c.kind, c.alpha),
    "pole-placement": _placed,
    "loop-shaping": lambda g, c: loop_shaping(g, levels.PHASE_MARGIN, None, c.kind, c.alpha),
}
"""The rules by name, with their default choices. Lambda tuning always gives a PI."""


def retune(
    g: TransferFunction,
    like: PID,
    methods: Sequence[str] | None = None,
    *,
    kind: str | None = None,
    limits: Limits | None = None,
    closed_loop_time: float | None = None,
) -> tuple[Retuned, ...]:
    """Settings for one loop by several rules, by default all in `METHODS`.

    like: the controller at hand. Its form, derivative filter, scan, limits and the rest are kept, only gains and times
    change; half its scan counts as dead time. kind: "PI" or "PID", by default as `like`. limits on Ms and Mt (1.59
    each by default) and closed_loop_time (tauc, lambda) are for the rules that take them. A rule without an answer
    for this plant, or that leaves it unstable, says so in its note.

    Raises LoopError for unknown names, and for a controller with a pv_transform: linearise it first.
    """
    chosen = list(METHODS) if methods is None else list(methods)
    unknown = [name for name in chosen if name not in METHODS]
    if unknown:
        raise LoopError(f"unknown tuning method {unknown[0]!r}: use {', '.join(METHODS)}")
    if like.pv_transform is not None:
        raise LoopError("a controller with a pv_transform is tuned at one PV: use controller.linearised(pv)")
    _, _, kd, tf = like.parallel
    alpha = (like.alpha if like.form != "parallel" and like.Td else levels.ALPHA) or levels.ALPHA
    if like.form == "parallel" and kd and tf and like.Kp:
        alpha = float(np.clip(tf * abs(like.Kp) / abs(like.Kd), levels.NARROWEST_FILTER, levels.WIDEST_FILTER))
    seen = g * TransferFunction.rational([1.0], [1.0], (like.sample_time or 0.0) / 2)
    choices = Choices(kind or ("PID" if kd else "PI"), alpha, limits or _LIMITS, closed_loop_time)
    return tuple(_one(name, g, seen, like, choices) for name in chosen)


def _one(name: str, g: TransferFunction, seen: TransferFunction, like: PID, choices: Choices) -> Retuned:
    try:
        pid = METHODS[name](seen, choices)
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
