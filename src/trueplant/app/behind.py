"""The numbers behind the figures, as tables short enough to be read."""

from __future__ import annotations

import numpy as np

from trueplant.arrays import Array
from trueplant.report.decimate import at_rest
from trueplant.report.figures import phases
from trueplant.report.walk import Table
from trueplant.result import Curves, Trend

ROWS = 24
"""Of such a table: it is read beside its figure, and CSV has the rest."""


def step_table(curves: Curves, i: int, j: int) -> Table:
    """The response of output i to a unit step of input j until it is at rest."""
    model, plant = curves.step_model[:, i, j], curves.step_plant[:, i, j]
    moving = [one for one in (model, plant) if np.isfinite(one).any() and np.nanmax(np.abs(one)) > 0]
    picked = _picked(at_rest(moving) or curves.step_t.size)
    columns = (curves.step_t, model, plant, curves.step_low[:, i, j], curves.step_high[:, i, j])
    unit = f" ({curves.time_unit})"
    return _table((f"time{unit}", "model", "plant", "plant, at least", "plant, at most"), columns, picked)


def bode_table(curves: Curves, i: int, j: int) -> Table:
    """Magnitude and phase over frequency; the standard error is of the plant's magnitude, relative to it."""
    model, plant, _ = phases(curves, i, j)
    columns = (
        curves.w,
        np.abs(curves.bode_model[:, i, j]),
        np.abs(curves.bode_plant[:, i, j]),
        100 * curves.bode_std[:, i, j],
        model,
        plant,
    )
    headings = (
        f"rad/{curves.time_unit}",
        "magnitude, model",
        "magnitude, plant",
        "std. error (%)",
        "phase, model (°)",
        "phase, plant (°)",
    )
    return _table(headings, columns, _picked(curves.w.size))


def trend_table(curves: Curves, trend: Trend, i: int, j: int) -> Table:
    """Measurement and prediction of output i, with OP j."""
    calendar = curves.calendar(trend)
    picked = _picked(trend.t.size)
    times = [calendar.text(float(t)) for t in trend.t[picked]]
    columns = (trend.r[:, i], trend.y[:, i], trend.model[:, i], trend.plant[:, i], trend.u[:, j])
    rows = zip(times, *(column[picked].tolist() for column in columns), strict=True)
    return Table(("time", "SP", "PV", "model", "plant", "OP"), tuple(rows))


def _picked(count: int) -> Array:
    return np.unique(np.linspace(0, count - 1, ROWS).round().astype(int)) if count else np.zeros(0, dtype=int)


def _table(headings: tuple[str, ...], columns: tuple[Array, ...], picked: Array) -> Table:
    return Table(headings, tuple(zip(*(column[picked].tolist() for column in columns), strict=True)))
