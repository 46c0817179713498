"""All outputs of a plant estimated, and what disturbances that reach several of them do to that."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from trueplant.identify.estimate import Options
from trueplant.identify.first import regulating_or_not, shown, with_guesses, with_left_out
from trueplant.identify.holds import FoundHold, find_holds, held_fits, with_holds
from trueplant.identify.loads import Fits, criterion, find_loads, with_loads
from trueplant.identify.missing import with_missing
from trueplant.identify.output import OutputEstimate, identify_output
from trueplant.identify.pieces import Held
from trueplant.identify.row import Spec
from trueplant.identify.shared_disturbance import (
    predicted_outputs,
    related_at_once,
    together,
    widened_for_shared_disturbance,
)
from trueplant.identify.strides import Sampling, choose_block, choose_stride, samples_per_update, typical_lag
from trueplant.identify.structures import Again, with_structures
from trueplant.lti.structure import structure_of
from trueplant.lti.transfer import TransferMatrix
from trueplant.record.types import Segment


@dataclass(frozen=True)
class Open:
    """What the estimates are to find out besides the parameters."""

    holds: Sequence[int] = ()
    """Columns of measured disturbances of which nobody said how they run between samples."""
    pinned: Collection[tuple[int, int]] = ()
    """Elements that keep their structure, whatever the record says."""
    loads: bool = True
    """Steps that nobody recorded; not where a disturbance is declared that would do what they do."""
    wanted: Collection[tuple[int, int]] = ()
    """Elements of which nobody said whether they are there."""
    drawn: Collection[int] = ()
    """Outputs that a historian filled in between few samples: its lines would pass for a structure."""


@dataclass(frozen=True, eq=False)
class Identification:
    """The estimates, and what they found out besides the parameters."""

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


Tell = Callable[[int, str], None]
"""Is told what is being done, such as "estimating", and with which output."""


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

    Holds are found before structures are tested: what they leave in the prediction errors would pass for dynamics that
    the structure lacks. So would loads, and dynamics for loads: the likelier of both accounts of the record is taken.
    `instants` are the update interval and the timing error. Structures that the record rejects are replaced by richer
    ones.
    """
    update_interval, timing = instants
    update = samples_per_update(update_interval, segments[0].h)
    held = {i: _held(model, specs, i) for i in range(model.shape[0])}
    own = {i: [spec for (row, _), spec in sorted(specs.items()) if row == i] for i in held}
    wanted = {i: [j for k, j in asked.wanted if k == i] for i in held}
    own = {i: with_guesses(segments, i, row, wanted[i], held[i], update) for i, row in own.items()}
    everywhere = [spec for row in own.values() for spec in row]
    sampling = Sampling(
        stride=choose_stride(segments, everywhere, update_interval),
        update=update,
        block=choose_block(segments, everywhere),
        timing=timing,
    )
    absent = [place for place in np.ndindex(*model.shape) if place not in specs and model[place].is_zero]
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
        estimate = partial(_estimated, again[i], segments)
        found = estimate(row)
        if found is not None and wanted[i]:
            first = shown(found, wanted[i], estimate, len(asked.wanted), confidence)
            absence_p |= {(i, j): p for j, p in first.absence_p.items()}
            found = first.estimate
        if found is not None:
            places = [j for k, j in absent if k == i]
            whole = with_missing(found, places, estimate, len(absent), confidence)
            estimates[i], doubtful[i] = whole.estimate, whole.doubtful
    rest = _Rest(model, asked, again, len(everywhere), timing == 0, confidence, tell)
    account = rest.of(segments, estimates)
    if asked.loads and (loaded := find_loads({i: found.fit for i, found in estimates.items()})):
        segments = with_loads(segments, loaded)
        beside = rest.of(segments, {**estimates, **rest.started(loaded, segments)})
        account = min(account, beside, key=lambda one: criterion({i: one.estimates[i].fit for i in loaded}))
    estimates = account.estimates
    for i, found in estimates.items():
        estimates[i] = with_left_out(found, doubtful[i], partial(_estimated, again[i], account.segments), confidence)
    if any(segment.closed for segment in segments):
        estimates = _with_shared_disturbances(estimates, confidence)
    left_out = tuple((i, j) for i, some in doubtful.items() for j in some)
    return Identification(estimates, account.holds, absence_p, left_out)


@dataclass(frozen=True, eq=False)
class _Account:
    """Of a record: estimates whose structures suffice, and how measured disturbances run between samples."""

    segments: Sequence[Segment]
    estimates: dict[int, OutputEstimate]
    holds: dict[int, FoundHold]


@dataclass(frozen=True, eq=False)
class _Rest:
    """What is found out beside loads that are known, or beside none."""

    model: TransferMatrix
    asked: Open
    again: Mapping[int, Callable[..., OutputEstimate | None]]
    tested: int
    """Elements of the whole matrix."""
    timely: bool
    """Does OP act at the instants recorded? What it did in between would pass for a structure."""
    confidence: float
    tell: Tell | None

    def of(self, segments: Sequence[Segment], estimates: Mapping[int, OutputEstimate]) -> _Account:
        holds = find_holds(estimates, self.model, self.asked.holds)
        segments = with_holds(segments, holds)
        out = {**estimates, **self.started(held_fits(holds), segments)}
        for i in [i for i in out if self.timely and i not in self.asked.drawn]:
            if self.tell is not None:
                self.tell(i, "testing structures of")
            estimate = partial(_estimated, self.again[i], segments)
            out[i] = _structured(out[i], i, self.asked, estimate, self.tested, self.confidence)
        return _Account(segments, out, holds)

    def started(self, fits: Fits, segments: Sequence[Segment]) -> dict[int, OutputEstimate]:
        """Estimates from these fits on."""
        every = {i: _estimated(self.again[i], segments, fit.row.specs, Options(start=fit)) for i, fit in fits.items()}
        return {i: found for i, found in every.items() if found is not None}


def _held(model: TransferMatrix, specs: Mapping[tuple[int, int], Spec], i: int) -> list[Held]:
    """The elements of an output that are not estimated, at the model's value."""
    return [Held(j, model[i, j]) for j in range(model.shape[1]) if (i, j) not in specs and not model[i, j].is_zero]


def _structured(
    found: OutputEstimate, i: int, asked: Open, estimate: Again, tested: int, confidence: float
) -> OutputEstimate:
    """The estimate with structures that suffice: where nobody said one, whether it integrates is asked first."""
    pinned = [j for k, j in asked.pinned if k == i]
    for spec in found.row.specs:
        if (i, spec.column) in asked.wanted and spec.column not in pinned:
            found = regulating_or_not(found, spec.column, estimate, confidence)
    found = with_structures(found, estimate, tested, confidence, pinned)
    there = {spec.column for spec in found.row.specs}
    return with_left_out(found, [j for k, j in asked.wanted if k == i and j not in there], estimate, confidence)


def _estimated(
    estimate: Callable[..., OutputEstimate | None],
    segments: Sequence[Segment],
    specs: Sequence[Spec],
    options: Options | None = None,
) -> OutputEstimate | None:
    return estimate(segments, specs=specs, options=options)


def _with_shared_disturbances(estimates: dict[int, OutputEstimate], confidence: float) -> dict[int, OutputEstimate]:
    """The estimates, with what disturbances that reach several outputs ask for."""
    predicted = predicted_outputs(estimates)
    if not predicted and not related_at_once(estimates):
        return estimates
    joint = together(estimates, confidence)
    for i, others in predicted.items():
        if joint is None:
            estimates[i] = widened_for_shared_disturbance(estimates[i], others, confidence)
        else:
            joint[i] = replace(joint[i], predicted_by=tuple(others))
    return estimates if joint is None else joint
