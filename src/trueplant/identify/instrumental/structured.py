"""An initial guess for the fit of structures with leads: SRIVC, whose problems are linear in the coefficients."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from trueplant.errors import FormulaError, LoopError, Refused
from trueplant.identify.instrumental.open_loop import srivc
from trueplant.identify.instrumental.order import Order
from trueplant.identify.row import Held, Spec
from trueplant.record.types import Segment


def with_initial_guess(
    segments: Sequence[Segment], output: int, specs: Sequence[Spec], held: Sequence[Held] = ()
) -> tuple[Spec, ...]:
    """The elements of one output, those with leads with SRIVC's estimate as their initial guess.

    A search that begins with the wrong sign of a lead, or with a lead that is far too short, ends in a minimum of its
    own; SRIVC estimates the coefficients of numerator and denominator, in which there is no sign to get wrong.
    Elements without leads need no such guess. Those whose poles come out of another kind than the structure asks for
    stay as they are, as do all where SRIVC fails.
    """
    if not any(spec.structure.leads for spec in specs):
        return tuple(specs)
    try:
        fit = srivc(segments, output, [Order.of(spec.column, spec.structure) for spec in specs], held=held)
    except (Refused, LoopError, np.linalg.LinAlgError):
        return tuple(specs)
    found = []
    for k, spec in enumerate(specs):
        if spec.structure.leads:
            try:
                value, _ = fit.as_structure(spec.structure, k)
                spec = replace(spec, guess=tuple(float(x) for x in value))
            except FormulaError:
                pass
        found.append(spec)
    return tuple(found)
