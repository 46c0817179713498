"""What each figure shows, in words and numbers: its caption, and its text alternative for those who cannot see it."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from trueplant.arrays import Array, IntArray
from trueplant.lti.structure import gain_unit
from trueplant.report.excluded import used
from trueplant.report.figures import drawn_steps, phases
from trueplant.report.numbers import interval, number, to_precision
from trueplant.result import CoherenceCurves, Curves, Residuals, Trend


def _rms(x: Array) -> float | None:
    known = x[np.isfinite(x)]
    return float(np.sqrt(np.mean(known**2))) if known.size else None


def _extent(x: Array, unit: str) -> str:
    known = x[np.isfinite(x)]
    if not known.size:
        return "missing throughout"
    return f"{interval(float(known.min()), float(known.max()))}{_unit(unit)}"


def _unit(unit: str) -> str:
    return f" {unit}" if unit else ""


def step_response(curves: Curves, i: int, j: int) -> str:
    unit = _unit(gain_unit(curves.output_units[i], curves.input_units[j]))
    if not curves.step_t.size:
        return "No step response was computed."
    seen = np.s_[: drawn_steps(curves, i, j)]
    t, model, plant = curves.step_t[seen], curves.step_model[seen, i, j], curves.step_plant[seen, i, j]
    low, high = float(curves.step_low[seen, i, j][-1]), float(curves.step_high[seen, i, j][-1])
    banded = np.isfinite(low) and np.isfinite(high)
    # rounded as the tables are: by a standard error, which is a quarter of the band
    error = (high - low) / 4 if banded else None
    end = f"After {number(float(t[-1]), 3)}{_unit(curves.time_unit)}: "
    if np.isfinite(model).any():
        end += f"model {to_precision(float(model[-1]), error)}, "
    if not np.isfinite(plant).any():
        return f"{end}plant not answered{unit and f' ({unit.strip()})'}."
    end += f"plant {to_precision(float(plant[-1]), error)}"
    if banded:
        end += f" ({interval(low, high, error)})"
    apart = np.abs(plant - model)
    if not np.isfinite(apart).any():
        return f"{end}{unit}."
    at = int(np.nanargmax(apart))
    if apart[at] == 0:
        return f"{end}{unit}. The curves coincide."
    when = f"{number(float(t[at]), 3)}{_unit(curves.time_unit)}"
    return f"{end}{unit}. Widest gap {number(float(apart[at]), 3)} at {when}."


def bode(curves: Curves, i: int, j: int) -> str:
    w, band = curves.w, curves.band[i][j]
    frequency = f"rad/{curves.time_unit}"
    if band is None:
        said, inside = "The data speak at no frequency. Over all frequencies drawn", np.ones(w.size, dtype=bool)
    else:
        inside = (w >= band[0]) & (w <= band[1])
        said = f"The data speak from {number(band[0], 3)} to {number(band[1], 3)} {frequency}. There"
        if not inside.any():
            return f"{said.removesuffix('. There')}, between the frequencies drawn."
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.abs(curves.bode_plant[inside, i, j]) / np.abs(curves.bode_model[inside, i, j])
    model, plant, points = phases(curves, i, j)
    shift = (plant - model)[inside]
    ratio, shift = ratio[np.isfinite(ratio)], shift[np.isfinite(shift)]
    count = int(np.isfinite(points).sum())
    label = f" {count} points: {curves.np_label or 'estimate without a model'}." if count else ""
    if not np.isfinite(curves.bode_model[:, i, j]).any():
        size = np.abs(curves.bode_plant[inside, i, j])
        return f"{said}, the plant's magnitude is {_between(size)}.{label}"
    if not ratio.size or not shift.size:
        return f"{said}, plant and model cannot be compared: one of them has no response.{label}"
    times = _between(ratio)
    size = "the model's magnitude" if times == "1" else f"{times} times the model's magnitude"
    return f"{said}, the plant has {size} and its phase differs by {_between(shift, '°')}.{label}"


def _between(values: Array, unit: str = "") -> str:
    """Smallest to largest, or the one number where both print alike."""
    low, high = (f"{number(float(value), 3)}{unit}" for value in (values.min(), values.max()))
    return low if low == high else f"{low} to {high}"


def trends(curves: Curves, trend: Trend, panels: Sequence[tuple[str, int]]) -> str:
    if not trend.t.size:
        return "No samples."
    length = float(trend.t[-1] - trend.t[0])
    of = f" of {trend.thinned_from} samples, the extremes," if trend.thinned_from else " samples"
    said = [f"{trend.t.size}{of} over {number(length)}{_unit(curves.time_unit)}."]
    for kind, k in panels:
        if kind == "u":
            inside = used(curves, trend, curves.inputs[k])
            said.append(f"{curves.inputs[k]}: OP {_extent(trend.u[inside, k], curves.input_units[k])}.")
            continue
        inside = used(curves, trend, curves.outputs[k])
        errors = [
            f"{number(rms, 3)} for the {who}"
            for who, prediction in (("model", trend.model), ("plant", trend.plant))
            if not trend.thinned_from and (rms := _rms((trend.y[:, k] - prediction[:, k])[inside])) is not None
        ]
        missed = f"; prediction error (rms) {', '.join(errors)}" if errors else ""
        missed += "" if np.isfinite(trend.r[:, k]).any() else "; no set-point was recorded"
        said.append(f"{curves.outputs[k]}: PV {_extent(trend.y[inside, k], curves.output_units[k])}{missed}.")
    return " ".join(said)


def residuals_over_time(found: Residuals, unit: str) -> str:
    known = found.e[np.isfinite(found.e)]
    if not known.size:
        return "No prediction errors."
    # extremes alone would make the errors look larger than they are
    rms = "" if found.thinned_from else f"rms {number(_rms(known), 3)}{_unit(unit)}, "
    of = f" of {found.thinned_from}" if found.thinned_from else ""
    return (
        f"{known.size}{of} prediction errors, {rms}"
        f"from {number(float(known.min()), 3)} to {number(float(known.max()), 3)}{_unit(unit)}."
    )


def correlation(lags: Array | IntArray, value: Array, bound: float) -> str:
    """Lag 0 of an autocorrelation is 1 by definition; the caller leaves it out."""
    known = np.isfinite(value)
    if not known.any():
        return "Not computed."
    outside = int((np.abs(value[known]) > bound).sum())
    at = int(np.nanargmax(np.abs(value)))
    return (
        f"{outside} of {int(known.sum())} lags lie outside ±{number(bound, 2)}; "
        f"the largest is {number(float(value[at]), 2)} at lag {number(float(lags[at]))}."
    )


def coherence(curves: Curves, found: CoherenceCurves, i: int) -> str:
    value = found.multiple[:, i]
    best = int(np.argmax(value))
    unit = f"rad/{curves.time_unit}"
    lowest = min((band[0] for band in curves.band[i] if band is not None), default=math.inf)
    below = (
        f" Of what is slower than {number(float(found.w[0]), 3)} {unit}, where the data speak too, its windows are too "
        "short to tell."
        if lowest < found.w[0]
        else ""
    )
    return (
        f"Largest, {number(float(value[best]), 2)}, at {number(float(found.w[best]), 3)} {unit}; above the level of "
        f"noise, {number(found.level, 2)}, at {int(np.sum(value > found.level))} of {value.size} frequencies. Noise "
        f"alone exceeds it at {number(100 * found.significance)} % of them.{below}"
    )


def condition(curves: Curves) -> str:
    value = curves.condition
    if not np.isfinite(value).any():
        return "Not computed."
    low, high = int(np.nanargmin(value)), int(np.nanargmax(value))
    unit, w = f"rad/{curves.time_unit}", curves.condition_w
    return (
        f"From {number(float(value[low]), 3)} at {number(float(w[low]), 3)} {unit} to {number(float(value[high]), 3)} "
        f"at {number(float(w[high]), 3)} {unit}. Near 1 the excitations of the loops are independent; "
        "a large number means that they moved together and cannot be told apart there."
    )
