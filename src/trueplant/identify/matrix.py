"""All outputs of a plant estimated, and what disturbances that reach several of them do to that."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from trueplant.identify.accounts import Open, Rivals, Tell, estimating, first_estimate
from trueplant.identify.estimate import free_of_noise
from trueplant.identify.first import shown, with_guesses, with_left_out
from trueplant.identify.holds import FoundHold
from trueplant.identify.missing import with_missing
from trueplant.identify.output import OutputEstimate, identify_output, row_of
from trueplant.identify.pieces import Held
from trueplant.identify.row import Row, Spec
from trueplant.identify.shared_disturbance import (
    predicted_outputs,
    related_at_once,
    together,
    widened_for_shared_disturbance,
)
from trueplant.identify.strides import (
    Sampling,
    choose_block,
    choose_stride,
    samples_per_update,
    typical_lag,
    within_dead_times,
)
from trueplant.lti.structure import structure_of
from trueplant.lti.transfer import TransferMatrix
from trueplant.record.types import Segment


@dataclass(frozen=True, eq=False)
class Identification:
    """The estimates, and what they found out besides the parameters."""

    segments: tuple[Segment, ...]
    """With holds and loads that were found, spikes of PV taken off."""
    estimates: dict[int, OutputEstimate]
    """Of each output that has elements to estimate and data to do it from."""
    holds: dict[int, FoundHold]
    """How measured disturbances run between their samples."""
    absence_p: dict[tuple[int, int], float]
    """That the elements of which nobody said so are absent, over all of them. Those that the record does not show are
    not among the estimates."""
    doubtful: tuple[tuple[int, int], ...] = ()
    """Elements that the model lacks and the fit shows, but not beside the largest noise model. They are not among the
    estimates, which are no surer than they would be beside them."""


def specs_of(model: TransferMatrix) -> dict[tuple[int, int], Spec]:
    """Every element that the model has, in the model's own structure, with its parameters for the initial guess."""
    specs = {}
    for i, row in enumerate(model.elements):
        for j, system in enumerate(row):
            if not system.is_zero:
                structure, values = structure_of(system)
                specs[i, j] = Spec(j, structure, tuple(values))
    return specs


def identify_matrix(
    segments: Sequence[Segment],
    model: TransferMatrix,
    specs: Mapping[tuple[int, int], Spec],
    *,
    confidence: float = 0.95,
    update_interval: float = 0.0,
    timing: float = 0.0,
    tell: Tell | None = None,
    structures: bool = False,
) -> dict[int, OutputEstimate]:
    """The estimate of each output that has elements to estimate and data to do it from.

    `model` (n_y, n_u + n_d) holds the elements that are not in `specs` at their values; those of its zeros that the
    record shows to act are estimated along (`with_missing`). `update_interval` is the time between real updates of
    PV, `timing` the standard error of the instants (`Sampling`). `tell` is told the number of each output
    and what is about to be done with it. With `structures`, those that the record rejects are replaced by richer ones.
    """
    asked = Open(pinned=() if structures else [*np.ndindex(*model.shape)])
    return identify_plant(segments, model, specs, asked, confidence, (update_interval, timing), tell=tell).estimates


def identify_plant(
    segments: Sequence[Segment],
    model: TransferMatrix,
    specs: Mapping[tuple[int, int], Spec],
    asked: Open,
    confidence: float,
    instants: tuple[float, float],
    tell: Tell | None = None,
) -> Identification:
    """`identify_matrix`, and what else `asked` is to be found out.

    `instants` are the update interval and the timing error. Structures that the record rejects are replaced by richer
    ones (`accounts`).
    """
    update_interval, timing = instants
    update = samples_per_update(update_interval, segments[0].h)
    held = {i: _held(model, specs, i) for i in range(model.shape[0])}
    own = {i: [spec for (row, _), spec in sorted(specs.items()) if row == i] for i in held}
    wanted = {i: [j for k, j in asked.wanted if k == i] for i in held}
    own = {i: with_guesses(segments, i, row, wanted[i], held[i], update) for i, row in own.items()}
    everywhere = [spec for row in own.values() for spec in row]
    block = choose_block(segments, everywhere)

    def rows(stride: int) -> list[Row]:
        found = [row_of(segments, i, own[i], held[i], Sampling(stride, update, block)) for i in own]
        return [row for row in found if row is not None]

    stride = within_dead_times(choose_stride(segments, everywhere, update_interval), segments, update, rows)
    sampling = Sampling(stride, update, block, timing)
    known = {*specs, *asked.passed_on}
    absent = [place for place in np.ndindex(*model.shape) if place not in known and model[place].is_zero]
    estimates, again = {}, {}
    absence_p: dict[tuple[int, int], float] = {}
    doubtful: dict[int, tuple[int, ...]] = {}
    for i, row in own.items():
        if tell is not None:
            tell(i, "estimating")
        again[i] = partial(
            identify_output,
            output=i,
            held=held[i],
            confidence=confidence,
            sampling=sampling,
            time_scale=typical_lag(everywhere),
        )
        segments, found = first_estimate(segments, i, row, again[i], asked)
        estimate = estimating(again[i], segments)
        if found is not None and wanted[i]:
            first = shown(found, wanted[i], estimate, len(asked.wanted), confidence)
            absence_p |= {(i, j): p for j, p in first.absence_p.items()}
            found = first.estimate
        if found is not None:
            places = [j for k, j in absent if k == i]
            whole = with_missing(found, places, estimate, len(absent), confidence)
            estimates[i], doubtful[i] = whole.estimate, whole.doubtful
    rivals = Rivals(model, asked, again, len(everywhere), timing == 0, confidence, tell)
    account = rivals.beside_spikes(rivals.likeliest(segments, estimates))
    estimates = account.estimates
    for i, found in estimates.items():
        estimates[i] = with_left_out(found, doubtful[i], estimating(again[i], account.segments), confidence)
    if any(segment.closed for segment in segments):
        estimates = _with_shared_disturbances(estimates, confidence)
    left_out = tuple((i, j) for i, some in doubtful.items() for j in some)
    return Identification(tuple(account.segments), estimates, account.holds, absence_p, left_out)


def _held(model: TransferMatrix, specs: Mapping[tuple[int, int], Spec], i: int) -> list[Held]:
    """The elements of an output that are not estimated, at the model's value."""
    return [Held(j, model[i, j]) for j in range(model.shape[1]) if (i, j) not in specs and not model[i, j].is_zero]


def _with_shared_disturbances(estimates: dict[int, OutputEstimate], confidence: float) -> dict[int, OutputEstimate]:
    """The estimates, with what disturbances that reach several outputs ask for."""
    disturbed = {i: found for i, found in estimates.items() if not free_of_noise(found.fit)}
    predicted = predicted_outputs(disturbed)
    if not predicted and not related_at_once(disturbed):
        return estimates
    joint = together(estimates, confidence)
    for i, others in predicted.items():
        if joint is None:
            estimates[i] = widened_for_shared_disturbance(estimates[i], others, confidence)
        else:
            joint[i] = replace(joint[i], predicted_by=tuple(others))
    return estimates if joint is None else joint
