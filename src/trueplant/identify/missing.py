"""Elements that the model lacks and the record shows: prediction errors that follow an input give them away.

An input left out does not only go unseen: where the controllers tie it to the others, their elements take on
what it does, and are confidently wrong.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from trueplant.identify import levels
from trueplant.identify.likelihood import absence_p
from trueplant.identify.output import OutputEstimate
from trueplant.identify.row import Spec
from trueplant.lti.structure import Structure

STRUCTURE = Structure.parse("fopdt")


def with_missing(
    estimate: OutputEstimate,
    absent: Sequence[int],
    again: Callable[[Sequence[Spec]], OutputEstimate | None],
    tested: int,
) -> OutputEstimate:
    """The estimate, with first-order elements from those of the `absent` columns that the record shows to act.

    `again` estimates the row with other elements. An element is taken in if the prediction errors follow its input,
    and stays if the fit with it is better than a search in noise would make it. `tested` is the number of absent
    elements in the whole matrix.
    """
    left = list(absent)
    while left:
        p = [float(estimate.tests.cross_p[column]) for column in left]
        column = left.pop(int(np.argmin(p)))
        if min(p) * tested >= levels.MISSING_ELEMENT:
            break
        specs = sorted([*estimate.row.specs, Spec(column, STRUCTURE)], key=lambda spec: spec.column)
        wider = again(specs)
        place = [spec.column for spec in specs].index(column)
        if wider is not None and absence_p(wider.fit, place) * tested < levels.MISSING_ELEMENT:
            estimate = wider
    return estimate
