"""Records that were sampled at odd instants, as if they had been sampled on the grid."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial

from trueplant.identify import OutputEstimate, as_if_sampled_on_the_grid, held_or_straight
from trueplant.record import with_held_disturbances
from trueplant.study import levels
from trueplant.study.plant.updated import updated_plant
from trueplant.study.study import Study

Estimates = Mapping[int, OutputEstimate]
"""By output."""


def on_the_grid(study: Study, estimate: Callable[[Study], Estimates]) -> Study:
    """The study without what the grid makes of PV, measured disturbances running as is likelier where nobody said how.

    Their instants stay uncertain by half a sample where the likelihood leaves that open.
    """
    if all(segment.stamps is None for segment in study.segments):
        return study
    straight, some = _corrected(study, estimate), study.undeclared_holds
    if not some:
        return straight
    as_held = study.with_segments(lambda own: tuple(with_held_disturbances(one, some) for one in own))
    held = _corrected(as_held, estimate)
    found = held_or_straight(estimate(held), estimate(straight))
    if found is None:
        return straight
    return held if found else straight.with_segments(lambda own: tuple(replace(one, d_timing=()) for one in own))


def _corrected(study: Study, estimate: Callable[[Study], Estimates]) -> Study:
    """The first estimate is off by all that the grid does, and what is taken off PV for it by a part of that; so it is
    done again."""
    corrected = study
    for _ in range(levels.CORRECTIONS):
        plant = updated_plant(study.model, estimate(corrected)).nominal
        corrected = study.with_segments(partial(as_if_sampled_on_the_grid, plant=plant))
    return corrected
