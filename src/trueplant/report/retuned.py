"""Proposed controller settings as text: what to enter, what it changes, and what the other proposals would do."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from trueplant.lti.structure import gain_unit
from trueplant.printable import escaped_json
from trueplant.report.loops import Cell, is_beyond
from trueplant.report.numbers import MISSING, finite, number
from trueplant.result import (
    KEEP,
    ControllerSettings,
    CurrentSettings,
    LoopMetrics,
    LoopRetuning,
    ProposedSettings,
    RetuningLimits,
)
from trueplant.result.codec import entries_of
from trueplant.result.trade_off import trade_off_words

Value = float | str | None
"""Of a setting."""


@dataclass(frozen=True)
class Setting:
    """One parameter as the control system shows it: today's value and the proposed one."""

    label: str
    now: str
    new: str

    @property
    def changes(self) -> bool:
        """Is there something to enter?"""
        return self.now != self.new


@dataclass(frozen=True)
class Measure:
    """One line of the comparison of before and after."""

    label: str
    model: Cell
    now: Cell
    new: Cell
    change: str


@dataclass(frozen=True)
class Proposal:
    """One method's settings, and what they do on the plant."""

    method: str
    kind: str
    """"now", "recommended" or empty."""
    settings: tuple[str, ...]
    Ms: Cell
    mu: Cell
    load: str
    movement: str
    overshoot: str
    share: str
    note: str


@dataclass(frozen=True)
class Retuned:
    """One loop of the section on new settings."""

    input: str
    output: str
    method: str | None
    """The one whose settings and responses are shown: the recommended one, else the first that works."""
    recommended: bool
    kept: bool
    """Are today's settings recommended?"""
    reason: str
    changes: str
    """What the new settings change of the loop, for better and for worse."""
    price: str
    """What they give up to be certain."""
    limits: str
    assumptions: tuple[str, ...]
    settings: tuple[Setting, ...]
    toml: str
    measures: tuple[tuple[str, tuple[Measure, ...]], ...]
    """By group."""
    headings: tuple[str, ...]
    proposals: tuple[Proposal, ...]

    @property
    def has_mu(self) -> bool:
        """Were weights declared?"""
        return any(proposal.mu.text not in (MISSING, "unstable") for proposal in self.proposals)


def retuned(loop: LoopRetuning, input_unit: str, output_unit: str) -> Retuned:
    """The texts of one loop of `controllers`; units of OP and PV."""
    proposals = [p for p in loop.proposals if p.settings is not None]
    chosen = next((p for p in proposals if p.method == loop.recommended), None)
    shown = chosen or next((p for p in proposals if p.metrics is not None), None)
    names = _labels(loop, input_unit, output_unit)
    return Retuned(
        input=loop.input,
        output=loop.output,
        method=shown.method if shown else None,
        recommended=chosen is not None,
        reason=loop.reason,
        kept=loop.recommended == KEEP,
        changes=_changes(loop) if chosen else "",
        price=_price(loop, chosen) if chosen else "",
        limits=_limits(loop.limits, loop.time_unit),
        assumptions=loop.assumptions,
        settings=_settings(loop.current, shown, names),
        toml=_toml(loop, shown.settings) if shown and shown.settings else "",
        measures=_measures(loop, shown, input_unit, output_unit) if shown else (),
        headings=tuple(names[key] for key in ("gain", "integral", "derivative")),
        proposals=_proposals(loop, chosen),
    )


def _settings(
    current: CurrentSettings, shown: ProposedSettings | None, names: Mapping[str, str]
) -> tuple[Setting, ...]:
    """Today's settings and the proposed ones; by `names` those of the faceplate."""
    own, new = _values(current), _values(shown) if shown else {}
    keys = [key for key in (*names, "tf") if own.get(key) is not None or new.get(key) is not None]
    settings = [
        Setting(names.get(key, "Transfer function"), _value(own.get(key)), _value(new.get(key))) for key in keys
    ]
    now, then = (one.settings.form if one and one.settings else None for one in (current, shown))
    if now or then:
        settings.insert(0, Setting("Form", now or "formula", then or "formula"))
    return tuple(settings)


def _changes(loop: LoopRetuning) -> str:
    if loop.trade_off is None:
        return ""
    said = trade_off_words(loop.trade_off, loop.time_unit)
    return f"{said[:1].upper()}{said[1:]}.".replace("->", "→")


def _price(loop: LoopRetuning, chosen: ProposedSettings) -> str:
    price = finite(loop.price)
    if not price or price <= 0 or chosen.method != "certain-share":
        return ""
    share = number(100 * price, 2)
    return f"Price of certainty: {share} % of the integral gain that tuning for the estimate alone would give."


def _op_noise(metrics: LoopMetrics) -> float | None:
    return finite(metrics.noise.op_std) if metrics.noise else None


def _mu(metrics: LoopMetrics) -> float | None:
    return finite(metrics.mu.upper) if metrics.mu else None


def _limits(limits: RetuningLimits, time_unit: str) -> str:
    said = []
    if (Ms := finite(limits.Ms)) is not None:
        said.append(f"Ms and Mt at most {number(Ms)}")
    if (mu := finite(limits.mu)) is not None:
        said.append(f"mu at most {number(mu)}")
    if (share := finite(limits.share)) is not None:
        said.append(f"for {number(100 * share)} % of the drawn plants")
    text = f"Limits: {' '.join(said[-2:]) if len(said) < 3 else f'{said[0]} and {said[1]} {said[2]}'}" if said else ""
    if (crossover := finite(limits.crossover)) is not None and limits.why:
        text += f"; crossover at most {number(crossover, 3)} rad/{time_unit}: {limits.why}"
    return text


def _labels(loop: LoopRetuning, input_unit: str, output_unit: str) -> dict[str, str]:
    """Key of the settings shown to its name and unit."""
    notation, parallel = loop.notation, loop.form == "parallel"
    unit = notation.time_unit or loop.time_unit
    unit_of_gain = "%/%" if loop.gain_unit == "percent of span" else gain_unit(input_unit, output_unit)
    gain = f"Gain, {unit_of_gain}" if "(" in unit_of_gain else f"Gain ({unit_of_gain})" if unit_of_gain else "Gain"
    if notation.gain == "proportional band":
        gain = "Proportional band (%)"
    integral = f"Repeats per {unit}" if notation.integral == "repeats" else f"Integral time ({unit})"
    filters = {"divisor": "Derivative filter, divisor N", "time": f"Derivative filter time ({unit})"}
    return {
        "gain": gain,
        "integral": f"Integral gain Ki (per {unit})" if parallel else integral,
        "derivative": f"Derivative gain Kd (times {unit})" if parallel else f"Derivative time ({unit})",
        "derivative_filter": filters.get(notation.derivative_filter, "Derivative filter ratio"),
        "action": "Action",
    }


def _values(one: CurrentSettings | ProposedSettings) -> dict[str, Value]:
    """As the vendor shows them; a law that is no PID as its formula."""
    if (shown := one.shown) is not None:
        return {
            "gain": finite(shown.gain),
            "integral": finite(shown.integral),
            "derivative": finite(shown.derivative),
            "derivative_filter": finite(shown.derivative_filter),
            "action": shown.action,
        }
    if one.settings is None or one.settings.tf is None:
        return {}
    others = (f"{formula} from {output}" for output, formula in one.settings.others.items())
    return {"tf": "; ".join([one.settings.tf, *others])}


def _value(value: Value) -> str:
    if value is None:
        return "none"
    return value if isinstance(value, str) else number(value, 4)


def _toml(loop: LoopRetuning, settings: ControllerSettings) -> str:
    """The [[controller]] tables to paste into the project: this loop's, and those from other outputs to its input."""
    own = entries_of(settings, ("others",))
    if loop.gain_unit == "percent of span" and settings.form is not None:
        own["gain_unit"] = "percent of span"
    laws: list[tuple[str, dict[str, object]]] = [(loop.output, own)]
    laws += [(output, {"tf": formula}) for output, formula in settings.others.items()]
    blocks = []
    for output, law in laws:
        table = {"input": loop.input, "output": output, **law}
        lines = [f"{key} = {text}" for key, value in table.items() if (text := _toml_value(value)) is not None]
        blocks.append("\n".join(["[[controller]]", *lines]))
    return "\n\n".join(blocks)


def _toml_value(value: object) -> str | None:
    """None where there is nothing to write."""
    if isinstance(value, str):
        return escaped_json(json.dumps(value, ensure_ascii=False))  # a JSON string is a TOML string
    return f"{value:.6g}" if isinstance(value, int | float) and math.isfinite(value) else None


# -- before and after -------------------------------------------------------------------------------------------

_Read = Callable[[LoopMetrics], float | None]


def _lines(unit: str, op: str, pv: str) -> Sequence[tuple[str, str, _Read, str, float | None]]:
    """(group, label, where, unit, limit): "share" for shares; a limit below 0 is one from above."""
    time, area = f" {unit}", f" {pv or '1'}·{unit}"
    op, pv = f" {op}", f" {pv}"
    step, load, again = "Unit step of the set-point", "Unit step of the load at OP", "The record again"
    return (
        ("Robustness", "Ms, peak of the sensitivity", lambda m: m.Ms, "", -2.0),
        ("Robustness", "Gain margin", lambda m: m.gain_margin, "", 2.0),
        ("Robustness", "Phase margin", lambda m: m.phase_margin, "°", 30.0),
        ("Robustness", "Delay margin", lambda m: m.delay_margin, time, None),
        ("Robustness", "Robust performance, µ", _mu, "", -1.0),
        (step, "Integrated absolute error", lambda m: m.setpoint.iae if m.setpoint else None, area, None),
        (step, "Overshoot", lambda m: m.setpoint.overshoot if m.setpoint else None, "share", None),
        (step, "Settling time", lambda m: m.setpoint.settling if m.setpoint else None, time, None),
        (step, "Total variation of OP", lambda m: m.setpoint.total_variation if m.setpoint else None, op, None),
        (load, "Integrated absolute error", lambda m: m.load.iae if m.load else None, area, None),
        (load, "Peak error", lambda m: m.load.peak if m.load else None, pv, None),
        (load, "Settling time", lambda m: m.load.settling if m.load else None, time, None),
        (load, "Total variation of OP", lambda m: m.load.total_variation if m.load else None, op, None),
        ("Measurement noise", "Standard deviation of OP", _op_noise, op, None),
        (again, "Control error (rms)", lambda m: m.replay.pv_rms if m.replay else None, pv, None),
        (again, "Standard deviation of OP", lambda m: m.replay.op_std if m.replay else None, op, None),
    )


def _measures(
    loop: LoopRetuning, shown: ProposedSettings, op: str, pv: str
) -> tuple[tuple[str, tuple[Measure, ...]], ...]:
    before, after = loop.current.metrics, shown.metrics
    cases = (before.model, before.plant, after.plant if after else None)
    groups: dict[str, list[Measure]] = {}
    for group, label, read, own, limit in _lines(loop.time_unit, op, pv):
        values = [finite(read(case)) if case and case.stable else None for case in cases]
        if all(value is None for value in values) and not _is_open(label, cases):
            continue
        on_model, on_plant, proposed = (
            _cell(case, value, own, limit, label) for case, value in zip(cases, values, strict=True)
        )
        _, now, new = values
        change = MISSING
        if now and new is not None and own != "share":
            change = f"{round(100 * (new / now - 1)) or 0:+d} %".replace("+0 %", "0 %")
        groups.setdefault(group, []).append(Measure(label, on_model, on_plant, proposed, change))
    return tuple((group, tuple(rows)) for group, rows in groups.items())


def _is_open(label: str, cases: Sequence[LoopMetrics | None]) -> bool:
    """Gain, phase and delay margin may be without limit, which is worth saying."""
    return label.endswith("margin") and any(case is not None and case.stable for case in cases)


def _cell(case: LoopMetrics | None, value: float | None, unit: str, limit: float | None, label: str) -> Cell:
    if case is None:
        return Cell(MISSING)
    if not case.stable:
        return Cell("unstable", True)
    if value is None:
        return Cell("no limit" if label.endswith("margin") else MISSING)
    if unit == "share":
        return Cell(f"{number(100 * value, 2)} %")
    return Cell(f"{number(value, 3)}{unit}".rstrip(), is_beyond(value, limit))


def _proposals(loop: LoopRetuning, chosen: ProposedSettings | None) -> tuple[Proposal, ...]:
    """Today's settings in the first row, then what each method proposes."""
    now = loop.current
    today = ProposedSettings("today", "", now.settings, now.shown, now.metrics, now.drawn)
    rows = [_proposal(today, now.metrics.plant, "now")]
    for one in loop.proposals:
        kind = "recommended" if chosen and one.method == chosen.method else ""
        rows.append(_proposal(one, now.metrics.plant, kind))
    return tuple(rows)


def _proposal(one: ProposedSettings, today: LoopMetrics, kind: str) -> Proposal:
    values = _values(one)
    texts = [
        _value(values[key]) if values.get(key) is not None else MISSING for key in ("gain", "integral", "derivative")
    ]
    if "tf" in values:
        texts = [_value(values["tf"]), "", ""]
    metrics = one.metrics.plant if one.metrics else None
    setpoint = metrics.setpoint if metrics else None
    return Proposal(
        method=one.method,
        kind=kind,
        settings=tuple(texts),
        Ms=_cell(metrics, finite(metrics.Ms) if metrics else None, "", -2.0, "Ms"),
        mu=_cell(metrics, _mu(metrics) if metrics else None, "", -1.0, "mu"),
        load=_percent_of(_load_error(metrics) if metrics else None, _load_error(today)),
        movement=number(finite(setpoint.total_variation) if setpoint else None, 3),
        overshoot=_percent(setpoint.overshoot if setpoint else None),
        share=_percent(one.drawn.share if one.drawn else None),
        note=one.note,
    )


def _load_error(metrics: LoopMetrics) -> float | None:
    return finite(metrics.load.iae) if metrics.load else None


def _percent_of(value: float | None, today: float | None) -> str:
    return f"{number(100 * value / today, 3)} %" if value is not None and today else MISSING


def _percent(share: float | None) -> str:
    return MISSING if (known := finite(share)) is None else f"{number(100 * known, 3)} %"
