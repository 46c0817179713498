"""Disturbances in an analysis: measured ones taken off the record, declared unmeasured ones estimated along."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import norm

from trueplant.arrays import Array
from trueplant.disturbance import DisturbedFit, Part, Recovered, fit_with_disturbance, likelihood_p, recover
from trueplant.identify import Budget, OutputEstimate
from trueplant.identify.intervals import as_wide_as, normal_intervals
from trueplant.loop import Controller
from trueplant.lti import TransferFunction, TransferMatrix, sampled_response
from trueplant.record import Segment
from trueplant.result import (
    Background,
    Code,
    DeclaredDisturbance,
    DisturbanceFit,
    DisturbanceJump,
    LostInformation,
    Reason,
    Source,
)
from trueplant.study import levels
from trueplant.study.study import Place, Study


@dataclass(frozen=True, eq=False)
class Disturbed:
    """Outputs with a declared unmeasured disturbance: plant and disturbance, and what has to be said of them."""

    fits: Mapping[int, DisturbedFit]
    plant: TransferMatrix
    """(n_y, n_u + n_d) with the elements as these fits found them."""
    recovered: tuple[Recovered, ...]
    """One a segment, in the order given."""
    table: tuple[DisturbanceFit, ...]
    """For result.json."""
    notes: tuple[Reason, ...]


def declared_parts(study: Study) -> dict[int, tuple[Part, ...]]:
    """The declared disturbance of each output that has one."""
    names = study.project.output_names
    parts: dict[int, tuple[Part, ...]] = {}
    for entry in study.project.unmeasured:
        i = names.index(entry.output)
        parts[i] = (*parts.get(i, ()), Part(entry.kind, entry.std, entry.time_constant))
    return parts


def without_measured(
    study: Study, segments: Sequence[Segment], plant: TransferMatrix, controller: Controller | None
) -> list[Segment]:
    """The segments without what the measured disturbances do, Gd d with Gd from the plant (n_y, n_u + n_d)."""
    n_u = len(study.project.inputs)
    if not study.project.disturbances:
        return list(segments)
    measured = plant.columns(n_u)
    return [_without(s, sampled_response(measured, s.d - s.d[0], s.h, s.holds[n_u:]), controller) for s in segments]


def acts_alike(controller: Controller) -> bool:
    """Does the controller act on its set-point as on PV, but for the sign (F = 1, holds apart)?"""
    return all(entry.one_degree for entry in controller.entries.values())


def _without(segment: Segment, v: Array, controller: Controller | None) -> Segment:
    """The segment with v known, as (17) takes it, X = (E - V)(F R - V)^-1: PV less v, and v among what moves the loop.

    Between samples a controller that scans at h sees v at the instants, a continuous one, whose OP is held, in their
    middle. Where set-points act otherwise than PV (F is not 1), or the controller is not known, only PV is cleared: X v
    is then noise in the first round of the estimate, and vanishes as its model becomes the plant and X = 0.
    """
    y = segment.y - v
    if controller is None or not acts_alike(controller):
        return replace(segment, y=y)
    scan = controller.scan
    seen = (
        v if scan is not None and scan > (1 - levels.WHOLE_SCAN) * segment.h else (v + np.vstack([v[1:], v[-1:]])) / 2
    )
    return replace(segment, y=y, r=segment.r - seen, settled=None)


def assumed(study: Study, specs: Collection[Place], estimates: Mapping[int, OutputEstimate]) -> str:
    """What taking measured disturbances off the record rests on, in a sentence; empty without any."""
    n_u = len(study.project.inputs)
    found, kept = [], []
    for i, output in enumerate(study.project.output_names):
        for j, name in enumerate(study.project.disturbance_names, start=n_u):
            if (i, j) in specs and i in estimates:
                found.append(f"{name} -> {output}")
            elif not study.model[i, j].is_zero:
                kept.append(f"{name} -> {output}")
    if not found and not kept:
        return ""
    parts = [f"{', '.join(found)} as the fit estimated it along"] if found else []
    parts += [f"{', '.join(kept)} as declared"] if kept else []
    return (
        f"measured disturbances were taken off PV first: {'; '.join(parts)}. What is wrong in these elements counts as "
        "noise, which holds as long as the disturbance does not move together with the set-points"
    )


def disturbed_fits(study: Study, estimates: Mapping[int, OutputEstimate]) -> dict[int, DisturbedFit]:
    """Plant and declared disturbance together, for each output that has one."""
    return {i: fit_with_disturbance(estimates[i].fit, p) for i, p in declared_parts(study).items() if i in estimates}


def with_jumps(
    study: Study, fits: Mapping[int, DisturbedFit], plant: TransferMatrix, segments: tuple[Segment, ...]
) -> tuple[Segment, ...]:
    """The segments, saying at which samples a declared step was found to jump.

    The fit then gives every jump a level of its own, as it does with an offset.
    """
    if not any(any(fit.jumps) for fit in fits.values()):
        return segments
    recovered = _recovered(study, fits, _plant(plant, fits), segments)
    return tuple(replace(s, jumps=found.jumps) for s, found in zip(segments, recovered, strict=True))


def resting_on(
    estimate: OutputEstimate, fit: DisturbedFit | None, confidence: float, stationary: bool = False
) -> OutputEstimate:
    """The estimate with parameters, intervals and likelihood of the fit that takes the declared disturbance along.

    It stays as it is where that fit does not describe the record, and where it has been widened for what the fit does
    not know: experiments that disagree, disturbances that reach several outputs. Beside a `stationary` disturbance,
    which a noise model can be as well, dead times are known no better than without it.
    """
    known = estimate.predicted_by or estimate.jointly or estimate.disputed
    if fit is None or fit.whiteness_p < levels.MISDESCRIBED or known:
        return estimate
    if not _same_elements(fit, estimate):
        return estimate
    covariance = fit.covariance
    budget = Budget.of(fit.by_background).including(Source.DISTURBANCE, fit.covariance - fit.by_background)
    for source, more in estimate.uncounted.items():
        covariance, budget = covariance + more, budget.including(source, more)
    curved = covariance
    # over a dead time the cost has a minimum in every sample interval, and its curvature in one says too little
    for index in map(int, np.flatnonzero(fit.row.is_dead_time & stationary)):
        without = estimate.covariance
        covariance = as_wide_as(covariance, index, float(without[index, index]), np.sqrt(np.diag(without)))
    budget = budget.including(Source.PROFILE, covariance - curved)
    shift = 0.0 if estimate.runs is None else estimate.runs.shift
    theta = np.clip(fit.theta + shift, *fit.row.bounds())
    intervals = normal_intervals(fit.row, theta, covariance, confidence)
    return replace(
        estimate,
        theta=theta,
        covariance=covariance,
        budget=budget,
        intervals=intervals,
        order_dependence={},
        unprofiled=None,
        beside_ratio=None,
        rise=fit.rise,
    )


def _same_elements(fit: DisturbedFit, estimate: OutputEstimate) -> bool:
    """Are the parameters of both in the same places? Not if an element that the model lacks was taken in meanwhile."""
    own, other = ([(spec.column, spec.structure) for spec in row.specs] for row in (fit.row, estimate.row))
    return own == other


def estimate_disturbed(
    study: Study,
    fits: Mapping[int, DisturbedFit],
    estimates: Mapping[int, OutputEstimate],
    plant: TransferMatrix,
    segments: Sequence[Segment],
) -> Disturbed | None:
    """What the fits with a declared disturbance say, and the disturbance as recovered in the segments."""
    if not fits:
        return None
    whole = _plant(plant, fits)
    recovered = _recovered(study, fits, whole, segments)
    notes = [note for i, fit in fits.items() for note in _notes(study, estimates[i], i, fit)]
    table = tuple(_row(study, i, fit, segments, recovered) for i, fit in fits.items())
    return Disturbed(fits, whole, recovered, table, tuple(notes))


def _plant(plant: TransferMatrix, fits: Mapping[int, DisturbedFit]) -> TransferMatrix:
    """The plant with the elements as these fits found them."""
    rows: list[tuple[TransferFunction, ...]] = []
    for i, elements in enumerate(plant.elements):
        row = list(elements)
        if i in fits:
            for spec, part in zip(fits[i].row.specs, fits[i].row.slices, strict=True):
                row[spec.column] = spec.structure.transfer(fits[i].theta[part])
        rows.append(tuple(row))
    return TransferMatrix(tuple(rows), plant.time_unit)


def _recovered(
    study: Study, fits: Mapping[int, DisturbedFit], plant: TransferMatrix, segments: Sequence[Segment]
) -> tuple[Recovered, ...]:
    noises = {i: fit.noise for i, fit in fits.items()}
    return tuple(recover(s, plant, declared_parts(study), noises) for s in segments)


def without_unmeasured(found: Disturbed, segments: Sequence[Segment], controller: Controller | None) -> list[Segment]:
    """The segments without the declared part of the recovered disturbance."""
    told = list(found.fits)
    cleaned = []
    for segment, recovered in zip(segments, found.recovered, strict=True):
        v = np.zeros(segment.y.shape)
        v[:, told] = np.nan_to_num(recovered.declared[:, told])
        cleaned.append(_without(segment, v, controller))
    return cleaned


def _row(
    study: Study, i: int, fit: DisturbedFit, segments: Sequence[Segment], recovered: Sequence[Recovered]
) -> DisturbanceFit:
    noise = fit.noise
    return DisturbanceFit(
        output=study.project.output_names[i],
        declared=tuple(
            DeclaredDisturbance(p.kind, p.std, p.time_constant, p.std * noise.scale) for p in noise.declared
        ),
        jumps=tuple(
            DisturbanceJump(
                study.project.experiments[segment.experiment].name,
                float(v.t[k]),
                float(v.declared[k, i] - v.declared[k - 1, i]),
            )
            for segment, v in zip(segments, recovered, strict=True)
            for k in v.jumps[i]
        ),
        lost=tuple(
            LostInformation(study.columns[spec.column], name, float(share))
            for spec, part in zip(fit.row.specs, fit.row.slices, strict=True)
            for name, share in zip(spec.structure.names, fit.lost[part], strict=True)
        ),
        background=Background(noise.white, noise.std, noise.time_constant),
        whiteness_p=fit.whiteness_p,
    )


def _notes(study: Study, estimate: OutputEstimate, i: int, fit: DisturbedFit) -> list[Reason]:
    """Where the model as it is, under the declared disturbance, explains the record as well as the change does."""
    level = 1 - study.project.analysis.confidence
    name = study.project.output_names[i]
    notes = []
    plain = np.sqrt(np.diag(estimate.fit.covariance))
    for spec, part in zip(fit.row.specs, fit.row.slices, strict=True):
        if spec.initial is None or not _same_elements(fit, estimate):
            continue
        model = np.array(spec.initial, dtype=float)
        index = np.arange(part.start, part.stop)
        z = np.abs(estimate.fit.theta[index] - model) / np.maximum(plain[index], 1e-300)
        alone = float(np.min(2 * norm.sf(z))) * index.size
        found = likelihood_p(fit, index, model)
        where = f"{study.columns[spec.column]} -> {name}"
        if found > level and alone < level:
            text = "its change is no longer beyond chance once the declared disturbance is estimated along"
        elif found <= level and likelihood_p(fit, index, model, largest=True) > level:
            text = (
                "a disturbance as large as declared explains the record with the old element as well as its change "
                f"does; that it changed rests on the record showing {fit.noise.scale:.2g} of the declared size"
            )
        else:
            continue
        notes.append(
            Reason(
                Code.MISMATCH_OR_DISTURBANCE,
                f"mismatch and disturbance cannot be told apart here: {text}. Set-point moves that are faster or more "
                "frequent than the disturbance would tell them apart",
                where,
            )
        )
    if fit.whiteness_p < levels.MISDESCRIBED:
        notes.append(
            Reason(
                Code.DISTURBANCE_MODEL,
                "the declared disturbance and a first-order background do not describe what acts on this output: the "
                "prediction errors are not white, and the intervals that take it along are too narrow",
                name,
            )
        )
    return notes
