"""Can these data answer at all? Closed-loop records without a set-point change cannot."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from trueplant.record import Segment
from trueplant.study.result import Reason

if TYPE_CHECKING:
    from trueplant.study.pipeline import Study

Array = NDArray[np.float64]


def why_not_informative(study: Study) -> list[Reason]:
    """Reasons with the code "no-excitation" if no experiment excites the plant; else what limits the answer."""
    segments = study.segments
    if not segments:
        return []
    if any(_excited(segment) for segment in segments):
        return []
    closed = [segment for segment in segments if segment.closed]
    if not closed:
        return [Reason("no-excitation", "no input moves in these data: record a stretch in which OP is moved")]
    if all(not np.isfinite(segment.r).any() for segment in closed):
        return [
            Reason(
                "no-excitation",
                "no set-point was recorded. Without it nothing tells the plant from the controller's inverse, however "
                "well a model fits: add the set-point columns (sp = ...), or an experiment in open loop",
            )
        ]
    return [
        Reason(
            "no-excitation",
            "no set-point changes in these data. In closed loop a model that fits them may be the inverse of the "
            "controller (-1/Q) instead of the plant: use a record in which the set-points were moved",
        )
    ]


def _excited(segment: Segment) -> bool:
    return setpoint_moves(segment).size > 0 if segment.closed else bool(np.any(np.ptp(segment.u, axis=0) > 0))


def setpoint_moves(segment: Segment) -> Array:
    """(m, n_y) changes of the set-points from one sample to the next, where any changes."""
    r = segment.r[:, np.isfinite(segment.r).all(axis=0)]
    if r.size == 0:
        return np.zeros((0, 0))
    steps = np.diff(r, axis=0)
    moves: Array = steps[np.any(np.abs(steps) > 1e-9 * (1 + np.abs(r[1:])), axis=1)]
    return moves


def setpoint_rank_note(study: Study) -> list[Reason]:
    """Said where the set-points cannot be told from each other."""
    closed = [segment for segment in study.segments if segment.closed]
    if not closed or len(closed) < len(study.segments):
        return []
    moves = [m for m in map(setpoint_moves, closed) if m.size]
    n_y = closed[0].r.shape[1]
    if not moves or n_y < 2 or len({m.shape[1] for m in moves}) > 1:
        return []
    stacked = np.vstack(moves)
    size = np.linalg.norm(stacked, axis=0)
    still = [study.project.output_names[k] for k in range(stacked.shape[1]) if size[k] == 0]
    if still:
        return [
            Reason(
                "setpoint-still",
                f"the set-point of {', '.join(still)} never moves: the inputs move only as the loops let them, and "
                "the intervals are as wide as that makes them; move every set-point for a sharper answer",
            )
        ]
    values = np.linalg.svd(stacked / size, compute_uv=False)
    if values[-1] < 1e-3 * values[0]:
        return [
            Reason(
                "setpoint-rank",
                "the set-points always move in the same proportion, so the closed form (17)-(20) cannot be used: "
                "one direction of the plant is seen only through the dynamics of the loops",
            )
        ]
    return []
