"""Controllers as the page Model shows them: the fields of each form and vendor, and what they are in plain keys."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from trueplant.app.screens.model_edits import Place
from trueplant.errors import ProjectError
from trueplant.project import Project
from trueplant.project.controllers import law_gains
from trueplant.tune.vendors import VENDORS, Vendor

PLAIN = {
    "ideal": ("Kc", "Ti", "Td", "alpha", "gain_unit"),
    "series": ("Kc", "Ti", "Td", "alpha", "gain_unit"),
    "parallel": ("Kp", "Ki", "Kd", "Tf", "gain_unit"),
    "tf": ("tf",),
}
"""Keys of a form in the project's own units."""
COMMON = ("action", "sample_time")
MORE = ("setpoint_weight", "derivative_on", "setpoint_filter", "anti_windup", "pv_filter", "recorded", "pv_transform")
"""Keys that most controllers leave as they are."""
CHOICES = {
    "gain_unit": ("engineering", "percent of span"),
    "action": ("", "reverse", "direct"),
    "derivative_on": ("error", "pv"),
    "anti_windup": ("clamp", "none", "back-calculation"),
    "recorded": ("before", "after"),
}
DEFAULTS = {
    "gain_unit": "engineering",
    "action": "",
    "derivative_on": "error",
    "anti_windup": "clamp",
    "recorded": "before",
    "setpoint_weight": 1.0,
}
"""What is the case where a key is left out: it is not written then, unless the file says it already."""
TEXTS = ("tf", "setpoint_filter", "pv_filter", "pv_transform")
LABELS = {
    "Kc": "Gain Kc",
    "Ti": "Integral time Ti",
    "Td": "Derivative time Td",
    "alpha": "Derivative filter alpha",
    "Kp": "Gain Kp",
    "Ki": "Integral gain Ki",
    "Kd": "Derivative gain Kd",
    "Tf": "Derivative filter time Tf",
    "tf": "Formula in s",
    "gain": "GAIN",
    "PB": "Proportional band, %",
    "repeats_per_minute": "Repeats per minute",
    "reset_minutes": "Reset, minutes",
    "reset_seconds": "Reset, seconds",
    "rate_minutes": "Rate, minutes",
    "rate_seconds": "Rate, seconds",
    "gain_unit": "Gain in",
    "action": "Action",
    "sample_time": "Scan",
    "setpoint_weight": "Set-point weight on P",
    "derivative_on": "Derivative acts on",
    "setpoint_filter": "Set-point filter",
    "anti_windup": "At OP's limits",
    "pv_filter": "PV filter",
    "recorded": "PV recorded, seen from it",
    "pv_transform": "Acts on a formula of pv",
}
ALL = tuple(LABELS)
"""Keys that the page sets; what else a controller has stays as it is."""


def choices() -> dict[str, Any]:
    """What the page needs to build its fields."""
    ways = {form: {"label": f"{form}, plain keys", "keys": keys} for form, keys in PLAIN.items()}
    ways["tf"]["label"] = "any transfer function"
    for vendor in VENDORS:
        ways[f"vendor:{vendor.name}"] = {"label": vendor.name, "keys": _of_vendor(vendor)}
    return {
        "ways": ways,
        "common": COMMON,
        "more": MORE,
        "choices": CHOICES,
        "defaults": DEFAULTS,
        "labels": LABELS,
        "texts": TEXTS,
    }


def _of_vendor(vendor: Vendor) -> tuple[str, ...]:
    if vendor.form == "parallel":
        return ("Kp", "Ki", "Kd", "Tf")
    unit = "seconds" if vendor.time_unit == "s" else "minutes"
    return ("PB" if vendor.gain == "proportional band" else "gain", f"reset_{unit}", f"rate_{unit}", "alpha")


def shown(project: Project, tables: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Every controller: its way of being written, and its keys as the file has them."""
    raw = tables.get("controller", [])
    found = []
    for law, own in zip(project.controllers, raw, strict=True):
        way = f"vendor:{law.shown_by.name}" if law.shown_by is not None else law.kind
        keys = {key: own[key] for key in ALL if key in own}
        extra = sorted(set(own) - set(ALL) - {"input", "output", "form", "vendor"})
        faceplate = [key for key in keys if key not in _keys_of_way(way) and key not in (*COMMON, *MORE)]
        found.append(
            {
                "input": law.input,
                "output": law.output,
                "way": way,
                "keys": keys,
                "also": faceplate,
                "extra": extra,
                "told": plain_words(project, (law.output, law.input)),
            }
        )
    return found


def _keys_of_way(way: str) -> tuple[str, ...]:
    keys: tuple[str, ...] = choices()["ways"][way]["keys"]
    return keys


def keys_of(tables: Mapping[str, Any], place: Place, said: Mapping[str, Any]) -> dict[str, Any]:
    """The keys of the entry that the page asks for; what the page does not show is kept. Raises ProjectError."""
    way = str(said.get("way", ""))
    ways = choices()["ways"]
    if way not in ways:
        raise ProjectError("choose how the controller is shown")
    own: Mapping[str, Any] = next(
        (one for one in tables.get("controller", []) if (one.get("output"), one.get("input")) == place), {}
    )
    new: dict[str, Any] = {}
    vendor = way.removeprefix("vendor:") if way.startswith("vendor:") else None
    if vendor is not None:
        new["vendor"] = vendor
    elif way != "tf" and (way != "ideal" or "form" in own):
        new["form"] = way
    for key in ALL:
        value = said.get(key)
        if value in (None, "") or (way == "tf" and key in MORE):
            continue
        typed = _typed(key, value)
        if typed != DEFAULTS.get(key) or key in own:
            new[key] = typed
    kept = {key: value for key, value in own.items() if key not in (*ALL, "input", "output", "form", "vendor")}
    return {**new, **kept}


def _typed(key: str, value: Any) -> Any:
    if key in CHOICES or key in TEXTS:
        return str(value)
    try:
        return float(value)
    except (TypeError, ValueError):
        raise ProjectError(f"{LABELS[key]}: {value!r} is no number") from None


def plain_words(project: Project, place: Place) -> str:
    """The law in the project's own units, whatever it was written in."""
    law = next(one for one in project.controllers if (one.output, one.input) == place)
    if law.kind == "tf":
        return f"OP = ({law.tf}) (SP - PV)"
    gains = law_gains(law, project.time_unit)
    unit = project.time_unit
    named = [f"{key} {value:.4g}{f' {unit}' if key in ('Ti', 'Td', 'Tf') else ''}" for key, value in gains.items()]
    percent = ", gain in per cent of span" if law.in_percent else ""
    return f"{law.kind}: {', '.join(named)}{percent}"
