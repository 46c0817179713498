"""Settings as one types them: the faceplate's numbers with their names and units."""

from __future__ import annotations

from trueplant.result.controllers import CurrentSettings, LoopRetuning, ProposedSettings


def faceplate_values(loop: LoopRetuning, one: CurrentSettings | ProposedSettings) -> dict[str, str]:
    """Name to number and unit, as the faceplate of the loop shows them; a law that is no PID by its formula."""
    shown, notation = one.shown, loop.notation
    if shown is None:
        formula = None if one.settings is None else one.settings.tf
        return {} if formula is None else {"tf": formula}
    parallel, time = loop.form == "parallel", f" {notation.time_unit}"
    band, repeats = notation.gain == "proportional band", notation.integral == "repeats"
    ratio = " %/%" if loop.gain_unit == "percent of span" else ""
    filters = {"divisor": ("N", ""), "time": ("Tf", time)}
    named = {
        "gain": ("PB", " %") if band else ("Kp" if parallel else "Kc", ratio),
        "integral": (f"repeats per{time}", "")
        if repeats and not parallel
        else ("Ki", "")
        if parallel
        else ("Ti", time),
        "derivative": ("Kd", "") if parallel else ("Td", time),
        "derivative_filter": filters.get(notation.derivative_filter, ("alpha", "")),
    }
    values = {}
    for key, (name, unit) in named.items():
        value = getattr(shown, key)
        if value is not None or key in ("gain", "integral", "derivative"):
            values[name] = "none" if value is None else f"{value:.4g}{unit}"
    if shown.action is not None:
        values["action"] = shown.action
    return values
