"""A valve at its end while OP goes on: taken at its word, OP then makes an unchanged plant look weak.

Of declared limits it is asked whether OP acted beyond them, as they may as well be those that a test is to keep, or of
another unit. PV is regressed on its own past and on all OPs through a bank of lags, and the OP that predicts it best is
taken. Ends that nobody declared are looked for in the same way, as a valve may be too small, sit on a stop, or be held
by another controller (a selector). They are not taken, as a bank of lags is no plant and places them roughly: the
outputs that such an OP moves are not answered until somebody says what it did (`plant/gate.py`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.stats import chi2

from trueplant.arrays import Array
from trueplant.identify.linear_algebra import orthonormal
from trueplant.record import Finding, Kind, Screened, Segment
from trueplant.record.levels import OP_LIMIT
from trueplant.record.numbers import counted
from trueplant.study import levels
from trueplant.study.data.excitation import Asked, bounded_weights

Limits = tuple[float, float]


def as_it_acted(screened: Screened, limits: Sequence[Limits | None]) -> Screened:
    """The record with each OP as far as its declared limits let it move PV, and a finding on each that went on beyond.

    `limits` has one entry an input.
    """
    for j, declared in enumerate(limits):
        if not screened.segments:
            break
        answers = Answers.of(screened.segments, j)
        if declared is not None and _beyond(screened.segments, j, declared):
            screened = _asked(screened, answers, declared)
            answers = replace(answers, ops=tuple(s.u[:, j] for s in screened.segments))
        if (end := found_end(answers, len(limits))) is not None:
            screened = replace(screened, findings=(*screened.findings, _ended(screened, j, end)))
    return screened


@dataclass(frozen=True, eq=False)
class Rows:
    """One PV beside what is known of it, no sample counting for more than a few standard deviations."""

    asked: Asked
    root: Array
    """(n, 1) of the weights."""
    basis: Array
    """(n, k) orthonormal, of what is known."""
    now: Array
    """(n,)"""

    @classmethod
    def of(cls, asked: Asked, every: int) -> Rows:
        rows = asked.columns[::every]
        known = np.column_stack([np.ones(len(rows)), rows[:, 1:]])
        root = np.sqrt(bounded_weights(rows[:, 0], known))[:, None]
        return cls(asked, root, orthonormal(root * known), root[:, 0] * rows[:, 0])

    def beyond(self, columns: Array) -> Array:
        """What is known does not tell of others (n, m)."""
        weighed = self.root * columns
        return np.asarray(weighed - self.basis @ (self.basis.T @ weighed))

    @cached_property
    def left(self) -> Array:
        """(n,)"""
        return np.asarray(self.now - self.basis @ (self.basis.T @ self.now))


@dataclass(frozen=True, eq=False)
class Answers:
    """All PVs beside their own past and the other OPs, ready for what one OP adds."""

    ops: tuple[Array, ...]
    """Of each segment (N,)."""
    column: int
    outputs: tuple[Rows, ...]
    """Of each PV that moves."""
    every: int
    """Of so many rows one is looked at."""

    @classmethod
    def of(cls, segments: Sequence[Segment], j: int) -> Answers:
        others, ops = [np.delete(s.u, j, axis=1) for s in segments], tuple(s.u[:, j] for s in segments)
        every = max(1, sum(map(len, segments)) // levels.END_SAMPLES)
        outputs = []
        for i in range(segments[0].y.shape[1]):
            asked = Asked.of([s.y[:, i] for s in segments], others, [s.d for s in segments])
            if asked is not None and len(asked.columns) > every * (asked.columns.shape[1] + levels.ANSWER_LAGS):
                outputs.append(Rows.of(asked, every))
        return cls(ops, j, tuple(outputs), every)

    def misfit(self, acted: Sequence[Sequence[Array]]) -> float:
        """-2 log likelihood but for a constant, where these (N,) stand for OP, all together."""
        found = 0.0
        for rows in self.outputs:
            added = np.hstack([rows.asked.through([x[:, None] for x in one])[:: self.every] for one in acted])
            added = orthonormal(rows.beyond(added))
            rest = float(rows.left @ rows.left) - float(np.sum((added.T @ rows.left) ** 2))
            found += rows.left.size * float(np.log(max(rest, np.finfo(float).tiny)))
        return found

    def within(self, limits: Limits) -> float:
        return self.misfit([[np.clip(op, *limits) for op in self.ops]])


def found_end(answers: Answers, inputs: int) -> Limits | None:
    """About where OP ceases to act, though nothing declares it: one end, the other one infinite.

    It has to predict PV better than a gain that varies with OP does, beyond chance over all that are tried.
    """
    op = np.concatenate(answers.ops)
    if not answers.outputs or not np.ptp(op) > 0:
        return None
    shares = np.array(levels.END_SHARES)
    tried = [(-np.inf, float(end)) for end in np.quantile(op, 1 - shares)]
    tried += [(float(end), np.inf) for end in np.quantile(op, shares)]
    least = float(chi2.isf(levels.END / len(tried) / inputs, 1))
    misfits = [answers.within(one) for one in tried]
    if answers.misfit([answers.ops]) - min(misfits) < least:
        return None
    end, ended = _refined(answers, tried[int(np.argmin(misfits))], float(np.ptp(op)))
    bent = [(one - np.mean(op)) ** 2 for one in answers.ops]
    return end if answers.misfit([answers.ops, bent]) - ended >= least else None


def _refined(answers: Answers, limits: Limits, span: float) -> tuple[Limits, float]:
    """The end near this one that predicts best, and its misfit."""
    found = {limits: answers.within(limits)}
    for width in levels.END_STEPS:
        for x in width * span * np.linspace(-1, 1, 9):
            one = (limits[0] + float(x), limits[1] + float(x))
            found[one] = answers.within(one)
        limits = min(found, key=found.__getitem__)
    return limits, found[limits]


def _beyond(segments: Sequence[Segment], j: int, limits: Limits) -> bool:
    """Does OP go beyond its limits, rounding apart?"""
    more = OP_LIMIT * (limits[1] - limits[0])
    return any(bool(np.any((s.u[:, j] < limits[0] - more) | (s.u[:, j] > limits[1] + more))) for s in segments)


def _asked(screened: Screened, answers: Answers, limits: Limits) -> Screened:
    """Of declared limits: did OP act beyond them?"""
    stopped = answers.within(limits) < answers.misfit([answers.ops])
    name = screened.record.inputs[answers.column]
    beyond = sum(int(np.sum((op < limits[0]) | (op > limits[1]))) for op in answers.ops)
    said = f"OP of {name} was beyond its limits in {counted(beyond, 'sample')}, and PV answers as if it had "
    said += "stayed at them: so it is taken." if stopped else "gone on: it is taken as recorded."
    finding = Finding(Kind.SATURATED, name, said, samples=beyond)
    segments = _held(screened.segments, answers.column, limits) if stopped else screened.segments
    return replace(screened, segments=segments, findings=(*screened.findings, finding))


def _ended(screened: Screened, j: int, limits: Limits) -> Finding:
    """Of an end that nobody declared."""
    u, name = screened.record.u[:, j], screened.record.inputs[j]
    end, side = (limits[1], "up") if np.isfinite(limits[1]) else (limits[0], "down")
    beyond = (u < limits[0]) | (u > limits[1])
    said = (
        f"OP of {name} seems to act {side} to about {end:.3g} only: PV is predicted best so, and OP is beyond in "
        f"{100 * float(np.mean(beyond)):.3g} % of the record. What it is taken to have done there would pass for the "
        f"plant's. See whether its valve is at its end, or another controller holds it, and declare limits {side} to "
        "there if so; else leave that time out (data.exclude)"
    )
    return Finding(Kind.END, name, said, samples=int(np.sum(beyond)), value=float(np.mean(beyond)))


def _held(segments: Sequence[Segment], j: int, limits: Limits) -> tuple[Segment, ...]:
    """The segments with OP within these limits."""
    out = []
    for segment in segments:
        u = segment.u.copy()
        u[:, j] = np.clip(u[:, j], *limits)
        out.append(replace(segment, u=u))
    return tuple(out)
