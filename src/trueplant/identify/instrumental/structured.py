"""A start for the fit through named structures where no model gives one: SRIVC, whose problems are linear."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from trueplant.errors import FormulaError, LoopError, Refused
from trueplant.identify.instrumental.open_loop import srivc
from trueplant.identify.instrumental.order import Order
from trueplant.identify.predict import Spec
from trueplant.record.types import Segment


def started(segments: Sequence[Segment], output: int, specs: Sequence[Spec]) -> tuple[Spec, ...]:
    """The elements of one output, each with SRIVC's estimate as its start where it had none.

    A search that begins with the wrong sign of a lead or far from a resonance ends in a minimum of its own; SRIVC
    estimates the coefficients of numerator and denominator, in which there is no sign to get wrong. Elements whose
    poles come out of another kind than the structure asks for keep having no start, as do all where SRIVC fails.
    """
    if all(spec.start is not None for spec in specs):
        return tuple(specs)
    try:
        fit = srivc(segments, output, [Order.of(spec.column, spec.structure) for spec in specs])
    except (Refused, LoopError, np.linalg.LinAlgError):
        return tuple(specs)
    found = []
    for k, spec in enumerate(specs):
        if spec.start is None:
            try:
                value, _ = fit.as_structure(spec.structure, k)
                spec = replace(spec, start=tuple(float(x) for x in value))
            except FormulaError:
                pass
        found.append(spec)
    return tuple(found)
