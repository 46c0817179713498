"""Rules applied to one loop, in the form and with the scan that its controller has."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from trueplant.errors import LoopError
from trueplant.loop import PID, Controller, unstable_poles
from trueplant.lti import TransferFunction, TransferMatrix
from trueplant.tune import levels
from trueplant.tune.forms import converted
from trueplant.tune.integral import Limits
from trueplant.tune.methods import LIMITS, METHODS, Choices


@dataclass(frozen=True)
class Retuned:
    """What one rule says for a loop."""

    method: str
    pid: PID | None
    """In engineering units, signs of u = Q (r - y); None where the rule has no answer."""
    note: str
    """Why there is none, or what is different from the controller at hand; else empty."""


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
    choices = Choices(kind or ("PID" if kd else "PI"), alpha, limits or LIMITS, closed_loop_time)
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
