"""Every tuning rule by name, in one table: another rule is a function in a file of its own and a line here.

A rule takes the plant element (a `TransferFunction`, half the controller's scan already counted as dead time) and the
`Choices` that rules leave open, and gives a `PID` in engineering units, signed for u = Q (r - y). It raises LoopError,
with a reason that a user understands, where it does not apply; `retune` does the rest: stability, the controller's own
form, its scan and limits.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from trueplant.errors import LoopError
from trueplant.loop import PID
from trueplant.lti import TransferFunction
from trueplant.tune import levels, rules
from trueplant.tune.integral import Limits, max_ki
from trueplant.tune.optimal import optimal
from trueplant.tune.reduce import Reduced, reduced
from trueplant.tune.response import ultimate
from trueplant.tune.shaping import loop_shaping, pole_placement

LIMITS = Limits(levels.PEAK, levels.PEAK)
"""Of Ms and Mt, where nothing else is said."""


@dataclass(frozen=True)
class Choices:
    """What rules leave open."""

    kind: str = "PI"
    alpha: float = levels.ALPHA
    limits: Limits = LIMITS
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
