"""A first model: which inputs act on an output, and by what structure, where nobody said.

Every pair is looked for. What the record does not show to act is left out, one element after the other, the least
certain first: where the controllers tie inputs together, one that does nothing takes over what another does.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from trueplant.identify import levels
from trueplant.identify.answers import unanswered
from trueplant.identify.estimate import Options, estimate_row
from trueplant.identify.longest_noise import estimate_beside_longest_noise
from trueplant.identify.output import OutputEstimate, averaged
from trueplant.identify.pieces import Held, pieces_of
from trueplant.identify.row import Row, Spec
from trueplant.identify.structures import Again, suffices_p
from trueplant.identify.unanswered import WhyUnanswered
from trueplant.lti.structure import Structure
from trueplant.record.types import Segment
from trueplant.result.budget import Source

SELF_REGULATING, INTEGRATING = Structure.parse("fopdt"), Structure.parse("integrator")


@dataclass(frozen=True, eq=False)
class FirstModel:
    """One output with those of the elements looked for that the record shows."""

    estimate: OutputEstimate | None
    """None where it shows none."""
    absence_p: Mapping[int, float]
    """By column: that the element is absent, over all that were looked for."""


def with_guesses(
    segments: Sequence[Segment],
    output: int,
    specs: Sequence[Spec],
    wanted: Collection[int],
    held: Sequence[Held],
    update: int,
) -> list[Spec]:
    """The elements of an output, those in the `wanted` columns with a guess: time constants to choose samples by.

    From a fit without anything that says how far it can be trusted, on few samples.
    """
    pieces = pieces_of(segments, output, held, update) if wanted else ()
    if not pieces:
        return list(specs)
    samples = sum(piece.y.size for piece in pieces)
    row = Row(tuple(specs), pieces, update * max(1, samples // levels.GUESSED_FROM // update))
    fits = [
        estimate_row(row, max(p.span for p in pieces) / share, Options(order=levels.GUESSED_ORDER))
        for share in levels.FIRST_SCALES
    ]
    best = min(fits, key=lambda fit: fit.cost / fit.count)
    return [
        replace(spec, guess=tuple(float(x) for x in best.theta[part])) if spec.column in wanted else spec
        for spec, part in zip(specs, row.slices, strict=True)
    ]


def shown(
    estimate: OutputEstimate, wanted: Collection[int], again: Again, tested: int, confidence: float
) -> FirstModel:
    """The estimate with those of the elements in the `wanted` columns that the record shows beyond chance.

    `tested` is the number of elements looked for in the whole matrix. Each has to show beside the largest noise model
    as well, as a change has to.
    """
    level = levels.STRUCTURE_SHARE * (1 - confidence) / tested
    left_out: dict[int, float] = {}
    kept: OutputEstimate | None = estimate
    while kept is not None:
        p = absence(kept, wanted, level, confidence)
        worst = max(p, key=lambda column: p[column], default=None)
        if worst is None or p[worst] < level:
            return FirstModel(kept, left_out | {column: min(one * tested, 1.0) for column, one in p.items()})
        left_out[worst] = min(p[worst] * tested, 1.0)
        rest = [spec for spec in kept.row.specs if spec.column != worst]
        kept = again(rest) if rest else None
    return FirstModel(None, left_out)


def absence(estimate: OutputEstimate, wanted: Collection[int], level: float, confidence: float) -> dict[int, float]:
    """By column, that each of the wanted elements is absent; beside the largest noise model where all look clear."""
    places = {spec.column: m for m, spec in enumerate(estimate.row.specs) if spec.column in wanted}
    p = {column: estimate.absence_p(m) for column, m in places.items()}
    if max(p.values(), default=1.0) >= level:
        return p
    sceptic = estimate_beside_longest_noise(estimate, confidence)
    return {column: max(p[column], sceptic.absence_p(m)) for column, m in places.items()}


def regulating_or_not(estimate: OutputEstimate, column: int, again: Again, confidence: float) -> OutputEstimate:
    """The estimate with an integrator in this column, where that is said or shown, and with a first order elsewhere.

    A record may be too short to show where a slow element comes to rest: one that integrates is then all that can be
    said. Of an element that is expected to integrate the record may say that it does not.
    """
    m = next(m for m, spec in enumerate(estimate.row.specs) if spec.column == column)
    spec = estimate.row.specs[m]
    if spec.structure == SELF_REGULATING and not _rest_unknown(estimate, m):
        return estimate
    other = INTEGRATING if spec.structure == SELF_REGULATING else SELF_REGULATING
    rival = again([Spec(column, other, None) if one is spec else one for one in estimate.row.specs])
    if rival is None:
        return estimate
    integrating, regulating = (rival, estimate) if other == INTEGRATING else (estimate, rival)
    suffices = suffices_p(integrating.fit, regulating.fit, m, confidence) > 1 - confidence
    return integrating if suffices else regulating


def with_left_out(
    estimate: OutputEstimate, columns: Collection[int], again: Again, confidence: float
) -> OutputEstimate:
    """The estimate, no surer than it would be beside the elements in these columns, which were left out.

    That the record does not show an element does not say that there is none, and what there is of it the others have
    taken on.
    """
    row = estimate.row
    kept = [
        replace(spec, guess=tuple(float(x) for x in estimate.theta[part]))
        for spec, part in zip(row.specs, row.slices, strict=True)
    ]
    specs = sorted([*kept, *(Spec(k, SELF_REGULATING) for k in columns)], key=lambda spec: spec.column)
    whole = again(specs) if columns else None
    if whole is None:
        return estimate
    parts = {spec.column: part for spec, part in zip(whole.row.specs, whole.row.slices, strict=True)}
    beside = np.concatenate([whole.theta[parts[spec.column]] for spec in kept])
    shifts = np.array([np.zeros(row.size), beside - estimate.theta])
    shares = np.array([1 - levels.THERE_ALL_THE_SAME, levels.THERE_ALL_THE_SAME])
    return averaged(estimate, shifts, shares, confidence, Source.NOT_SHOWN)


def _rest_unknown(estimate: OutputEstimate, m: int) -> bool:
    """Does the record leave open where an element that is there comes to rest?"""
    part, unknown = estimate.row.slices[m], unanswered(estimate)
    slow = estimate.row.is_gain | estimate.row.is_lag
    open_ones = (WhyUnanswered.TOO_UNCERTAIN, WhyUnanswered.GAIN_NOT_TOLD_FROM_ZERO)
    return any(slow[k] and k in unknown and unknown[k].why in open_ones for k in range(part.start, part.stop))
