"""What a record leaves open of a plant that no structure describes.

What comes nearest to such a plant differs from move to move, and nothing that a fit says of itself counts that: its
errors follow what OP does, and their part in what it says does not get smaller as noise does. So the halves of the
record count as two experiments (`between_experiments`): as far as they differ another record would.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from trueplant.identify import levels
from trueplant.identify.between_experiments import compare_runs
from trueplant.identify.estimate import free_of_noise
from trueplant.identify.fit import RowFit
from trueplant.identify.output import OutputEstimate, averaged
from trueplant.result.budget import Source


def counting_halves(estimate: OutputEstimate, confidence: float) -> OutputEstimate:
    """The estimate of one experiment, no surer than its halves agree where its prediction errors follow an input.

    Not where that input's element keeps a structure that a richer one was counted for (`kept_structures`).
    """
    if estimate.runs is not None or free_of_noise(estimate.fit):
        return estimate
    follows = np.flatnonzero(estimate.cross_p < levels.UNDERMODELLED)
    if not set(follows.tolist()) - set(estimate.kept):
        return estimate
    halves = compare_runs(in_halves(estimate.fit), estimate.factor)
    if halves is None:
        return estimate
    size = estimate.theta.size
    args = np.zeros((1, size)), np.ones(1), confidence, Source.STRUCTURE, halves.added[None]
    return replace(averaged(estimate, *args), halves=halves)


def in_halves(fit: RowFit) -> RowFit:
    """The fit, as if each half of its record were an experiment."""
    parts = fit.row.parted(fit.row.middle)
    pieces = tuple(replace(piece, experiment=k) for k, part in enumerate(parts) for piece in part)
    return replace(fit, row=replace(fit.row, pieces=pieces), weights=np.ones(len(pieces)))
