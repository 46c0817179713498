"""Does the plant as estimated lie in the band of the non-parametric estimate: for result.json and the notes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from trueplant.detect import holm
from trueplant.lti import TransferMatrix
from trueplant.mismatch import FrequencyResponse, speaking_band
from trueplant.mismatch.band import within_band
from trueplant.study.nonparametric import label_of
from trueplant.study.result import Reason

if TYPE_CHECKING:
    from trueplant.study.pipeline import Study

SIGNIFICANT = 0.01
"""Of a plant outside the band, over the whole matrix."""


def band_test(
    study: Study, plant: TransferMatrix, response: FrequencyResponse | None
) -> tuple[list[dict[str, Any]], list[Reason]]:
    """One row an estimated element that the response says something of, and a note for each outside of its band."""
    if response is None:
        return [], []
    n_u = len(study.project.inputs)
    inputs = TransferMatrix(tuple(row[:n_u] for row in plant.elements), plant.time_unit)
    test = within_band(response, inputs)
    places = [place for place in sorted(study.specs) if place[1] < n_u and np.isfinite(test.p_value[place])]
    speaks = speaking_band(response)
    rows, notes = [], []
    for place, adjusted in zip(places, holm([test.p_value[place] for place in places]), strict=True):
        i, j = place
        within = bool(adjusted >= SIGNIFICANT)
        row = {
            "output": study.project.output_names[i],
            "input": study.project.input_names[j],
            "p_value": float(test.p_value[place]),
            "p_adjusted": float(adjusted),
            "within": within,
            "worst_frequency": float(test.worst[place]),
            "speaks": speaks[i][j],
            "by": label_of(response),
        }
        rows.append(row)
        if not within:
            notes.append(
                Reason(
                    "outside-band",
                    "the plant as estimated lies outside of the band of the estimate that assumes no structure, most "
                    f"of all at {row['worst_frequency']:.3g} rad/{study.project.time_unit}: the structure "
                    f"{study.specs[place].structure} is too simple for this element, or the plant is not linear",
                    f"{row['input']} -> {row['output']}",
                )
            )
    return rows, notes
