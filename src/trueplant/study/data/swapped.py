"""Columns that seem to be named in each other's place: a PV that never meets its set-point, where another one does."""

from __future__ import annotations

from itertools import combinations

import numpy as np

from trueplant.arrays import Array
from trueplant.result import Code, Reason
from trueplant.study.study import Records


def swapped_columns(records: Records) -> list[Reason]:
    """Said of two PVs, or of the PV and the OP of a loop, each of which stands in the other's place by its set-point.

    A loop at work brings PV to its set-point, so that noise carries it across again and again. A PV that stays on one
    side all along while another column crosses that set-point is likely to be the other one.
    """
    closed = [segment for segment in records.segments if segment.closed]
    if not closed:
        return []
    project = records.project
    pvs, ops = [output.pv for output in project.outputs], [one.op for one in project.inputs]
    r = [np.concatenate([s.r[:, i] for s in closed]) for i in range(len(pvs))]
    y = [np.concatenate([s.y[:, i] for s in closed]) for i in range(len(pvs))]
    u = [np.concatenate([s.u[:, j] for s in closed]) for j in range(len(ops))]
    never = [i for i in range(len(pvs)) if np.isfinite(y[i] - r[i]).any() and not _meets(y[i], r[i])]
    pairs = [(i, j) for i, j in combinations(never, 2) if _meets(y[i], r[j]) and _meets(y[j], r[i])]
    left = set(never) - {i for pair in pairs for i in pair}
    named = [(pvs[i], pvs[j]) for i, j in pairs]
    named += [
        (pvs[i], ops[j]) for i in left for j in range(len(ops)) if _meets(u[j], r[i]) and _nearer(u[j], y[i], r[i])
    ]
    return [
        Reason(
            Code.SWAPPED,
            f"{one} never meets the set-point that the project gives it, and {other} does: the two columns look "
            "swapped. See which is which (pv, sp and op in the project) before anything else is believed",
            one,
        )
        for one, other in named
    ]


def _meets(x: Array, r: Array) -> bool:
    """Does a signal cross a set-point, or rest on it?"""
    apart = (x - r)[np.isfinite(x - r)]
    return bool(apart.size and apart.min() <= 0 <= apart.max())


def _nearer(x: Array, y: Array, r: Array) -> bool:
    """Is x mostly nearer to the set-point than y?"""
    return bool(np.nanmedian(np.abs(x - r)) < np.nanmedian(np.abs(y - r)))
