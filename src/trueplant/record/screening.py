"""Look through a record as a careful engineer would: what is usable, what is not, and why."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from trueplant.arrays import Array, BoolArray, IntArray
from trueplant.calendar import duration
from trueplant.errors import DataError
from trueplant.record import levels, sensor
from trueplant.record.compression import filled_in, moves
from trueplant.record.layout import Channel, Layout
from trueplant.record.numbers import counted
from trueplant.record.refusal import why_refused
from trueplant.record.resolution import without_rounding
from trueplant.record.runs import equal_runs, hold_short, several, spans_of, spread, true_runs
from trueplant.record.segments import Clock, between_parts, clock_of, segments_of
from trueplant.record.types import Finding, Kind, Record, Refusal, Screened, Unusable


def screen(
    record: Record,
    layout: Layout,
    *,
    experiment: int = 0,
    exclude: Sequence[tuple[float, float]] = (),
    limits: Mapping[str, tuple[float, float]] | None = None,
) -> Screened:
    """Find what must not be used and cut the rest into segments on a uniform grid.

    exclude: (from, to) in the record's time, left out by the user. limits: by name of input or output, instead of the
    layout's. PV samples that are missing, out of range, frozen or spikes are left out, but for the kinds that a channel
    keeps; while OP is at a limit or in manual it is still the true input, so that those samples stay, marked not free.
    """
    recorded, settled = record, without_rounding(record)
    record = settled.record
    log = _Log(record.t, [*record.notes, *settled.findings])
    clock = clock_of(record.t)
    _report_clock(record, clock, log)
    excluded = _excluded(record, exclude, log)
    bounds = {c.name: c.limits for c in (*layout.outputs, *layout.inputs)} | dict(limits or {})
    saturated = np.zeros(record.u.shape, dtype=bool)
    for j, channel in enumerate(layout.inputs):
        saturated[:, j] = _saturated(record, j, bounds[channel.name], channel, log)
        _report_input(record, j, channel, log)
        _report_compressed_op(record, j, channel, log)
    usable = np.isfinite(record.y) & ~excluded[:, None]
    interval = np.zeros(record.y.shape[1])
    for i, channel in enumerate(layout.outputs):
        bad, interval[i] = _output(record, i, bounds[channel.name], channel, clock, log)
        usable[:, i] &= ~bad
    for k, channel in enumerate(layout.disturbances):
        log.missing(record.d[:, k], channel.name)
    free = ~saturated & record.automatic
    segments = segments_of(settled, usable, free, clock, experiment, left_out=between_parts(excluded))
    refusal = why_refused(record, layout, usable, excluded, log.findings)
    if refusal is None and not segments:
        refusal = Refusal(
            Unusable.CUT_UP,
            f"{record.name}: no stretch of {levels.SHORTEST} samples with OP and a usable PV is left; "
            "export a record with fewer gaps, or at a longer interval",
        )
    return Screened(
        record=recorded,
        findings=tuple(log.findings),
        segments=() if refusal else segments,
        usable_y=usable,
        saturated=saturated,
        refused=refusal,
        update_interval=interval,
    )


@dataclass
class _Log:
    """Collects findings."""

    t: Array
    findings: list[Finding] = field(default_factory=list)

    def add(
        self,
        kind: Kind,
        signal: str,
        message: str,
        mask: BoolArray | None = None,
        excludes: bool = False,
        value: float | None = None,
    ) -> None:
        spans = spans_of(self.t, mask) if mask is not None else ()
        samples = int(np.sum(mask)) if mask is not None else 0
        self.findings.append(Finding(kind, signal, message, spans, samples, excludes, value))

    def struck(self, kind: Kind, channel: Channel, message: str, mask: BoolArray) -> BoolArray:
        """Which of the PV samples in `mask` are left out: all, or none where the project keeps them."""
        kept = kind in channel.keep
        end = "used, as the project says" if kept else "left out"
        self.add(kind, channel.name, f"{message}; {end}.", mask, not kept, float(np.mean(mask)))
        return mask & (not kept)

    def missing(self, x: Array, name: str, excludes: bool = False) -> None:
        lost = np.isnan(x)
        if lost.any() and not lost.all():
            self.add(Kind.MISSING, name, f"{name} is missing in {_count(lost)}.", lost, excludes, float(np.mean(lost)))


def _count(mask: BoolArray) -> str:
    return f"{counted(int(np.sum(mask)), 'sample')} ({100 * np.mean(mask):.3g} %)"


def _report_clock(record: Record, clock: Clock, log: _Log) -> None:
    steps = np.diff(record.t)
    unit = record.time_unit
    gaps = np.flatnonzero(steps > clock.gap)
    if gaps.size:
        spans = tuple((float(record.t[k]), float(record.t[k + 1])) for k in gaps)
        longest = float(steps[gaps].max())
        message = (
            f"The record has {counted(gaps.size, 'gap')}, the longest {duration(longest, unit)}; "
            "a new segment begins after each."
        )
        log.findings.append(Finding(Kind.GAP, "time", message, spans, value=longest))
    if clock.uniform:
        lost = int(np.sum(np.round(steps[steps <= clock.gap] / clock.h) - 1))
        if lost > 0:
            message = f"{counted(lost, 'single row')} missing; OP and set-points hold their last value there."
            log.findings.append(Finding(Kind.GAP, "time", message, samples=lost))
    even = duration(clock.h, unit)
    if clock.uniform and clock.jitter > levels.JITTER_SAID:
        message = f"Stamps deviate from an even {even} by {100 * clock.jitter:.2g} % rms; taken as even."
        log.add(Kind.IRREGULAR, "time", message, value=clock.jitter)
    if not clock.uniform:
        least, most = (duration(float(step), unit) for step in (steps.min(), steps.max()))
        message = (
            f"Sampling is irregular ({least} to {most}). On a grid of {even}, OP and set-points hold their last value "
            "and PV is interpolated between near samples."
        )
        log.add(Kind.IRREGULAR, "time", message, value=clock.jitter)


def _excluded(record: Record, exclude: Sequence[tuple[float, float]], log: _Log) -> BoolArray:
    out = np.zeros(record.t.size, dtype=bool)
    for low, high in exclude:
        if not low <= high:
            raise DataError(f"exclude from {low:g} to {high:g}: the end lies before the start; swap them")
        out |= (record.t >= low) & (record.t <= high)
    if out.any():
        log.add(Kind.EXCLUDED, "all", f"{_count(out)} were left out as asked.", out, True, float(np.mean(out)))
    return out


def _saturated(record: Record, j: int, limits: tuple[float, float] | None, channel: Channel, log: _Log) -> BoolArray:
    u = record.u[:, j]
    seems = limits is None
    if limits is None:
        at = _plateaus(record, j)
    else:
        tolerance = levels.OP_LIMIT * (limits[1] - limits[0])
        at = (u <= limits[0] + tolerance) | (u >= limits[1] - tolerance)
    if at.any():
        share = float(np.mean(at))
        verb = "seems to have been" if seems else "was"
        message = f"OP of {channel.name} {verb} at a limit for {100 * share:.3g} % of the record."
        if seems:
            message += " Declare its limits to be sure."
        log.add(Kind.SATURATED, channel.name, message, at, value=share)
    return at


def _plateaus(record: Record, j: int) -> BoolArray:
    """Where OP stays at its largest or smallest recorded value while the control error moves: most likely a limit."""
    u = record.u[:, j]
    out = np.zeros(u.size, dtype=bool)
    finite = np.isfinite(u)
    if not record.closed or not several(u[finite], levels.PLATEAU_VALUES):
        return out
    begin, length = equal_runs(u)
    value = u[begin]
    usual = float(np.median(length))
    error = record.r - record.y
    for extreme in (np.nanmin(u), np.nanmax(u)):
        run = (value == extreme) & (length >= levels.PLATEAU_SAMPLES * max(1.0, usual))
        plateau = spread(begin[run], length[run], u.size)
        if np.sum(plateau) < max(levels.PLATEAU_SAMPLES, levels.PLATEAU_SHARE * u.size):
            continue
        with np.errstate(invalid="ignore"):
            moved = [_std(e[plateau]) > levels.PLATEAU_ERROR * _std(e) for e in error.T]
        if any(moved):
            out |= plateau
    return out


def _std(x: Array) -> float:
    x = x[np.isfinite(x)]
    return float(np.std(x)) if x.size else 0.0


def _report_input(record: Record, j: int, channel: Channel, log: _Log) -> None:
    manual = ~record.automatic[:, j]
    if manual.any():
        message = f"{channel.name} was in manual for {100 * np.mean(manual):.3g} % of the record."
        log.add(Kind.MANUAL, channel.name, message, manual, value=float(np.mean(manual)))
    u = record.u[:, j : j + 1]
    if np.isnan(u).any():
        _, short = hold_short(u, levels.SHORT_GAP)
        message = f"OP of {channel.name} is missing in {_count(np.isnan(u))}"
        if short.any():
            message += f"; over {_count(short)} in short gaps its last value was held"
        log.add(Kind.MISSING, channel.name, message + ".", np.isnan(u[:, 0]), bool(np.isnan(u[~short]).any()))


def _output(
    record: Record, i: int, limits: tuple[float, float] | None, channel: Channel, clock: Clock, log: _Log
) -> tuple[BoolArray, float]:
    """What must not be used of one PV, and its update interval."""
    name, y = channel.name, record.y[:, i]
    log.missing(y, name, True)
    log.missing(record.r[:, i], f"set-point of {name}")
    bad = np.zeros(y.size, dtype=bool)
    if limits is not None:
        tolerance = levels.PV_LIMIT * (limits[1] - limits[0])
        with np.errstate(invalid="ignore"):
            bad = (y <= limits[0] + tolerance) | (y >= limits[1] - tolerance)
        if bad.any():
            message = f"{name} was at or beyond its range {limits[0]:g} to {limits[1]:g} in {_count(bad)}; left out."
            log.add(Kind.OUT_OF_RANGE, name, message, bad, True, float(np.mean(bad)))
    at = _places(np.isfinite(y) & ~bad)
    v = y[at]
    if v.size < levels.FEWEST_USABLE:
        return bad, clock.h
    if np.ptp(v) == 0:
        if np.any(np.nanmax(record.u, axis=0) > np.nanmin(record.u, axis=0)):
            stuck = np.isfinite(y)
            bad |= log.struck(Kind.FROZEN, channel, f"{name} never changes although OP moves", stuck)
        return bad, clock.h
    every, q = sensor.update_every(v), sensor.quantum(v)
    _report_sensor(every, q, name, clock, record.time_unit, log)
    share = filled_in(record.t[at], v, q)
    if share > levels.COMPRESSED:
        lost = share > levels.MOST_FILLED_PV
        message = (
            f"{name} was compressed by its historian: {100 * share:.3g} % of its samples, where it moves, lie on "
            f"straight lines between the others, so that only {100 * (1 - share):.3g} % carry information"
            f"{'; left out' if lost else ''}."
        )
        log.add(Kind.COMPRESSED, name, message, np.isfinite(y) if lost else None, lost, 1 - share)
        if lost:
            return bad | np.isfinite(y), every * clock.h
    stuck, spike = np.zeros(y.size, dtype=bool), np.zeros(y.size, dtype=bool)
    stuck[at] = sensor.frozen(v, record.u, at)
    if stuck.any():
        bad |= log.struck(Kind.FROZEN, channel, f"{name} stood still for {_count(stuck)} while OP moved: frozen", stuck)
    spike[at] = sensor.spikes(v, every, q)
    spike &= ~sensor.asked_for(spike, y, record.r[:, i])
    if spike.any():
        message = f"{name} has {counted(true_runs(spike)[0].size, 'short spike')}, {_count(spike)}"
        bad |= log.struck(Kind.SPIKE, channel, message, spike)
    _report_outliers(y, record.r[:, i], bad | stuck | spike, name, log)
    return bad, every * clock.h


def _report_sensor(every: float, q: float, name: str, clock: Clock, unit: str, log: _Log) -> None:
    if every > 1:
        message = (
            f"{name} is updated every {duration(every * clock.h, unit)} ({every:.3g} samples) and held in between."
        )
        log.add(Kind.HELD, name, message, value=every * clock.h)
    if q > 0:
        log.add(Kind.QUANTISED, name, f"{name} moves in steps of {q:.4g} (quantisation).", value=q)


def _report_compressed_op(record: Record, j: int, channel: Channel, log: _Log) -> None:
    """Of closed loops only: a person may well move OP along straight lines, a controller does not."""
    at = _places(np.isfinite(record.u[:, j]))
    u = record.u[at, j]
    alive = [i for i, y in enumerate(record.y.T) if np.isfinite(y[at]).any() and _span(y[at]) > 0]
    if not record.closed or u.size < levels.FEWEST_USABLE or not alive:
        return
    share = filled_in(record.t[at], u, sensor.quantum(u), moves([record.y[at, i] for i in alive]))
    if share > levels.COMPRESSED:
        message = (
            f"OP of {channel.name} was compressed by its historian: {100 * share:.3g} % of its samples, where it "
            "moves, lie on straight lines between the others, and what OP really did there is not in the record."
        )
        log.add(Kind.COMPRESSED, channel.name, message, value=1 - share)


def _places(where: BoolArray) -> IntArray | slice:
    """Indices of True; all of them as a slice, which copies nothing."""
    return slice(None) if where.all() else np.flatnonzero(where)


def _span(x: Array) -> float:
    return float(np.nanmax(x) - np.nanmin(x))


def _report_outliers(y: Array, r: Array, known: BoolArray, name: str, log: _Log) -> None:
    """PV far from where it is otherwise, and from where anybody asked it to be."""
    v = y[np.isfinite(y) & ~known]
    if v.size < levels.FEWEST_USABLE:
        return
    low, high = np.quantile(v, levels.OUTLIER_QUANTILES)
    away = levels.OUTLIER_RANGES * (high - low)
    asked = r[np.isfinite(r)]
    low, high = min(low, asked.min(initial=np.inf)), max(high, asked.max(initial=-np.inf))
    with np.errstate(invalid="ignore"):
        far = ((y < low - away) | (y > high + away)) & ~known
    if high > low and 0 < np.sum(far) < levels.OUTLIER_SHARE * y.size:
        message = f"{name} lies far from all its other values in {_count(far)}; declare its limits to leave them out."
        log.add(Kind.OUTLIER, name, message, far, value=float(np.mean(far)))
