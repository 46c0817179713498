"""How finely the numbers of a record are written, and which of its signals move by more than that."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from trueplant.arrays import Array, BoolArray
from trueplant.record import levels
from trueplant.record.sensor import quantum
from trueplant.record.types import Finding, Kind, Record


def resolution(y: Array) -> float:
    """The last place in which y was written down: a power of ten, or that of its floating-point numbers."""
    rounding = _rounding(y)
    digits = (d for d in range(-2, 16) if _printed(y, d, rounding))
    printed = next((10.0**-d for d in digits), 0.0)
    place = _place(y)
    return printed if printed >= place else place + printed


def _rounding(y: Array) -> float:
    """What some steps of arithmetic leave of numbers of this size."""
    return 4 * float(np.finfo(float).eps) * _largest(y)


def _largest(y: Array) -> float:
    return max(float(np.max(y, initial=0.0)), -float(np.min(y, initial=0.0)))


def _in_blocks(y: Array, fits: Callable[[Array], BoolArray]) -> bool:
    """Do all values fit? Looked at in blocks, until one does not."""
    return all(bool(np.all(fits(y[k : k + levels.BLOCK]))) for k in range(0, y.size, levels.BLOCK))


def _printed(y: Array, digits: int, rounding: float) -> bool:
    return _in_blocks(y, lambda some: np.abs(np.round(some, digits) - some) <= rounding)


def _place(y: Array) -> float:
    """The last place of the floating-point numbers that y is, or was before it was printed."""
    rounding = _rounding(y)
    # Nine digits tell single-precision numbers apart: half of the ninth is at most so much of a number.
    if _in_blocks(y, lambda some: np.abs(some.astype(np.float32) - some) <= np.maximum(5e-9 * np.abs(some), rounding)):
        return float(np.spacing(np.float32(_largest(y))))
    return 0.5 * rounding


def settled(x: Array, step: float = 0.0) -> Array:
    """x (N,), NaN where it is not known, held at each value until it is more than one step of its resolution away.

    This is the one definition of a move: whatever differs in a settled signal has moved. What arithmetic on a level
    leaves of it is no move either. A ramp that is written digit by digit moves as a whole, by at least two at a time.
    """
    known = np.flatnonzero(np.isfinite(x))
    if known.size < 2:
        return x
    v = x[known]
    least = step + _rounding(v)
    change = np.abs(np.diff(v))
    if not np.any((change > 0) & (change <= least)):
        return x
    # only where it changes is there anything to decide; in parts, as lists of numbers take ten times their memory
    changes = np.flatnonzero(change > 0) + 1
    at, begins = float(v[0]), np.zeros(v.size, dtype=np.intp)
    for part in np.array_split(changes, changes.size // levels.LISTED + 1):
        for k, value in zip(part.tolist(), v[part].tolist(), strict=True):
            if abs(value - at) > least:
                at, begins[k] = value, k
    out = x.copy()
    out[known] = v[np.maximum.accumulate(begins)]
    return out


@dataclass(frozen=True, eq=False)
class Settled:
    """A record without what arithmetic left in its signals."""

    record: Record
    setpoints: Array
    """(N, n_y) as they count for moves, held between them; those of `record` itself where both are the same."""
    findings: tuple[Finding, ...]


def without_rounding(record: Record) -> Settled:
    """The record with set-points, OPs and measured disturbances settled, and what there is to say of it.

    A set-point is as fine as it and its PV are written: round numbers show fewer digits than there are. It is no finer
    than the quantum of that PV. Two values of an OP may be its "on" and "off": only its floating-point numbers count.
    A signal that never moves is constant. One that does stays as recorded, flickering digits and all, for estimates
    and laws: the controller may have acted on them.
    """
    found: list[Finding] = []

    def columns(x: Array, names: tuple[str, ...], step: Callable[[Array, int], float]) -> tuple[Array, Array]:
        recorded, moving = x, x
        for k, name in enumerate(names):
            column = x[:, k]
            v = column[np.isfinite(column)]
            if v.size == 0 or np.ptp(v) == 0:
                continue
            at_rest = settled(column, step(v, k))
            if at_rest is column:
                continue
            constant = np.nanmin(at_rest) == np.nanmax(at_rest)
            recorded, moving = (z.copy() if z is x else z for z in (recorded, moving))
            recorded[:, k], moving[:, k] = at_rest if constant else settled(column), at_rest
            if constant:
                message = f"{name} moves by {np.ptp(v):.2g}, no more than the record resolves; taken as constant."
                found.append(Finding(Kind.CONSTANT, name, message, samples=int(v.size), value=float(v[0])))
        return recorded, recorded if np.array_equal(recorded, moving, equal_nan=True) else moving

    setpoints = tuple(f"set-point of {name}" for name in record.outputs)
    r, moving = columns(record.r, setpoints, lambda v, k: _setpoint_step(v, record.y[np.isfinite(record.y[:, k]), k]))
    u, _ = columns(record.u, record.inputs, lambda v, _: _place(v))
    d, _ = columns(record.d, record.disturbances, lambda v, _: _place(v))
    return Settled(replace(record, r=r, u=u, d=d), moving, tuple(found))


def _setpoint_step(r: Array, y: Array) -> float:
    """How finely a set-point r is known beside its PV y, both without gaps."""
    change = np.abs(np.diff(r))
    smallest = float(np.min(change[change > 0], initial=np.inf))
    step = max(resolution(r), _place(y))
    if y.size < 2:
        return step
    if smallest <= step + _rounding(r):
        # formats of so many digits write small numbers more finely
        size = float(np.min(np.abs(r)))
        as_large = y[np.abs(y) >= (10.0 ** np.floor(np.log10(size)) if size > 0 else 0.0)]
        step = max(min(step, resolution(as_large if as_large.size else y)), _place(y))
    # a quantum is no larger than the largest change
    if smallest > np.max(np.abs(np.diff(y))):
        return step
    # printed, it is whole digits
    return max(step, step * float(np.ceil(quantum(y) / step - 1e-6)))
