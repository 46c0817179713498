"""OP beyond its declared limits: did it stop there, as a valve at its end does, or go on?

A controller that writes on while its valve is at its end moves nothing, and taken at its word it makes the plant look
weak. Limits may as well be those that a test is to keep, or of another unit. So the record is asked: PV is regressed on
its own past and on all OPs through a bank of lags, with OP as it was recorded and as far as its limits.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from trueplant.record import Finding, Kind, Screened, Segment
from trueplant.record.levels import OP_LIMIT
from trueplant.record.numbers import counted
from trueplant.study.data.bank import Asked, weighed
from trueplant.study.data.setpoints import unexplained

Limits = tuple[float, float]


def as_it_acted(screened: Screened, limits: Sequence[Limits | None]) -> Screened:
    """The record, each OP within its limits where PV answers so, with a finding on each that went beyond.

    `limits` has one entry an input.
    """
    for j, (name, bounds) in enumerate(zip(screened.record.inputs, limits, strict=True)):
        within = [_within(segment, j, bounds) for segment in screened.segments] if bounds is not None else []
        if any(one is not segment for one, segment in zip(within, screened.segments, strict=False)):
            screened = _judged(screened, tuple(within), j, name)
    return screened


def _within(segment: Segment, j: int, limits: Limits) -> Segment:
    """The segment itself where input j stays within its limits, rounding apart."""
    inside = np.clip(segment.u[:, j], *limits)
    if np.all(np.abs(inside - segment.u[:, j]) <= OP_LIMIT * (limits[1] - limits[0])):
        return segment
    u = segment.u.copy()
    u[:, j] = inside
    return replace(segment, u=u)


def _judged(screened: Screened, within: tuple[Segment, ...], j: int, name: str) -> Screened:
    stopped = _misfit(within) < _misfit(screened.segments)
    beyond = sum(int(np.sum(a.u[:, j] != b.u[:, j])) for a, b in zip(within, screened.segments, strict=True))
    said = f"OP of {name} was beyond its limits in {counted(beyond, 'sample')}, and PV answers as if it had "
    said += "stayed at them: so it is taken." if stopped else "gone on: it is taken as recorded."
    findings = (*screened.findings, Finding(Kind.SATURATED, name, said, samples=beyond))
    return replace(screened, segments=within if stopped else screened.segments, findings=findings)


def _misfit(segments: Sequence[Segment]) -> float:
    """-2 log likelihood of all PVs beside their own past and the OPs, but for a constant."""
    found = 0.0
    for i in range(segments[0].y.shape[1]):
        asked = Asked.of([s.y[:, i] for s in segments], [s.u for s in segments], [s.d for s in segments])
        if asked is not None:
            rows = weighed(asked.columns, np.ones(len(asked.columns)))
            errors = unexplained(rows[:, 0], rows[:, 1:], rcond=1e-10)
            found += errors.size * float(np.log(max(float(errors @ errors), np.finfo(float).tiny)))
    return found
