"""(17) from what of the records is linear: where an OP is at a limit or in manual, loop by loop.

(17) does not read OP. It has the inputs from the law, U = (I + Q Ghat)^-1 Q (F R - E), and an OP at a limit is not what
the law makes of set-point and PV. So the row of an output needs every loop that moves it, with every loop that moves
the PVs which those controllers read, and so on: all loops of a plant in which each acts on the others. From one free
stretch to the next the loop starts anew, as behind any gap. Samples at a limit stay what they are elsewhere: true
inputs of the fit.

Short stretches leave wide windows, and when a loop came to its limit was not chance. With the samples at limits left in
the rounds end at the plant as well, as a wrong law leaves zero mismatch at zero: how far these samples would move a
parameter counts as its error.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from trueplant.arrays import Array
from trueplant.errors import Refused, TrueplantError
from trueplant.loop import Controller
from trueplant.lti import Structure, TransferMatrix
from trueplant.mismatch import LocalFit, fit_locally, period_of
from trueplant.record import Segment
from trueplant.study.methods.agreement import Estimated
from trueplant.study.study import Place, Study


@dataclass(frozen=True)
class Loops:
    """The loops that the rows of some outputs need."""

    outputs: tuple[int, ...]
    inputs: tuple[int, ...]
    rows: tuple[int, ...] = field(compare=False)
    """Those outputs, among `outputs`."""

    def segment(self, segment: Segment) -> Segment:
        y, u = list(self.outputs), list(self.inputs)
        settled = None if segment.settled is None else segment.settled[:, y]
        return replace(
            segment,
            r=segment.r[:, y],
            settled=settled,
            u=segment.u[:, u],
            y=segment.y[:, y],
            free=segment.free[:, u],
            hold=tuple(segment.hold[j] for j in u),
            jumps=(),
            loads=(),
            sent=None,
            stamps=None,
        )

    def model(self, model: TransferMatrix) -> TransferMatrix:
        return TransferMatrix(tuple(tuple(model[i, j] for j in self.inputs) for i in self.outputs), model.time_unit)

    def controller(self, controller: Controller) -> Controller:
        entries = {
            (self.inputs.index(i), self.outputs.index(j)): entry
            for (i, j), entry in controller.entries.items()
            if i in self.inputs
        }
        return Controller(entries, len(self.inputs), len(self.outputs))

    def structures(self, structures: Mapping[Place, Structure]) -> dict[Place, Structure]:
        return {
            (self.outputs.index(i), self.inputs.index(j)): one
            for (i, j), one in structures.items()
            if i in self.outputs
        }


def loops_needed(elements: Collection[Place], controller: Controller) -> tuple[Loops, ...]:
    """By what they need, all outputs of a plant with these elements (output, input) under a controller."""
    every = Loops(tuple(range(controller.n_y)), tuple(range(controller.n_u)), ())
    found: dict[Loops, list[int]] = {}
    for i in range(controller.n_y):
        outputs, inputs, size = {i}, set[int](), 0
        while len(outputs) + len(inputs) > size:
            size = len(outputs) + len(inputs)
            inputs |= {j for row, j in elements if row in outputs}
            outputs |= {j for row, j in controller.entries if row in inputs}
        alone = Loops(tuple(sorted(outputs)), tuple(sorted(inputs)), ())
        found.setdefault(alone if len(outputs) == len(inputs) else every, []).append(i)
    return tuple(replace(loops, rows=tuple(rows)) for loops, rows in found.items())


def closed_form(
    study: Study,
    segments: Sequence[Segment],
    model: TransferMatrix,
    structures: Mapping[Place, Structure],
    controller: Controller,
    or_periods: bool = False,
) -> Estimated:
    """(17) in the free stretches of the loops that each output needs; `or_periods`: from averages where it must.

    Raises TrueplantError or LinAlgError where it tells of no output.
    """
    n_y, n_u = model.shape
    whole = Loops(tuple(range(n_y)), tuple(range(n_u)), tuple(range(n_y)))
    if all(segment.free.all() for segment in segments):
        fit = _fitted(whole, segments, model, structures, controller, or_periods)
        return Estimated(fit.parameters, fit.covariance, fit.response)
    elements = {(i, j) for i in range(n_y) for j in range(n_u) if not model[i, j].is_zero} | structures.keys()
    found, response = Estimated({}, {}), None
    notes: list[str] = []
    refused: list[str] = []
    for loops in loops_needed(elements, controller):
        own = [loops.segment(segment) for segment in segments]
        said = _at_limit(study, loops, own)
        stretches = sum(len(segment.free_spans()) for segment in own)
        try:
            fit = _fitted(loops, own, model, structures, controller, or_periods)
        except (TrueplantError, np.linalg.LinAlgError) as error:
            rows = ", ".join(study.project.output_names[i] for i in loops.rows)
            refused.append(f"of {rows} (17) does not tell{said and f': {said}, and in what is left of it'}: {error}")
            continue
        back = {place: (loops.outputs[place[0]], loops.inputs[place[1]]) for place in fit.parameters}
        answered = {place: there for place, there in back.items() if there[0] in loops.rows}
        parameters = {there: fit.parameters[place] for place, there in answered.items()}
        covariance = {there: fit.covariance[place] for place, there in answered.items()}
        if said:
            more = _by_samples_at_limit(fit, loops, own, model, structures, controller, or_periods)
            covariance = {there: covariance[there] + more[place] for place, there in answered.items()}
        found = Estimated({**found.parameters, **parameters}, {**found.covariance, **covariance})
        response = fit.response if loops == whole else response
        if said:
            notes.append(f"{said}: taken from the rest, {stretches} stretch{'es'[: 2 * (stretches > 1)]}")
    if not found.parameters:
        raise Refused("; ".join(refused))
    return replace(found, response=response, notes=(*notes, *refused))


def _fitted(
    loops: Loops,
    segments: Sequence[Segment],
    model: TransferMatrix,
    structures: Mapping[Place, Structure],
    controller: Controller,
    or_periods: bool,
) -> LocalFit:
    asked = loops.structures(structures), loops.model(model), "closed-form", loops.controller(controller)
    try:
        return fit_locally(segments, *asked)
    except Refused:
        parts = [part for segment in segments for part in segment.free_parts()]
        if not or_periods or not repeat(parts, closed=True):
            raise
        return fit_locally(segments, *asked, periodic=True)


def _by_samples_at_limit(fit: LocalFit, loops: Loops, segments: Sequence[Segment], *asked: Any) -> dict[Place, Array]:
    """Squares of how far the samples at limits would move each element; zero where they tell nothing."""
    whole = [replace(segment, free=np.ones_like(segment.free)) for segment in segments]
    try:
        kept = _fitted(loops, whole, *asked).parameters
    except (TrueplantError, np.linalg.LinAlgError):
        kept = fit.parameters
    return {place: np.outer(p - kept[place], p - kept[place]) for place, p in fit.parameters.items()}


def _at_limit(study: Study, loops: Loops, segments: Sequence[Segment]) -> str:
    """Says of which OPs, and for how much of what there is; empty for none."""
    stuck = 1 - np.concatenate([segment.free for segment in segments]).mean(axis=0)
    named = ", ".join(
        f"OP of {study.project.input_names[j]} was at a limit or in manual for {100 * share:.2g} % of the record"
        for j, share in zip(loops.inputs, stuck, strict=True)
        if share > 0
    )
    return named


def repeat(segments: Sequence[Segment], closed: bool) -> bool:
    """Does what moves any of them repeat with a period?"""
    for segment in segments:
        try:
            period_of(segment.setpoints if closed else segment.u, segment.h)
        except TrueplantError:
            continue
        return True
    return False
