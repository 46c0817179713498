"""Does the declared controller reproduce the recorded OP? If not: by how much, and from where on."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from trueplant.arrays import Array
from trueplant.errors import LoopError
from trueplant.loop import Controller, replay
from trueplant.record import Segment
from trueplant.record.sensor import quantum
from trueplant.result import ControllerCheck
from trueplant.study import levels
from trueplant.study.study import Study


def check_controllers(study: Study) -> tuple[ControllerCheck, ...]:
    """One entry for each closed experiment and input with a declared controller, as in result.json."""
    entries = []
    for k, plan in enumerate(study.project.experiments):
        controller = study.records.declared[k] if plan.closed else None
        if controller is None:
            continue
        segments = study.screened[k].segments
        written = {i for i, _ in controller.entries}
        for i in sorted(written):
            entries.append(_entry(study, k, plan.name, controller, segments, i))
    return tuple(entries)


def _entry(
    study: Study, k: int, name: str, controller: Controller, segments: tuple[Segment, ...], i: int
) -> ControllerCheck:
    signal = study.project.inputs[i]
    unit, unchecked = signal.unit, partial(ControllerCheck, name, signal.name, signal.unit, None, None)
    try:
        replayed = _best_replay(controller, segments, study, k, i)
    except LoopError as problem:
        return unchecked(f"the controller cannot be checked: {problem}")
    if not replayed:
        why = study.screened[k].refusal or "set-point or PV is missing"
        return unchecked(f"the controller cannot be checked: {why}")
    e = np.concatenate([error for _, error in replayed])
    t = np.concatenate([segment.t for segment, _ in replayed])
    u = np.concatenate([segment.u[:, i] for segment, _ in replayed])
    rms = float(np.sqrt(np.mean(e**2)))
    scale = float(np.std(u)) or 1.0
    rounding = quantum(u) / np.sqrt(12)
    confirmed = rms <= max(levels.CONFIRMED * scale, levels.REPLAY_ROUNDED * rounding)
    checked = partial(ControllerCheck, name, signal.name, unit, confirmed, rms, relative=rms / scale)
    if confirmed:
        exact = rms < max(levels.ROUNDING * scale, levels.REPLAY_ROUNDED * rounding)
        to = "rounding" if exact else f"{rms:.3g} {unit}".rstrip() + " rms"
        return checked(message=f"the declared controller reproduces OP to {to}")
    since = _since(e, t, levels.CONFIRMED * scale)
    where = "throughout" if since is None else f"from t = {since:g} on"
    return checked(
        message=f"the declared controller does not reproduce OP: {rms:.3g} {unit} rms, {100 * rms / scale:.0f} % of "
        f"OP's own movement, {where}. Its tuning, action, scan or mode is not what was declared",
        since=since,
    )


def _best_replay(
    controller: Controller, segments: tuple[Segment, ...], study: Study, k: int, i: int
) -> list[tuple[Segment, Array]]:
    """The segments that can be replayed, each with recorded minus replayed OP.

    Laws whose scan is not declared are taken to be continuous or to scan as the record does, whichever fits better.
    """
    laws = [controller]
    if segments and any(law.sample_time is None for law in controller.entries.values()):
        h = segments[0].h
        scans = {place: replace(law, sample_time=law.sample_time or h) for place, law in controller.entries.items()}
        laws.append(replace(controller, entries=scans))
    tried = [[(s, _replay_error(law, s, study, k, i)) for s in segments] for law in laws]
    kept = [[(segment, error) for segment, error in one if error is not None] for one in tried]
    return min(kept, key=lambda one: sum(float(error @ error) for _, error in one))


def _replay_error(controller: Controller, segment: Segment, study: Study, k: int, i: int) -> Array | None:
    """Recorded minus replayed OP, the integral's start fitted; PV spikes act on the law as they did in the plant."""
    record = study.screened[k].record
    r, y = segment.r, recorded_pv(record.t, record.y, segment)
    needed = sorted({j for (row, j) in controller.entries if row == i})
    if not np.isfinite(r[:, needed]).all() or not np.isfinite(y[:, needed]).all():
        return None
    pv, sp = np.where(np.isfinite(y), y, 0.0), np.where(np.isfinite(r), r, 0.0)
    u = segment.u[:, i]

    def error_with(start: float, limits: Array) -> Array:
        bias = np.full(controller.n_u, start)
        return u - replay(controller, sp, pv, segment.h, bias=bias, limits=limits)[:, i]

    # What the integral held before the record is not known: it shifts OP by a constant until a limit is met.
    unlimited = np.tile([-np.inf, np.inf], (controller.n_u, 1))
    start = float(np.median(error_with(0.0, unlimited)[: levels.REPLAY_START]))
    best = error_with(start, controller.limits)
    for shift in (float(np.median(best)), float(np.median(best[: levels.REPLAY_START])), -start):
        error = error_with(start + shift, controller.limits)
        if np.mean(error**2) < np.mean(best**2):
            best = error
    return best


def recorded_pv(t: Array, y: Array, segment: Segment) -> Array:
    """PV as recorded, spikes included, on the grid of the segment; held over what is missing."""
    index = np.clip(np.searchsorted(t, segment.t + 0.25 * segment.h, side="right") - 1, 0, t.size - 1)
    on_grid = y[index].copy()
    for j in range(on_grid.shape[1]):
        good = np.isfinite(on_grid[:, j])
        if good.any() and not good.all() and good.mean() > 0.5:
            last = np.maximum.accumulate(np.where(good, np.arange(good.size), np.argmax(good)))
            on_grid[:, j] = on_grid[last, j]
    return on_grid


def _since(error: Array, t: Array, allowed: float) -> float | None:
    """From when on the error stays large, if it was small before; None if it is large from the beginning."""
    window = max(10, error.size // 50)
    power = np.cumsum(np.concatenate([[0.0], error**2]))
    rms = np.sqrt((power[window:] - power[:-window]) / window)
    large = rms > allowed
    if large[: max(1, large.size // 20)].any() or not large.any():
        return None
    return float(t[int(np.argmax(large))])
