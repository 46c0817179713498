"""Whether anything of a record can be used, and the sentence for it if not."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from trueplant.arrays import BoolArray
from trueplant.record import levels
from trueplant.record.layout import Layout
from trueplant.record.types import Finding, Kind, Record, Refusal, Unusable

_RAW = "Export what was really stored from a source without compression (the controller, the raw archive)"


def why_refused(
    record: Record,
    layout: Layout,
    usable: BoolArray,
    excluded: BoolArray,
    findings: Sequence[Finding],
) -> Refusal | None:
    """Why nothing of a record can be used, given what of y (N, n_y) is usable; u has been settled."""
    kept = ~excluded
    if not kept.any():
        return Refusal(Unusable.EXCLUDED, f"{record.name}: all of the record is excluded; shorten `exclude`")
    u = record.u[kept]
    moves = np.nanmax(u, axis=0) - np.nanmin(u, axis=0) if np.isfinite(u).any(axis=0).all() else np.zeros(1)
    if not np.any(moves > 0):
        message = f"{record.name}: OP never moves, so the record says nothing about the plant; use one in which it does"
        return Refusal(Unusable.STILL, message)
    if np.max(np.sum(usable, axis=0)) < levels.FEWEST_USABLE:
        return _without_pv(record, layout, findings)
    if not record.closed:
        return None
    return _compressed_op(record, layout, findings)


def _without_pv(record: Record, layout: Layout, findings: Sequence[Finding]) -> Refusal:
    """What has become of PV, where hardly a sample can be used."""
    still = [c.name for i, c in enumerate(layout.outputs) if np.nanmax(record.y[:, i]) == np.nanmin(record.y[:, i])]
    if len(still) == len(layout.outputs):
        message = f"{record.name}: PV of {', '.join(still)} is frozen all the time; check the sensor or the tag"
        return Refusal(Unusable.FROZEN, message)
    away = [f.signal for f in findings if f.kind is Kind.COMPRESSED and f.excludes]
    if away:
        return Refusal(
            Unusable.COMPRESSED_PV,
            f"{record.name}: PV of {', '.join(away)} was compressed by its historian until little more than "
            f"straight lines was left. {_RAW}",
        )
    return Refusal(
        Unusable.TOO_FEW,
        f"{record.name}: fewer than {levels.FEWEST_USABLE} usable PV samples are left after screening; "
        "see the findings, and export a longer or cleaner record",
    )


def _compressed_op(record: Record, layout: Layout, findings: Sequence[Finding]) -> Refusal | None:
    inputs = {c.name for c in layout.inputs}
    filled = {f.signal: 1 - f.value for f in findings if f.kind is Kind.COMPRESSED and f.signal in inputs and f.value}
    worst = max(filled, key=filled.__getitem__, default="")
    if filled.get(worst, 0.0) <= levels.MOST_FILLED_OP:
        return None
    return Refusal(
        Unusable.COMPRESSED_OP,
        f"{record.name}: OP of {worst} was compressed by its historian ({100 * filled[worst]:.3g} % of its "
        "samples, where it moves, lie on straight lines between the others): what moved the plant is not in the "
        f"record. {_RAW}",
    )
