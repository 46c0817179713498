"""Records that were sampled at odd instants, as if they had been sampled on the grid."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial

import numpy as np

from trueplant.identify import OutputEstimate, as_if_sampled_on_the_grid, held_or_straight
from trueplant.record import Segment, with_held_disturbance, with_known_instants
from trueplant.study import levels
from trueplant.study.plant.updated import updated_plant
from trueplant.study.study import Study

Estimates = Mapping[int, OutputEstimate]
"""By output."""


def on_the_grid(study: Study, estimate: Callable[[Study], Estimates]) -> Study:
    """The study without what the grid makes of PV, measured disturbances running as is likelier where nobody said how.

    Each is asked by itself, and again beside what was found of the others. The instants of one of which the likelihood
    leaves that open stay uncertain by half a sample.
    """
    if all(segment.stamps is None for segment in study.segments):
        return study
    (corrected, estimates), left = _corrected(study, estimate), list(study.undeclared_holds)
    asked = list(left)
    while asked:
        k = asked.pop(0)
        as_held = _each(study, partial(with_held_disturbance, k=k))
        held = _corrected(as_held, estimate)
        found = held_or_straight(held[1], estimates)
        if found is None:
            continue
        left.remove(k)
        if found:
            study, (corrected, estimates), asked = as_held, held, list(left)
        else:
            known = partial(with_known_instants, k=k)
            study, corrected = _each(study, known), _each(corrected, known)
    return corrected


def _each(study: Study, changed: Callable[[Segment], Segment]) -> Study:
    return study.with_segments(lambda own: tuple(map(changed, own)))


def _corrected(study: Study, estimate: Callable[[Study], Estimates]) -> tuple[Study, Estimates]:
    """With the estimates from it.

    The first estimate is off by all that the grid does, and what is taken off PV for it by a part of that, in turn to
    one side and the other; so it is done again until nothing moves.
    """
    corrected, found = study, estimate(study)
    for _ in range(levels.CORRECTIONS):
        plant = updated_plant(study.model, found).nominal
        corrected = study.with_segments(partial(as_if_sampled_on_the_grid, plant=plant))
        before, found = found, estimate(corrected)
        if _settled(before, found):
            break
    return corrected, found


def _settled(before: Estimates, after: Estimates) -> bool:
    """Has no parameter moved by more than a small part of what the likelihood leaves of it?"""
    return all(
        i in before
        and before[i].theta.size == one.theta.size
        and np.all(np.abs(one.theta - before[i].theta) <= levels.CORRECTED * np.sqrt(np.diag(one.fit.covariance)))
        for i, one in after.items()
    )
