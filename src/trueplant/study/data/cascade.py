"""Cascades: does the slave loop do what the master asks, in the band in which the master works?

The plant from OP includes the slave. Where its response T from its set-point to its measurement is about 1, OP is what
reached the plant. Elsewhere the slave's lag is in the plant, and a change of the slave looks like one of the plant.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trueplant.arrays import Array
from trueplant.errors import LoopError, Refused, UnstableLoop
from trueplant.lti import TransferMatrix
from trueplant.mismatch import FrequencyResponse, hold_response, local_response
from trueplant.record import Record, Segment
from trueplant.record.resolution import settled
from trueplant.result import CascadeCheck, Code, Reason
from trueplant.robust import margins
from trueplant.study import levels
from trueplant.study.study import Study


def check_cascades(study: Study, plant: TransferMatrix) -> tuple[CascadeCheck, ...]:
    """One entry for each usable experiment and input with slave signals, as in result.json.

    `plant` (n_y, n_u + n_d) gives the master's bandwidth.
    """
    entries = []
    for k, screened in enumerate(study.screened):
        record = screened.record
        if screened.refusal is not None or record.slave_sp is None or record.slave_pv is None:
            continue
        for j, named in enumerate(study.project.inputs):
            if named.slave_sp is not None:
                entries.append(_checked(study, k, j, plant, _segments(record, screened.segments, j)))
    return tuple(entries)


def cascade_notes(entries: Sequence[CascadeCheck]) -> list[Reason]:
    """What the reader has to know of the slaves."""
    return [Reason(Code.CASCADE, e.message, f"{e.experiment}, {e.input}") for e in entries]


def _segments(record: Record, segments: Sequence[Segment], j: int) -> list[Segment]:
    """The slave's set-point and measurement as input and output of segments of their own; OP goes along as r."""
    assert record.slave_sp is not None
    assert record.slave_pv is not None
    found = []
    for segment in segments:
        index = np.searchsorted(record.t, segment.t + 0.25 * segment.h, side="right") - 1
        sp, pv = record.slave_sp[np.maximum(index, 0), j], record.slave_pv[np.maximum(index, 0), j]
        known = np.isfinite(sp)
        if known.mean() < levels.SLAVE_KNOWN or not known[0]:
            continue
        sp = settled(sp[np.maximum.accumulate(np.where(known, np.arange(sp.size), 0))])
        column = np.ones((sp.size, 1), dtype=bool)
        found.append(
            replace(
                segment,
                r=segment.u[:, j : j + 1],
                settled=None,
                u=sp[:, None],
                y=pv[:, None],
                d=np.zeros((sp.size, 0)),
                free=column,
                hold=(segment.hold[j],),
                jumps=(),
            )
        )
    return found


def _checked(study: Study, k: int, j: int, plant: TransferMatrix, segments: list[Segment]) -> CascadeCheck:
    said = partial(CascadeCheck, study.project.experiments[k].name, study.project.inputs[j].name)
    if not segments:
        return said("the slave's set-point is missing: whether the slave follows cannot be told")
    try:
        response = local_response(segments, "direct")
    except Refused as error:
        return said(f"whether the slave follows its set-point cannot be told: {error}")
    top, basis = _bandwidth(study, k, j, plant, segments)
    unit = study.project.time_unit
    inside = response.w <= max(top, response.w[response.points - 1])
    T, std = response.value[:, 0, 0], response.std[:, 0, 0] / np.abs(hold_response(response.w, response.h))
    known = inside & (std < levels.T_KNOWN)
    (high, low), stuck = _held(segments), _stuck(segments)
    said = partial(said, band=(float(response.w[0]), float(top)), basis=basis, held_share=high + low, stuck_share=stuck)
    if known.sum() < max(1, inside.sum() // 2):
        return said("the slave's set-point moves too little to tell whether the slave follows it")
    deviation = _deviation(response, T)
    clear = np.where(known, deviation - 2 * std, -np.inf)
    worst = int(np.argmax(np.where(known, deviation, -np.inf)))
    weight = known * response.w**2 / np.maximum(std, 1e-12) ** 2
    lag = float(np.sum(weight * -np.angle(T) / response.w) / np.sum(weight))
    gain = float(np.abs(T[int(np.argmax(known))]))
    measured = _Slave(gain, lag, float(deviation[worst]), float(response.w[worst]), high, low, stuck)
    follows = bool(np.max(clear) <= levels.FOLLOWS) and high + low < levels.HELD and stuck < levels.STUCK
    band = f"up to {top:.3g} rad/{unit} ({basis})"
    text = "" if _asked(segments) else "its set-point is not OP (in other units): was the slave in cascade mode? "
    if follows:
        text += f"the slave follows its set-point {band}: T differs from 1 by at most {deviation[worst]:.2g}"
    else:
        why = _why(measured, unit)
        text += f"the slave does not follow its set-point {band}, where T should be about 1: {why}"
    return said(text, follows=follows, deviation=measured.deviation, at=measured.at, gain=gain, lag=lag)


@dataclass(frozen=True)
class _Slave:
    """What was measured of a slave."""

    gain: float
    lag: float
    deviation: float
    """Largest |T - 1|, at the frequency `at`."""
    at: float
    high: float
    low: float
    """Shares of the record held at its upper and lower end."""
    stuck: float


def _why(slave: _Slave, unit: str) -> str:
    if slave.high + slave.low >= levels.HELD:
        both = min(slave.high, slave.low) >= levels.HELD / 4
        end = "both ends" if both else "its upper end" if slave.high > slave.low else "its lower end"
        return (
            f"it is at {end} for {100 * (slave.high + slave.low):.2g} % of the record while more is asked of it. OP "
            "did not reach the plant then: the gain found is too small and is no property of the plant. Leave these "
            "stretches out"
        )
    if abs(slave.gain - 1) > levels.FOLLOWS:
        return (
            f"at low frequency it does {slave.gain:.2g} of what is asked. A slave without integral action, another "
            "span or a valve that sticks or is closed would do that; the gains found include it"
        )
    if slave.deviation > levels.FOLLOWS and slave.lag * slave.at > levels.FOLLOWS / 2:
        return (
            f"it is too slow, with a lag of about {slave.lag:.2g} {unit}. The plant seen from OP includes that lag: "
            "tuning the slave will look like a change of the plant, and the master cannot be tuned without it"
        )
    if slave.stuck >= levels.STUCK:
        share = 100 * slave.stuck
        return (
            f"it sticks: it stands still for {share:.2g} % of the record while its set-point moves. OP is not "
            "what reached the plant then: take the slave's measurement for OP (op = ...), or mend the valve"
        )
    return (
        f"T is off by {slave.deviation:.2g} at {slave.at:.2g} rad/{unit}, and neither lag nor gain explains it: "
        "the slave rings, perhaps. The plant seen from OP includes that"
    )


def _deviation(response: FrequencyResponse, T: NDArray[np.complexfloating[Any, Any]]) -> Array:
    """|T - 1| (n_w,), the phase counted beyond half a sample: what happens between samples is not in the record."""
    phase = np.maximum(np.abs(np.angle(T)) - response.w * response.h / 2, 0.0)
    return np.asarray(np.abs(np.abs(T) * np.exp(1j * phase) - 1))


def _bandwidth(study: Study, k: int, j: int, plant: TransferMatrix, segments: Sequence[Segment]) -> tuple[float, str]:
    """Where the master's loop gain is 1, on plant or model; without one where its OP has most of its power."""
    law = study.records.linear[k]
    if law is not None and any(i == j for i, _ in law.entries):
        crossovers = []
        for matrix in (plant, study.model):
            inputs = matrix.columns(0, study.n_u)
            # a slave that does nothing may have left the loop, or the plant as estimated, without a crossover
            with suppress(UnstableLoop, LoopError):
                crossovers.append(margins(inputs, law, j).phase_margin_frequency)
        if np.isfinite(crossovers).any():
            return float(np.nanmax(crossovers)), "where the master's loop gain is 1"
    longest = max(segments, key=len)
    power = np.abs(np.fft.rfft(longest.u[:, 0] - longest.u[:, 0].mean())) ** 2
    below = np.searchsorted(np.cumsum(power) / np.sum(power), levels.WORKING)
    return float(2 * np.pi * max(int(below), 1) / (len(longest) * longest.h)), "where OP moves"


def _asked(segments: Sequence[Segment]) -> bool:
    """Is the slave's set-point OP, but for units?"""
    sp, op = np.concatenate([s.u[:, 0] for s in segments]), np.concatenate([s.r[:, 0] for s in segments])
    if np.ptp(op) == 0 or np.ptp(sp) == 0:
        return True
    # one scan later is still the same signal
    return bool(max(np.corrcoef(sp, op)[0, 1] ** 2, np.corrcoef(sp[1:], op[:-1])[0, 1] ** 2) > 1 - levels.OWN_SETPOINT)


def _held(segments: Sequence[Segment]) -> tuple[float, float]:
    """Share of samples at which the slave stays at its highest, and at its lowest level, while more is asked of it."""
    sp, pv = np.concatenate([s.u[:, 0] for s in segments]), np.concatenate([s.y[:, 0] for s in segments])
    good = np.isfinite(pv)
    if good.sum() < levels.PLATEAU:
        return 0.0, 0.0
    noise = _noise(pv[good])
    near = levels.AT_LEVEL * float(np.ptp(sp)) + 3 * noise
    return _share(sp, pv, near), _share(-sp, -pv, near)


def _stuck(segments: Sequence[Segment]) -> float:
    """Share of samples with a slave that stood still, but for its noise, while its set-point moved clearly."""
    from scipy.ndimage import maximum_filter1d, minimum_filter1d

    still, size = 0, 0
    for segment in segments:
        good = np.isfinite(segment.y[:, 0])
        sp, pv = segment.u[good, 0], segment.y[good, 0]
        if sp.size < levels.PLATEAU:
            continue
        span = float(np.ptp(sp))
        flat = max(1e-3 * span, 4 * _noise(pv))
        stuck = np.zeros(sp.size, dtype=bool)
        for window in (levels.PLATEAU, 3 * levels.PLATEAU, 10 * levels.PLATEAU):
            moved, stood = (maximum_filter1d(x, window) - minimum_filter1d(x, window) for x in (sp, pv))
            stuck |= (moved > max(levels.AT_LEVEL * span, levels.CLEARLY * flat)) & (stood < flat)
        still, size = still + int(np.sum(stuck)), size + sp.size
    return still / max(size, 1)


def _noise(pv: Array) -> float:
    """Standard deviation of white noise, which the jumps of a valve that sticks do not inflate."""
    return float(1.48 * np.median(np.abs(np.diff(pv, 2))) / np.sqrt(6))


def _share(sp: Array, pv: Array, near: float) -> float:
    """Of stretches in which pv stays at its highest level although sp, above it, moves by more than pv does."""
    level = float(np.nanmax(pv))
    held = (sp > level + near) & (np.nan_to_num(pv, nan=-np.inf) > level - 2 * near)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], held.astype(int), [0]])))
    stretches = [(a, b) for a, b in zip(edges[::2], edges[1::2], strict=True) if b - a >= levels.PLATEAU]
    return float(sum(b - a for a, b in stretches if np.ptp(sp[a:b]) > levels.CLEARLY * near) / pv.size)
