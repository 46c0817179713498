"""Samples that a historian got wrong and screening did not see: the law itself tells them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from trueplant.arrays import Array, BoolArray
from trueplant.loop import Controller, law_parts
from trueplant.record.levels import NORMAL_MAD
from trueplant.record.runs import spread, true_runs
from trueplant.study import levels
from trueplant.study.data.law_windows import Cuts, Stretch, Sums, recursion_of


def wrong_samples(
    cuts: Cuts, controller: Controller, i: int, sums: Sums, candidates: Sequence[Array]
) -> list[BoolArray]:
    """For each stretch, the samples at which a law misses OP for a moment, as it does where a PV was recorded wrong.

    Behind its own recursion a law has no memory: a wrong sample is missed once, and once again for each state. The
    gains by which the middle sample is missed least are taken, as wrong samples pull those of least squares. What is
    missed at most of a set-point's moves is the law's own fault.
    """
    rng = np.random.default_rng(1)
    missed, rounded = [], []
    for stretch in cuts.stretches:
        on_u = cuts.op_step * (rng.random(stretch.u.shape) - 0.5)
        on_y = cuts.pv_steps * (rng.random(stretch.y.shape) - 0.5)
        own, whole, lasts = _left(controller, i, sums, stretch, candidates, stretch.u, stretch.y)
        shaken, *_ = _left(controller, i, sums, stretch, candidates, stretch.u + on_u, stretch.y + on_y)
        missed.append(np.where(whole, np.abs(own), np.nan))
        rounded.append((shaken - own)[:, whole])
    size, by_rounding = np.hstack(missed), np.hstack(rounded)
    if not by_rounding.size:
        return [np.zeros(len(s.u), dtype=bool) for s in cuts.stretches]
    middle = np.nanmedian(size, axis=1)
    best = int(np.argmin(middle))
    usual = max(NORMAL_MAD * float(middle[best]), float(np.std(by_rounding[best])))
    large = [np.asarray(np.nan_to_num(one[best]) > levels.STRUCK * usual) for one in missed]
    setpoints = [s.setpoints for s in cuts.stretches]
    moved = [np.asarray(np.diff(r, axis=0, prepend=r[:1]).any(axis=1), dtype=bool) for r in setpoints]
    after = [m[1:] | m[:-1] for m in large]
    at_moves = np.concatenate([a[m[:-1]] for a, m in zip(after, moved, strict=True)])
    own_fault = at_moves.size > 0 and float(np.mean(at_moves)) > 0.5
    return [
        _alone(m, lasts, moves if own_fault else np.zeros_like(moves)) for m, moves in zip(large, moved, strict=True)
    ]


def _left(
    controller: Controller, i: int, sums: Sums, stretch: Stretch, candidates: Sequence[Array], u: Array, y: Array
) -> tuple[Array, BoolArray, int]:
    """(n, N) what each candidate misses of OP behind the law's recursion, where that is known, and its length."""
    parts = law_parts(controller, i, stretch.r, y, stretch.h, *sums, 1)
    recursion = recursion_of([[1.0], *(p.poles for p in parts)])
    values = np.column_stack([p.values for p in parts])
    left = np.stack([np.convolve(u - values @ gains, recursion)[: u.size] for gains in candidates])
    whole = np.convolve(~stretch.good, np.ones(recursion.size))[: u.size] == 0
    whole[: recursion.size - 1] = False
    return left, whole, recursion.size


def _alone(large: BoolArray, lasts: int, moved: BoolArray) -> BoolArray:
    """The samples behind short runs of large misses, away from what moved: one, or a few side by side."""
    begin, length = true_runs(large)
    moves = np.cumsum(moved)
    still = moves[begin + length - 1] == moves[np.maximum(begin - 2, 0)]
    short = still & (length <= 2 * lasts)
    return spread(begin[short], np.maximum(length[short] - lasts + 1, 1), large.size)
