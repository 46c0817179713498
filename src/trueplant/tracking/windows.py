"""Windows of a long record, each as long as the requested precision needs.

The Fisher information of the plant's parameters for the recorded inputs predicts the standard errors of an estimate. It
is computed in blocks, which can be added. In closed loop only blocks count in which a set-point moves or has just
moved: what noise alone does to OP and PV depends on the controller as much as on the plant.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from itertools import pairwise

import numpy as np

from trueplant.arrays import Array, BoolArray, IntArray
from trueplant.identify import Row, RowFit
from trueplant.identify.linear_algebra import inverse
from trueplant.identify.noise import whiten, whitened_valid
from trueplant.record import Segment
from trueplant.result.numbers import number
from trueplant.tracking import levels


@dataclass(frozen=True)
class Stretch:
    """A part of the record in common time, over several files where it has to: to be fitted, or refused."""

    start: float
    end: float
    refusal: str = ""


@dataclass(frozen=True, eq=False)
class Blocks:
    """Information of one output's parameters in consecutive blocks, experiment after experiment."""

    experiment: IntArray
    """(n,)"""
    start: Array
    """(n,) as `end`: of experiments in their own time until `joined` puts them on the common axis."""
    end: Array
    information: Array
    """(n, p + 1, p + 1): of the parameters and an offset, per unit of prediction-error variance 1; 0 in idle blocks."""
    errors: Array
    """(n,) prediction errors."""
    active: BoolArray

    @classmethod
    def joined(cls, blocks: Sequence[Blocks], offsets: Sequence[float]) -> Blocks:
        """Those of several experiments in order of time, each moved to the common axis."""
        columns = {f.name: np.concatenate([getattr(own, f.name) for own in blocks]) for f in fields(cls)}
        shift = np.repeat(offsets, [own.start.size for own in blocks])
        return cls(**{**columns, "start": columns["start"] + shift, "end": columns["end"] + shift})

    def lasting(self, a: int, b: int) -> float:
        """Time that blocks a to before b cover; what lies between files does not count."""
        return float(np.sum(self.end[a:b] - self.start[a:b]))


@dataclass(frozen=True, eq=False)
class Demand:
    """Requested standard errors, in units of the parameters; infinite where none is requested."""

    limits: Array
    names: tuple[str, ...]
    """Parameters in words, such as "gain of reflux"."""
    precision: float
    shortest: float
    """Time that a window takes at least."""
    time_unit: str

    def met(self, information: Array, share: float = 1.0) -> bool:
        """Are the standard errors within this many times what was asked for?"""
        return bool(np.all(levels.SHORTFALL * standard_errors(information) <= share * self.limits))

    def shortfall(self, information: Array, length: float, errors: float) -> str:
        """What a stretch of this length with so many prediction errors lacks: length, samples, or moves."""
        if length < self.shortest:
            return (
                f"this stretch is shorter than a window can be: it takes {number(self.shortest)} {self.time_unit}, "
                "three times what the plant takes to settle"
            )
        if errors < levels.FEWEST_ERRORS:
            return (
                f"this stretch has {errors:.0f} usable samples of PV, and a window needs {levels.FEWEST_ERRORS}: "
                "export it at a shorter interval, or take a longer record"
            )
        ratio = levels.SHORTFALL * standard_errors(information) / self.limits
        worst = int(np.argmax(ratio))
        reached = 100 * self.precision * float(ratio[worst])
        known = f"to +-{reached:.2g} % only" if reached < 100 else "hardly at all"
        return (
            f"the moves of this stretch tell the {self.names[worst]} {known} (standard error; "
            f"{100 * self.precision:.2g} % was asked for)"
        )


def standard_errors(information: Array) -> Array:
    """(p,) from the information of p parameters and an offset; very large where there is none."""
    return np.asarray(np.sqrt(np.diag(inverse(information, levels.NO_INFORMATION)))[:-1])


def demand_of(fit: RowFit, answered: Sequence[int], columns: Sequence[str], precision: float, time_unit: str) -> Demand:
    """Gains, slopes, first time constants and dead times of the elements that the pilot has found."""
    names = fit.row.names
    inputs = [columns[spec.column] for spec in fit.row.specs for _ in spec.structure.names]
    size = np.abs(fit.theta) + fit.row.lag_of_dead_times(fit.theta)
    limits = np.full(fit.theta.size, np.inf)
    wanted = fit.row.is_gain | fit.row.is_dead_time
    for k in answered:
        if wanted[k] or names[k] == "tau1":
            limits[k] = precision * size[k]
    words = tuple(f"{name.replace('_', ' ')} of {column}" for name, column in zip(names, inputs, strict=True))
    return Demand(limits, words, precision, levels.LEAST_SETTLINGS * settling(fit), time_unit)


def settling(fit: RowFit) -> float:
    """How long a move keeps showing: some lags and the dead time of the slowest element."""
    times = [fit.row.pieces[0].h]
    for spec, part in zip(fit.row.specs, fit.row.slices, strict=True):
        p = fit.theta[part]
        times.append(levels.SETTLED * spec.structure.lag(p) + spec.structure.longest_dead_time(p))
    return float(max(times))


def moves_of(segments: Sequence[Segment]) -> Array:
    """Times at which a set-point moves (OP in open loop)."""
    found = []
    for segment in segments:
        source = segment.setpoints[:, np.isfinite(segment.r).all(axis=0)] if segment.closed else segment.u
        moved = np.any(np.diff(source, axis=0) != 0, axis=1)
        found.append(segment.t[1:][moved])
    return np.sort(np.concatenate(found)) if found else np.zeros(0)


def blocks_of(fit: RowFit, row: Row, moves: Array) -> Blocks:
    """What each block of the pieces of one experiment will say about theta of `fit` under its noise model."""
    settle = settling(fit)
    h = row.pieces[0].h * row.stride
    # an element of which little is known may take longer to settle than the record lasts
    longest = max(len(range(0, piece.y.size, row.stride)) for piece in row.pieces)
    length = max(levels.SHORTEST_BLOCK, round(min(settle / levels.BLOCKS_PER_SETTLING / h, longest)))
    parts = [_piece_blocks(fit, replace(row, pieces=(piece,)), length, settle) for piece in row.pieces]
    start, end, information, errors = (np.concatenate(columns) for columns in zip(*parts, strict=True))
    last = np.searchsorted(moves, end) - 1
    since = (
        np.where(last >= 0, start - moves[np.maximum(last, 0)], np.inf) if moves.size else np.full(start.size, np.inf)
    )
    active = since < settle
    experiment = np.full(start.size, row.pieces[0].experiment)
    return Blocks(experiment, start, end, np.where(active[:, None, None], information, 0.0), errors, active)


def _piece_blocks(fit: RowFit, row: Row, length: int, settle: float) -> tuple[Array, Array, Array, Array]:
    piece, stride, order = row.pieces[0], row.stride, fit.ar.size
    total = len(range(0, piece.y.size, stride))
    count, size = -(-total // length), fit.theta.size + 1
    warm = int(np.ceil(min(levels.WARM * settle / (piece.h * stride), total))) + order
    information, errors = np.zeros((count, size, size)), np.zeros(count)
    per_chunk = max(1, levels.CHUNK // length)
    for first in range(0, count, per_chunk):
        begin, end = first * length, min((first + per_chunk) * length, total)
        early = max(begin - warm, 0)
        span = slice(early * stride, min(end * stride, piece.y.size))
        # All chunks keep the operating point of the piece: each at its own, they would differ by steps.
        inputs = np.ascontiguousarray(piece.inputs[:, span])
        part = replace(row, pieces=(replace(piece.from_sample(span.start, span.stop), inputs=inputs),))
        _, gradient = part.response_and_gradient(fit.theta, 0)
        valid = part.measured(0)[1]
        if valid.size <= order:
            continue
        columns = whiten(fit.ar, np.column_stack([gradient, np.ones(len(gradient))]))
        use = whitened_valid(order, valid)
        columns = np.where(use[:, None], columns, 0.0) / np.sqrt(fit.variance)
        skip = max(begin - early - order, 0)
        late = columns[skip:]
        blocks = -(-len(late) // length)
        padded = np.zeros((blocks * length, size))
        padded[: len(late)] = late
        stacked = padded.reshape(blocks, length, size)
        information[first : first + blocks] = np.swapaxes(stacked, 1, 2) @ stacked
        seen = np.zeros(blocks * length)
        seen[: len(late)] = use[skip:]
        errors[first : first + blocks] = seen.reshape(blocks, length).sum(axis=1)
    last = piece.h * (piece.y.size - 0.5)  # no block reaches into what follows, whatever the stride
    edges = piece.start + np.minimum(np.arange(count + 1) * length * piece.h * stride, last)
    return edges[:-1], edges[1:], information, errors


def windows_of(blocks: Blocks, demand: Demand, settle: float, what: str) -> list[Stretch]:
    """Windows and refused stretches, in order of time. `what` names what should have moved.

    A run of moves that does not suffice waits for the next one, also in the next file: pieces are estimated together.
    """
    runs = _runs(blocks)
    found: list[Stretch] = []
    waiting: list[tuple[int, int]] = []
    """Runs that do not suffice alone."""

    def give_up() -> None:
        if waiting:
            a, b = waiting[0][0], waiting[-1][1]
            why = ""
            if not _some(blocks, demand, a, b):
                lasting, errors = blocks.lasting(a, b), float(blocks.errors[a:b].sum())
                why = demand.shortfall(blocks.information[a:b].sum(axis=0), lasting, errors)
            found.append(Stretch(float(blocks.start[a]), float(blocks.end[b - 1]), why))
            waiting.clear()

    for a, b in runs:
        own = _greedy(blocks, demand, a, b)
        if own:
            give_up()
            found += [Stretch(float(blocks.start[p]), float(blocks.end[q - 1])) for p, q in own]
            continue
        waiting.append((a, b))
        first = waiting[0][0]
        if _enough(blocks, demand, first, b):
            found.append(Stretch(float(blocks.start[first]), float(blocks.end[b - 1])))
            waiting.clear()
    give_up()
    return _with_idle(found, blocks, settle, what)


def _runs(blocks: Blocks) -> list[tuple[int, int]]:
    """(first, one past last) of each unbroken run of active blocks of one experiment."""
    label = np.where(blocks.active, blocks.experiment, -1)
    edges = np.flatnonzero(np.diff(label, prepend=-1, append=-1))
    return [(int(a), int(b)) for a, b in pairwise(edges) if blocks.active[a]]


def _some(blocks: Blocks, demand: Demand, a: int, b: int) -> bool:
    """Do these blocks tell anything, if less than was asked for?"""
    if blocks.lasting(a, b) < demand.shortest or blocks.errors[a:b].sum() < levels.FEWEST_ERRORS:
        return False
    return demand.met(blocks.information[a:b].sum(axis=0), levels.LARGEST_PRECISION / demand.precision)


def _enough(blocks: Blocks, demand: Demand, a: int, b: int) -> bool:
    """As precise as was asked for, or as long as a window may be."""
    if not _some(blocks, demand, a, b):
        return False
    long = blocks.lasting(a, b) > levels.LONGEST * blocks.lasting(0, blocks.start.size)
    return long or demand.met(blocks.information[a:b].sum(axis=0))


def _greedy(blocks: Blocks, demand: Demand, a: int, b: int) -> list[tuple[int, int]]:
    """Shortest windows that suffice, one after the other; what is left over lengthens the last one."""
    out: list[tuple[int, int]] = []
    first = a
    while first < b:
        step = 1
        while first + step < b and not _enough(blocks, demand, first, first + step):
            step *= 2
        low, high = first + step // 2, min(first + step, b)
        if not _enough(blocks, demand, first, high):
            break
        while high - low > 1:
            middle = (low + high) // 2
            low, high = (low, middle) if _enough(blocks, demand, first, middle) else (middle, high)
        out.append((first, high))
        first = high
    if out and first < b:
        out[-1] = (out[-1][0], b)
    return out


def _with_idle(found: list[Stretch], blocks: Blocks, settle: float, what: str) -> list[Stretch]:
    """The stretches, and between them those in which nothing moved or nothing could be used, if they are long."""
    idle = []
    for k in np.unique(blocks.experiment):
        inside = np.flatnonzero(blocks.experiment == k)
        first, last = float(blocks.start[inside[0]]), float(blocks.end[inside[-1]])
        own = [s for s in found if s.start < last and s.end > first]
        edges = [first, *(min(max(x, first), last) for s in own for x in (s.start, s.end)), last]
        for start, end in zip(edges[::2], edges[1::2], strict=True):
            if end - start > levels.IDLE * settle:
                there = blocks.errors[(blocks.start < end) & (blocks.end > start)].sum() > 0
                why = f"{what} in this stretch" if there else "no PV can be used in this stretch"
                idle.append(Stretch(start, end, why))
    return sorted([*found, *idle], key=lambda s: s.start)


def planned(blocks: Blocks, demand: Demand, settle: float, what: str) -> list[Stretch]:
    """`windows_of`, with windows made longer until there are no more than MOST of them."""
    while True:
        windows = windows_of(blocks, demand, settle, what)
        count = sum(not w.refusal for w in windows)
        if count <= levels.MOST:
            return windows
        closer = levels.CLOSER * np.sqrt(levels.MOST / count)
        demand = replace(demand, limits=demand.limits * closer, precision=demand.precision * closer)


def cut(blocks: Blocks, start: float, end: float) -> Blocks | None:
    """The blocks whose middle lies between two instants, with the outer ones ending there; None if there are none."""
    middle = (blocks.start + blocks.end) / 2
    keep = (middle >= start) & (middle <= end)
    if not keep.any():
        return None
    return Blocks(
        blocks.experiment[keep],
        np.maximum(blocks.start[keep], start),
        np.minimum(blocks.end[keep], end),
        blocks.information[keep],
        blocks.errors[keep],
        blocks.active[keep],
    )


def part_of(segments: Sequence[Segment], start: float, end: float) -> list[Segment]:
    """The segments of one experiment from `start` to before `end`."""
    out = []
    for segment in segments:
        a, b = np.searchsorted(segment.t, [start - 1e-6 * segment.h, end - 1e-6 * segment.h])
        if b - a > 1:
            out.append(segment.part(int(a), int(b)))
    return out
