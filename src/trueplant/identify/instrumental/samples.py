"""Records as continuous-time filters see them: one output, its inputs, and the exact response between their samples."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from trueplant.arrays import Array, BoolArray
from trueplant.compiled import compiled
from trueplant.errors import Refused, UsageError
from trueplant.identify.pieces import Held, Piece, pieces_of
from trueplant.lti.irregular import rows_response_at
from trueplant.lti.sampled import expm, realise, rows_response
from trueplant.record.types import Segment


@dataclass(frozen=True, eq=False)
class Samples:
    """One output and the inputs that drive it. Inputs are deviations from their first sample."""

    t: Array
    """(N,) from 0 on; need not be uniform."""
    y: Array
    """(N,); 0 where not valid."""
    valid: BoolArray
    inputs: Array
    """(n_columns, N)."""
    hold: tuple[str, ...]
    at_rest: bool
    """The record starts in steady state, so that it needs no free response."""
    restarts: tuple[int, ...]
    """Samples at which a gap in the inputs ends."""
    h: float | None
    """Sample time; None where it is not constant."""

    @property
    def span(self) -> float:
        return float(self.t[-1])

    def respond(self, num: Array, den: Array, dead_time: float, u: Array, hold: str) -> Array:
        """Responses (m, N) of m numerators over one monic denominator to u (N,), from rest, exact for its hold."""
        if self.h is not None:
            return rows_response(num, den, dead_time, u, self.h, hold)
        return rows_response_at(num, den, dead_time, u, self.t, hold)

    def released(self, num: Array, den: Array, start: int) -> Array:
        """Impulse responses (m, N) of m strictly proper numerators over one monic denominator, 0 before `start`."""
        a, b, c, _ = realise(np.ascontiguousarray(num), np.ascontiguousarray(den))
        out = np.zeros((len(num), self.t.size))
        out[:, start:] = _released(a, b, c, self.t[start:])
        return out


def samples_of(segments: Sequence[Segment], output: int, held: Sequence[Held] = ()) -> tuple[Samples, ...]:
    """The segments in which this output was measured, without what the `held` elements make of it.

    Segments on a uniform grid are joined over short gaps, as the fit does. One whose t is not uniform stands by
    itself: its u and d hold from each instant to the next, or run linearly, as its `hold` says.

    Raises Refused where the output was never measured.
    """
    uniform = [segment for segment in segments if _is_uniform(segment)]
    found = [_of_piece(piece) for piece in pieces_of(uniform, output, held)]
    for segment in segments:
        valid = np.isfinite(segment.y[:, output])
        if not _is_uniform(segment) and valid.sum() >= 2:
            inputs: Array = np.ascontiguousarray(np.column_stack([segment.u, segment.d]).T)
            alone = Samples(
                np.asarray(segment.t - segment.t[0], dtype=np.float64),
                np.where(valid, segment.y[:, output], 0.0),
                valid,
                np.ascontiguousarray(inputs - inputs[:, :1]),
                segment.holds,
                _of_segment(segment, output, inputs),
                (),
                None,
            )
            found.append(_without(alone, held))
    if not found:
        raise Refused(f"output {output + 1} was not measured in any segment: see what screening left out, and why")
    return tuple(found)


def _without(samples: Samples, held: Sequence[Held]) -> Samples:
    y = samples.y.copy()
    for element in held:
        for term in element.system.terms:
            num = np.concatenate([np.zeros(len(term.den) - len(term.num)), term.num])[None, :] / term.den[0]
            den = np.array(term.den) / term.den[0]
            u, hold = samples.inputs[element.column], samples.hold[element.column]
            y -= samples.respond(num, den, term.dead_time, u, hold)[0]
    return replace(samples, y=np.where(samples.valid, y, 0.0))


def common_sample_time(samples: Sequence[Samples], purpose: str) -> float:
    """The one sample time of all records. Raises UsageError where there is none."""
    steps = {s.h for s in samples}
    if None in steps:
        raise UsageError(f"{purpose} needs records on a uniform grid: resample them, or use srivc, which does not")
    first = next(iter(steps))
    assert first is not None
    if any(h is None or abs(h - first) > 1e-9 * first for h in steps):
        raise UsageError(f"{purpose} needs records of one sample time: resample them to one")
    return first


def _is_uniform(segment: Segment) -> bool:
    steps = np.diff(segment.t)
    return bool(np.all(np.abs(steps - segment.h) < 1e-6 * segment.h))


def _of_piece(piece: Piece) -> Samples:
    t = np.asarray(piece.h * np.arange(piece.y.size), dtype=np.float64)
    return Samples(t, piece.y, piece.valid, piece.inputs, piece.hold, piece.starts_at_rest, piece.restarts, piece.h)


def _of_segment(segment: Segment, output: int, inputs: Array) -> bool:
    """Steady state at the start, by the test that uniform records get (which does not look at time)."""
    y = segment.y[:, output]
    valid = np.isfinite(y)
    clean = np.ascontiguousarray(inputs - inputs[:, :1])
    return Piece(0, segment.h, np.where(valid, y, 0.0), valid, clean, segment.hold).starts_at_rest


@compiled
def _released(a: Array, b: Array, c: Array, t: Array) -> Array:
    """C exp(A (t - t[0])) B at instants t: (m, N)."""
    n, m = b.size, c.shape[0]
    y = np.zeros((m, t.size))
    x, new = b.copy(), np.zeros(n)
    step = np.eye(n)
    last = 0.0
    for k in range(t.size):
        if k > 0:
            dt = t[k] - t[k - 1]
            if abs(dt - last) > 1e-9 * dt:
                step = expm(a * dt)
                last = dt
            largest = 0.0
            for i in range(n):
                value = 0.0
                for j in range(n):
                    value += step[i, j] * x[j]
                new[i] = value
                largest = max(largest, abs(value))
            x, new = new, x
            if largest < 1e-30:  # died out: what follows would be subnormal numbers, which are slow
                break
        for i in range(m):
            value = 0.0
            for j in range(n):
                value += c[i, j] * x[j]
            y[i, k] = value
    return y
