"""What needs no structure: which frequency response is the best known, and how much the set-points explain."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from trueplant.arrays import Array
from trueplant.errors import TrueplantError
from trueplant.mismatch import Coherence, FrequencyResponse, coherence
from trueplant.result import CoherenceCurves, CoherenceTable, PartialCoherence, SignalCoherence
from trueplant.study import levels
from trueplant.study.study import Study

LABELS = {
    "joint": "joint form",
    "closed-form": "closed form (17)",
    "direct": "response to OP",
}


def label_of(response: FrequencyResponse) -> str:
    """How a response was found, in words."""
    return f"{LABELS[response.method]}, {'averaged periods' if response.periods else 'local polynomials'}"


def best_known(responses: Iterable[FrequencyResponse | None]) -> FrequencyResponse | None:
    """The first of local polynomials, or that from averaged periods where it holds more information."""
    given = [response for response in responses if response is not None]
    local = next((response for response in given if not response.periods), None)
    periodic = next((response for response in given if response.periods), None)
    if local is None or periodic is None:
        return local or periodic
    return periodic if np.median(_information(periodic) / _information(local)) > 1 else local


def _information(response: FrequencyResponse) -> Array:
    """(n_y, n_u) sum of |G|^2/std^2 over the reliable frequencies, without what a spread of few degrees adds to it."""
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.abs(response.sampled) ** 2 / response.std**2
    counted = np.where(response.reliable[:, None, None] & np.isfinite(ratio), ratio, 0.0)
    total: Array = counted.sum(axis=0) * (response.dof - 1) / response.dof
    return np.maximum(total, 1e-300)


def coherence_of(study: Study) -> Coherence | None:
    """With the set-points where closed-loop records have them, with OP in open loop; None where it cannot be told."""
    closed = [s for s in study.segments if s.closed and np.isfinite(s.r).all()]
    opened = [s for s in study.segments if not s.closed]
    if not closed and not opened:
        return None
    try:
        return coherence(closed or opened, "r" if closed else "u")
    except TrueplantError:
        return None


def coherence_table(study: Study, found: Coherence) -> CoherenceTable:
    """As the result has it."""
    keep, project = _kept(found, levels.COHERENCE_LISTED), study.project
    references = project.output_names if found.which == "r" else project.input_names
    signals = (*project.output_names, *(project.input_names if found.which == "r" else ()))
    return CoherenceTable(
        references="set-points" if found.which == "r" else "OP",
        windows=found.windows,
        significance=found.significance,
        level=found.level,
        partial_level=found.partial_level,
        frequencies=tuple(found.w[keep].tolist()),
        signals=tuple(
            SignalCoherence(
                name,
                tuple(found.multiple[keep, k].tolist()),
                tuple(
                    PartialCoherence(reference, tuple(found.partial[keep, k, j].tolist()))
                    for j, reference in enumerate(references)
                ),
            )
            for k, name in enumerate(signals)
        ),
    )


def coherence_curves(study: Study, found: Coherence) -> CoherenceCurves:
    """What the report draws: the outputs alone."""
    keep, n_y = _kept(found, levels.COHERENCE_DRAWN), len(study.project.outputs)
    return CoherenceCurves(
        found.w[keep], found.multiple[keep, :n_y], found.level, found.significance, found.which == "r"
    )


def _kept(found: Coherence, count: int) -> NDArray[np.intp]:
    wanted = np.geomspace(1, found.w.size, count)
    return np.unique(np.round(wanted).astype(np.intp)) - 1
