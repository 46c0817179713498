"""Answers to what-ifs as JSON: what the library says of settings, in numbers and in words."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from trueplant.errors import LoopError
from trueplant.loop import PID, Controller, Linear
from trueplant.loop.many import Bank
from trueplant.lti import TransferMatrix, tf
from trueplant.output import RESULT
from trueplant.result import ControllerSettings, DrawnShares, LoopMetrics
from trueplant.result.recommendation_words import Outlook
from trueplant.result.trade_off import trade_off, trade_off_words
from trueplant.study.experiment.excursion import excursion
from trueplant.study.loops.recommendation import Judged
from trueplant.study.loops.situation import Situation, situation_of
from trueplant.study.loops.whatif import Answer, Hand, WhatIf

KEPT = 2
"""Results that are kept at hand: some 50 MB each."""
KEPT_CURVES = 24
"""Of today's settings: those of the loops and steps that somebody looks at."""
DIGITS = 6
"""Of a number that is drawn or shown: far more than a screen tells apart."""
OURS = "certain-share"
PRESETS = {
    OURS: "Ours",
    "simc": "SIMC",
    "lambda": "Lambda",
    "as-designed": "As designed",
    "amigo": "AMIGO",
    "by hand": "Tried before",
}
"""Methods that have a button of their own, and what it says."""
KEYS = {"parallel": ("Kp", "Ki", "Kd")}
"""Settings that a form shows; else Kc, Ti and Td."""

Steps = tuple[float, float]


@dataclass
class Held:
    """What is at hand of a result."""

    whatif: WhatIf
    today: dict[tuple[Any, Steps, float], Answer] = field(default_factory=dict)
    """Today's curves, which stay while a slider moves."""


_open: OrderedDict[tuple[str, int], Held] = OrderedDict()


class GivenUp(Exception):
    """A newer position of a slider has come."""


def warm_up() -> None:
    """Have what is compiled ready before the first question."""
    plant = TransferMatrix.of([[tf("exp(-s)/(5 s + 1)")]], "min")
    law = Controller({(0, 0): PID(Kc=1.0, Ti=5.0)}, 1, 1)
    still, one = np.zeros((9, 1)), np.ones((9, 1))
    wide = np.array([[-np.inf, np.inf]])
    Bank.of([plant], 0.1).run(law, one, still, y0=np.zeros(1), u0=np.zeros(1), limits=wide)
    from trueplant.tune.drawn import peaks

    w = np.geomspace(0.01, 10.0, 20)
    peaks(plant(1j * w)[None], law(1j * w), w)


def answer(request: Mapping[str, Any], is_stale: Callable[[], bool]) -> dict[str, Any]:
    """To one request of the worker. Raises what the library raises, and GivenUp where `is_stale`."""
    if request["kind"] == "plan":
        return _plan(_situation(request), int(request["plan"]))
    held = _held(request)
    whatif = held.whatif
    if request["kind"] == "open":
        return _opened(whatif)
    controller = whatif.controller(_settings(whatif, request["settings"]))
    if request["kind"] == "curves":
        return _curves(held, controller, request)
    if is_stale():
        raise GivenUp
    return _numbers(whatif, controller)


# -- what is tried on ----------------------------------------------------------------------------------------------


def _situation(request: Mapping[str, Any]) -> Situation:
    from trueplant.notebook.analysis import load

    found = load(request["folder"])
    if found.project is None:
        raise LoopError("plant.toml of the result is missing, which says what was analysed: run the analysis again")
    return situation_of(found.project, found.result)


def _held(request: Mapping[str, Any]) -> Held:
    key = request["folder"], (Path(request["folder"]) / RESULT).stat().st_mtime_ns
    if key not in _open:
        _open[key] = Held(WhatIf(_situation(request)))
        while len(_open) > KEPT:
            _open.popitem(last=False)
    _open.move_to_end(key)
    return _open[key]


def _settings(whatif: WhatIf, said: Mapping[str, Any]) -> dict[str, ControllerSettings]:
    """By input: today's with the numbers that were given."""
    found = {}
    for hand in whatif.loops:
        given = said.get(hand.input)
        if not isinstance(given, Mapping):
            continue
        if given.get("form") not in (None, hand.settings.form):
            found[hand.input] = ControllerSettings(**{key: given[key] for key in given if key in _FIELDS})
            continue
        keys: dict[str, Any] = {key: _number(value, key) for key, value in given.items() if key in _NUMBERS}
        if hand.settings.form != "parallel" and not keys.get("Ti", 1.0):
            keys["Ti"] = None  # no integral action
        found[hand.input] = replace(hand.settings, **keys)
    return found


_NUMBERS = ("Kc", "Ti", "Td", "alpha", "Kp", "Ki", "Kd", "Tf")
_FIELDS = ("form", "action", *_NUMBERS)


def _number(value: Any, key: str) -> float | None:
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not np.isfinite(value):
        raise LoopError(f"{key} must be a number")
    return float(value)


# -- what a page opens with ----------------------------------------------------------------------------------------


def _opened(whatif: WhatIf) -> dict[str, Any]:
    situation = whatif.situation
    doubts = [f"{one.input}: {one.message}" for one in situation.checks if one.confirmed is None]
    limits = whatif.limits
    return {
        "time_unit": situation.project.time_unit,
        "loops": [_loop(whatif, hand) for hand in whatif.loops],
        "limits": {"Ms": limits.Ms, "share": limits.share, "mu": limits.mu},
        "doubts": doubts,
        "proposed": bool(situation.result.controllers),
    }


def _loop(whatif: WhatIf, hand: Hand) -> dict[str, Any]:
    i, j = hand.place
    situation = whatif.situation
    project = situation.project
    low, high = situation.limits[i]
    retuning = hand.retuning
    return {
        "input": hand.input,
        "output": hand.output,
        "output_unit": project.outputs[j].unit,
        "input_unit": project.inputs[i].unit,
        "form": hand.settings.form,
        "keys": () if isinstance(hand.entry, Linear) else KEYS.get(hand.settings.form or "", ("Kc", "Ti", "Td")),
        "tf": hand.settings.tf,
        "action": hand.settings.action,
        "gain_unit": hand.shown.gain_unit,
        "today": _values(hand.settings),
        "presets": {
            name: {"label": PRESETS.get(name, name), "settings": _values(settings)}
            for name, settings in hand.presets.items()
            if name in PRESETS or (retuning is not None and name == retuning.recommended)
        },
        "recommended": None if retuning is None else retuning.recommended,
        "reason": "" if retuning is None else retuning.reason,
        "price": None if retuning is None else retuning.price,
        "highest": hand.highest,
        "why": hand.why,
        "pv": situation.y0[j],
        "op": situation.u0[i],
        "op_limits": [None if not np.isfinite(x) else x for x in (low, high)],
        "step": _usual_step(situation, hand),
        "load": _usual_load(low, high),
        "span": whatif.span(hand),
    }


def _values(settings: ControllerSettings) -> dict[str, Any]:
    return {"form": settings.form, **settings.values}


def _usual_step(situation: Situation, hand: Hand) -> float:
    """The record's own, in the middle; else 1."""
    moves = situation.result.data[situation.experiment].setpoints
    own = next((one.median for one in moves if one.signal == hand.output), None)
    return float(f"{own:.2g}") if own else 1.0


def _usual_load(low: float, high: float) -> float:
    """A twentieth of OP's range."""
    return float(f"{(high - low) / 20:.2g}") if np.isfinite(high - low) else 1.0


# -- curves --------------------------------------------------------------------------------------------------------


def _curves(held: Held, controller: Controller, request: Mapping[str, Any]) -> dict[str, Any]:
    whatif = held.whatif
    hand = next((one for one in whatif.loops if one.input == request["loop"]), whatif.loops[0])
    sizes = [_number(request.get(key), key) for key in ("step", "load")]
    steps = (sizes[0] or 0.0, sizes[1] or 0.0)
    span = whatif.span(hand) * 2.0 ** min(max(int(request.get("wider", 0)), 0), 4)
    key = hand.place, steps, span
    if key not in held.today:
        if len(held.today) >= KEPT_CURVES:
            held.today.clear()
        held.today[key] = whatif.answer(whatif.today, hand, steps, span)
    today = held.today[key]
    tried = whatif.answer(controller, hand, steps, span)
    return {
        "loop": hand.input,
        "span": span,
        "curves": {
            kind: {
                signal: {"today": _band(getattr(today, signal)[kind]), "tried": _band(getattr(tried, signal)[kind])}
                for signal in ("pv", "op")
            }
            for kind in ("set-point", "load")
        },
        "at_limit": {"today": today.at_limit, "tried": tried.at_limit},
    }


def _band(spread: Any) -> dict[str, list[float]]:
    names = ("low", "middle", "high")
    return {"t": _rounded(spread.t)} | {name: _rounded(spread.band[:, k]) for k, name in enumerate(names)}


def _rounded(values: Any) -> list[float]:
    return [float(f"{value:.{DIGITS}g}") for value in values]


# -- numbers -------------------------------------------------------------------------------------------------------


def _numbers(whatif: WhatIf, controller: Controller) -> dict[str, Any]:
    judged, today = whatif.judge.of(controller), whatif.judged_today
    same = controller == whatif.today
    said = whatif.verdict(controller, judged)
    unit = whatif.situation.project.time_unit
    loops = {}
    for hand in whatif.loops:
        before, after = (one.metrics[hand.place].plant for one in (today, judged))
        price = trade_off_words(trade_off(hand.input, before, after), unit)
        loops[hand.input] = {
            "today": _metrics(before, today.drawn[hand.place]),
            "tried": _metrics(after, judged.drawn[hand.place]),
            "price": price,
            "beyond": _beyond(whatif, hand, judged, said.too_fast),
        }
    outlook = said.found.outlook
    kept = outlook in (Outlook.KEEP, Outlook.KEEP_UNCHANGED) and judged.keeps(whatif.limits)
    state = "same" if same else "recommended" if said.recommended else "keep" if kept and not said.too_fast else "no"
    return {
        "loops": loops,
        "share": judged.share(whatif.limits),
        "share_today": today.share(whatif.limits),
        "state": state,
        "sentence": said.sentence,
    }


def _metrics(found: LoopMetrics, drawn: DrawnShares | None) -> dict[str, Any]:
    step, load, noise = found.setpoint, found.load, found.noise
    return {
        "stable": found.stable,
        "message": found.message,
        "Ms": found.Ms,
        "Mt": found.Mt,
        "Ms95": None if drawn is None else drawn.Ms.q95,
        "share": None if drawn is None else drawn.share,
        "stable_share": None if drawn is None else drawn.stable,
        "overshoot": step and step.overshoot,
        "settling": step and step.settling,
        "load_settling": load and load.settling,
        "load_error": load and load.iae,
        "op_moves": step and step.total_variation,
        "op_noise": noise and noise.op_variation,
        "mu": found.mu and found.mu.upper,
    }


def _beyond(whatif: WhatIf, hand: Hand, judged: Judged, too_fast: Mapping[str, str]) -> dict[str, str]:
    """By key of a number: in a word why it is beyond a limit."""
    found, drawn, limits = judged.metrics[hand.place].plant, judged.drawn[hand.place], whatif.limits
    said = {}
    if not found.stable:
        said["Ms"] = "unstable"
    for key in ("Ms", "Mt"):
        value = getattr(found, key)
        if value is not None and value > limits.Ms:
            said[key] = f"above {limits.Ms:.3g}"
    if drawn is None or drawn.share < limits.share:
        said["share"] = f"below {100 * limits.share:.3g} %"
    if limits.mu is not None and (found.mu is None or found.mu.upper > limits.mu):
        said["mu"] = f"above {limits.mu:.3g}"
    if hand.input in too_fast:
        said["crossover"] = too_fast[hand.input]
    return said


# -- plans ---------------------------------------------------------------------------------------------------------


def _plan(situation: Situation, number: int) -> dict[str, Any]:
    plans = situation.result.more_data
    if not 0 <= number < len(plans) or not plans[number].moves:
        raise LoopError("the result has no such plan: load the page again")
    found = excursion(situation, plans[number])
    project = situation.project
    outputs = [
        {"name": one.name, "unit": one.unit, "limits": one.limits, "band": _three(found.pv[j]), "is": "PV",
         "far": found.farthest[j].tolist(), "moved": _rounded(found.moved[:, j]) if found.closed else None}
        for j, one in enumerate(project.outputs)
    ]  # fmt: skip
    inputs = [
        {"name": one.name, "unit": one.unit, "limits": limit, "band": _three(found.op[i]), "is": "OP",
         "far": found.farthest[len(outputs) + i].tolist(),
         "moved": None if found.closed else _rounded(found.moved[:, i])}
        for i, (one, limit) in enumerate(
            zip(project.inputs, project.experiments[situation.experiment].limits, strict=True)
        )
    ]  # fmt: skip
    return {"t": _rounded(found.t), "closed": found.closed, "signals": [*outputs, *inputs]}


def _three(band: Any) -> dict[str, list[float]]:
    return {name: _rounded(band[:, k]) for k, name in enumerate(("low", "middle", "high"))}
