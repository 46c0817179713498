"""A black box of the same records as second opinion: does a plant lie where the data say, whoever estimated it?"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from trueplant.arrays import Array
from trueplant.errors import TrueplantError
from trueplant.identify.subspace import SubspaceModel, subspace
from trueplant.lti import TransferMatrix
from trueplant.record import Segment


@dataclass(frozen=True, eq=False)
class Opinion:
    """What the vector ARX model of the records, which knows neither structure nor controller, says of plants."""

    p_values: Mapping[str, Array]
    """For each plant that could be tested (n_y, n_u): small where the element does not lie where the data say."""
    refused: str = ""
    """Why a plant, or any, could not be tested."""
    black_box: SubspaceModel | None = None
    """The closed-loop subspace model, and the ARX model that it reduces (`first`)."""


def second_opinion(segments: Sequence[Segment], plants: Mapping[str, TransferMatrix]) -> Opinion:
    """Hold each plant (n_y, n_u) against one black box of all outputs; one that is too slow for it is left out."""
    try:
        black_box = subspace(segments)
    except (TrueplantError, np.linalg.LinAlgError) as error:
        return Opinion({}, str(error))
    tests: dict[str, Array] = {}
    refused: dict[str, str] = {}
    for name, plant in plants.items():
        try:
            tests[name] = black_box.first.test(plant, segments[0].holds[: plant.shape[1]])[0]
        except TrueplantError as error:
            refused[name] = str(error)
    if not tests:
        return Opinion({}, next(iter(refused.values()), ""), black_box)
    return Opinion(tests, "; ".join(f"{name}: {why}" for name, why in refused.items()), black_box)
