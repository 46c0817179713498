"""Which elements does anything move from outside?

Where the set-point of a loop stands still, what ties its PV to its OP may be the controller that answers PV, however
well a model fits. Its elements are told only as far as what moves elsewhere, other set-points and measured
disturbances, reaches one of their ends. A load that is smooth or periodic explains itself by its own past in no
simple way, so the answer to the sources is held against that to the same sources at other times.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from trueplant.arrays import Array
from trueplant.study import levels
from trueplant.study.data.bank import Asked
from trueplant.study.data.excitation import computed_somewhere, sources_of
from trueplant.study.study import Study


def unreached_elements(study: Study) -> frozenset[tuple[int, int]]:
    """(output, input) of elements of loops whose set-point never moves, neither end of which shows what else does."""
    closed = [segment for segment in study.segments if segment.closed]
    if not closed:
        return frozenset()
    computed = computed_somewhere(study)
    every = [np.hstack([sources_of(segment, computed), np.nan_to_num(segment.d)]) for segment in closed]
    moving = np.any([np.ptp(x, axis=0) > 0 for x in every], axis=0)
    sources = [x[:, moving] for x in every]
    by_hand = np.zeros(study.n_u, dtype=bool)
    for segment in study.segments:
        by_hand |= (not segment.closed) & (np.ptp(segment.u, axis=0) > 0)
    still = np.flatnonzero(~moving[: computed.size]).tolist()
    outputs = [i for i in still if not _reached([segment.y[:, i] for segment in closed], sources)]
    asked = np.flatnonzero(~by_hand).tolist() if outputs else []
    inputs = [j for j in asked if not _reached([segment.u[:, j] for segment in closed], sources)]
    return frozenset((i, j) for i in outputs for j in inputs)


def _reached(signals: Sequence[Array], sources: Sequence[Array]) -> bool:
    """Does the signal answer to the sources more than to the same sources at other times?"""
    asked = Asked.of(signals, sources) if sources[0].size else None
    if asked is None:
        return False
    columns = asked.columns - asked.columns.mean(axis=0)
    now, past, moved = np.split(columns, [1, asked.order + 1], axis=1)
    basis = np.linalg.qr(past)[0]
    rest = now[:, 0] - basis @ (basis.T @ now[:, 0])

    def explained(shift: int) -> float:
        """Share of what the signal does not owe to its past."""
        x = np.roll(moved, shift, axis=0)
        x = x - basis @ (basis.T @ x)
        weights, *_ = np.linalg.lstsq(x.T @ x, x.T @ rest, rcond=1e-12)
        return float(rest @ x @ weights)

    size = len(columns)
    shifts = np.random.default_rng(0).integers(size // 10, size - size // 10, levels.OTHER_TIMES)
    others = np.array([explained(int(shift)) for shift in shifts])
    return bool((1 + np.sum(others >= explained(0))) / (1 + others.size) < levels.REACHED)
