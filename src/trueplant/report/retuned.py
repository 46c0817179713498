"""Proposed controller settings as text: what to enter, what it changes, and what the other proposals would do."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from trueplant.lti.structure import gain_unit
from trueplant.report.loops import Cell
from trueplant.report.numbers import MISSING, number

Table = Mapping[str, Any]


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
    reason: str
    costs: str
    """What the new settings give up; empty if little."""
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

    @property
    def keeps(self) -> bool:
        """Are the settings to stay as they are?"""
        return self.recommended and not any(setting.changes for setting in self.settings)


def retuned(loop: Table, input_unit: str, output_unit: str) -> Retuned:
    """The texts of one loop of `controllers`; units of OP and PV."""
    proposals = [p for p in loop["proposals"] if p.get("settings")]
    chosen = next((p for p in proposals if p["method"] == loop["recommended"]), None)
    shown = chosen or next((p for p in proposals if p.get("metrics")), None)
    names = _labels(loop, input_unit, output_unit)
    current = loop["current"]
    own, new = _values(current), _values(shown) if shown else {}
    form = (current["settings"] or {}).get("form"), (shown["settings"] if shown else {}).get("form")
    keys = [key for key in (*names, "tf") if own.get(key) is not None or new.get(key) is not None]
    settings = [
        Setting(names.get(key, "Transfer function"), _value(own.get(key)), _value(new.get(key))) for key in keys
    ]
    if any(form):
        settings.insert(0, Setting("Form", *(text or "formula" for text in form)))
    return Retuned(
        input=loop["input"],
        output=loop["output"],
        method=shown["method"] if shown else None,
        recommended=chosen is not None,
        reason=loop.get("reason") or "",
        costs=" ".join(_costs(loop, chosen)) if chosen else "",
        limits=_limits(loop.get("limits") or {}, loop["time_unit"]),
        assumptions=tuple(loop.get("assumptions") or ()),
        settings=tuple(settings),
        toml=_toml(loop, shown["settings"]) if shown else "",
        measures=_measures(current, shown, loop["time_unit"], input_unit, output_unit) if shown else (),
        headings=tuple(names[key] for key in ("gain", "integral", "derivative")),
        proposals=tuple(_proposal(p, loop, chosen) for p in ({"method": "now", **current}, *loop["proposals"])),
    )


def _costs(loop: Table, chosen: Table) -> list[str]:
    said = []
    price = loop.get("price")
    if price and price > 0 and chosen["method"] == "certain-share":
        share = number(100 * price, 2)
        said.append(
            f"Price of certainty: {share} % of the integral gain that tuning for the estimate alone would give."
        )
    noise = [_at("metrics", "plant", "noise", "op_std")(one) for one in (loop["current"], chosen)]
    if noise[0] and noise[1] and noise[1] > 1.3 * noise[0]:
        said.append(f"Measurement noise moves OP {number(noise[1] / noise[0], 2)} times as much as today.")
    mu = [_at("metrics", "plant", "mu", "upper")(one) for one in (loop["current"], chosen)]
    if mu[1] is not None and mu[1] >= 1:
        today = f" (today {number(mu[0], 3)})" if mu[0] is not None else ""
        said.append(f"Robust performance is not reached: mu {number(mu[1], 3)}{today}, below 1 is needed.")
    return said


def _limits(limits: Table, time_unit: str) -> str:
    said = []
    if limits.get("Ms") is not None:
        said.append(f"Ms and Mt at most {number(limits['Ms'])}")
    if limits.get("mu") is not None:
        said.append(f"mu at most {number(limits['mu'])}")
    if limits.get("share") is not None:
        said.append(f"for {number(100 * limits['share'])} % of the drawn plants")
    text = f"Limits: {' '.join(said[-2:]) if len(said) < 3 else f'{said[0]} and {said[1]} {said[2]}'}" if said else ""
    if limits.get("crossover") is not None and limits.get("why"):
        text += f"; crossover at most {number(limits['crossover'], 3)} rad/{time_unit}: {limits['why']}"
    return text


def _labels(loop: Table, input_unit: str, output_unit: str) -> dict[str, str]:
    """Key of the settings shown to its name and unit."""
    notation, parallel = loop.get("notation") or {}, loop.get("form") == "parallel"
    unit = notation.get("time_unit") or loop["time_unit"]
    unit_of_gain = "%/%" if loop.get("gain_unit") == "percent of span" else gain_unit(input_unit, output_unit)
    gain = f"Gain, {unit_of_gain}" if "(" in unit_of_gain else f"Gain ({unit_of_gain})" if unit_of_gain else "Gain"
    if notation.get("gain") == "proportional band":
        gain = "Proportional band (%)"
    integral = f"Repeats per {unit}" if notation.get("integral") == "repeats" else f"Integral time ({unit})"
    filters = {"divisor": "Derivative filter, divisor N", "time": f"Derivative filter time ({unit})"}
    return {
        "gain": gain,
        "integral": f"Integral gain Ki (per {unit})" if parallel else integral,
        "derivative": f"Derivative gain Kd (times {unit})" if parallel else f"Derivative time ({unit})",
        "derivative_filter": filters.get(notation.get("derivative_filter", ""), "Derivative filter ratio"),
        "action": "Action",
    }


def _values(proposal: Table) -> dict[str, Any]:
    """As the vendor shows them; a law that is no PID as its formula."""
    if proposal.get("shown"):
        return dict(proposal["shown"])
    settings = proposal.get("settings") or {}
    if "tf" not in settings:
        return {}
    others = (f"{formula} from {output}" for output, formula in settings.get("others", {}).items())
    return {"tf": "; ".join([settings["tf"], *others])}


def _value(value: Any) -> str:
    if value is None:
        return "none"
    return value if isinstance(value, str) else number(value, 4)


def _toml(loop: Table, settings: Table) -> str:
    """The [[controller]] tables to paste into the project: this loop's, and those from other outputs to its input."""
    own = {key: value for key, value in settings.items() if key != "others"}
    if loop.get("gain_unit") == "percent of span" and "tf" not in own:
        own["gain_unit"] = "percent of span"
    others = ((output, {"tf": formula}) for output, formula in settings.get("others", {}).items())
    blocks = []
    for output, law in ((loop["output"], own), *others):
        table = {"input": loop["input"], "output": output, **law}
        lines = [f"{key} = {_toml_value(value)}" for key, value in table.items() if value is not None]
        blocks.append("\n".join(["[[controller]]", *lines]))
    return "\n\n".join(blocks)


def _toml_value(value: Any) -> str:
    # a JSON string is a TOML string
    return json.dumps(value, ensure_ascii=False) if isinstance(value, str) else f"{value:.6g}"


# -- before and after -------------------------------------------------------------------------------------------

_Read = Callable[[Table], Any]


def _at(*path: str) -> _Read:
    def read(metrics: Table) -> Any:
        value: Any = metrics
        for key in path:
            value = None if value is None else value.get(key)
        return value

    return read


def _lines(unit: str, op: str, pv: str) -> Sequence[tuple[str, str, _Read, str, float | None]]:
    """(group, label, where, unit, limit): "%" for shares; a limit below 0 is one from above."""
    time, area = f" {unit}", f" {pv or '1'}·{unit}"
    op, pv = f" {op}", f" {pv}"
    return (
        ("Robustness", "Ms, peak of the sensitivity", _at("Ms"), "", -2.0),
        ("Robustness", "Gain margin", _at("gain_margin"), "", 2.0),
        ("Robustness", "Phase margin", _at("phase_margin"), "°", 30.0),
        ("Robustness", "Delay margin", _at("delay_margin"), time, None),
        ("Robustness", "Robust performance, µ", _at("mu", "upper"), "", -1.0),
        ("Unit step of the set-point", "Integrated absolute error", _at("setpoint", "iae"), area, None),
        ("Unit step of the set-point", "Overshoot", _at("setpoint", "overshoot"), "share", None),
        ("Unit step of the set-point", "Settling time", _at("setpoint", "settling"), time, None),
        ("Unit step of the set-point", "Total variation of OP", _at("setpoint", "total_variation"), op, None),
        ("Unit step of the load at OP", "Integrated absolute error", _at("load", "iae"), area, None),
        ("Unit step of the load at OP", "Peak error", _at("load", "peak"), pv, None),
        ("Unit step of the load at OP", "Settling time", _at("load", "settling"), time, None),
        ("Unit step of the load at OP", "Total variation of OP", _at("load", "total_variation"), op, None),
        ("Measurement noise", "Standard deviation of OP", _at("noise", "op_std"), op, None),
        ("The record again", "Control error (rms)", _at("replay", "pv_rms"), pv, None),
        ("The record again", "Standard deviation of OP", _at("replay", "op_std"), op, None),
    )


def _measures(current: Table, shown: Table, unit: str, op: str, pv: str) -> tuple[tuple[str, tuple[Measure, ...]], ...]:
    before, after = current["metrics"], shown.get("metrics") or {}
    cases = (before.get("model") or {}, before.get("plant") or {}, after.get("plant") or {})
    groups: dict[str, list[Measure]] = {}
    for group, label, read, own, limit in _lines(unit, op, pv):
        values = [read(case) if case.get("stable") else None for case in cases]
        if all(value is None for value in values) and not _is_open(label, cases):
            continue
        cells = [_cell(case, value, own, limit, label) for case, value in zip(cases, values, strict=True)]
        _, now, new = values
        model, before, after = cells
        change = MISSING
        if now and new is not None and own != "share":
            change = f"{round(100 * (new / now - 1)) or 0:+d} %".replace("+0 %", "0 %")
        groups.setdefault(group, []).append(Measure(label, model, before, after, change))
    return tuple((group, tuple(rows)) for group, rows in groups.items())


def _is_open(label: str, cases: Sequence[Table]) -> bool:
    """Gain, phase and delay margin may be without limit, which is worth saying."""
    return label.endswith("margin") and any(case.get("stable") for case in cases)


def _cell(case: Table, value: Any, unit: str, limit: float | None, label: str) -> Cell:
    if not case:
        return Cell(MISSING)
    if not case.get("stable"):
        return Cell("unstable", True)
    if value is None:
        return Cell("no limit" if label.endswith("margin") else MISSING)
    if unit == "share":
        return Cell(f"{number(100 * value, 2)} %")
    bad = limit is not None and (value < limit if limit > 0 else value > -limit)
    return Cell(f"{number(value, 3)}{unit}".rstrip(), bad)


def _proposal(one: Table, loop: Table, chosen: Table | None) -> Proposal:
    values = _values(one)
    metrics = ((one.get("metrics") or {}).get("plant")) or {}
    today = (loop["current"]["metrics"].get("plant") or {}).get("load") or {}
    load, drawn = metrics.get("load") or {}, one.get("drawn") or {}
    kind = "now" if one["method"] == "now" else "recommended" if chosen and one["method"] == chosen["method"] else ""
    texts = [
        _value(values[key]) if values.get(key) is not None else MISSING for key in ("gain", "integral", "derivative")
    ]
    if "tf" in values:
        texts = [values["tf"], "", ""]
    relative = MISSING
    if load.get("iae") is not None and today.get("iae"):
        relative = f"{number(100 * load['iae'] / today['iae'], 3)} %"
    return Proposal(
        method="today" if kind == "now" else one["method"],
        kind=kind,
        settings=tuple(texts),
        Ms=_cell(metrics, metrics.get("Ms"), "", -2.0, "Ms"),
        mu=_cell(metrics, (metrics.get("mu") or {}).get("upper"), "", -1.0, "mu"),
        load=relative,
        movement=number((metrics.get("setpoint") or {}).get("total_variation"), 3),
        overshoot=_percent((metrics.get("setpoint") or {}).get("overshoot")),
        share=_percent(drawn.get("share")),
        note=one.get("note") or "",
    )


def _percent(share: float | None) -> str:
    return MISSING if share is None else f"{number(100 * share, 3)} %"
