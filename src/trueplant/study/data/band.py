"""Does the plant as estimated lie in the band of the non-parametric estimate: for result.json and the notes."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from trueplant.detect import holm
from trueplant.identify import Spec
from trueplant.lti import TransferMatrix
from trueplant.mismatch import FrequencyResponse, speaking_band
from trueplant.mismatch.band import within_band
from trueplant.result import BandTest, Code, Reason
from trueplant.study import levels
from trueplant.study.data.nonparametric import label_of
from trueplant.study.study import Place, Study


def band_test(
    study: Study, specs: Mapping[Place, Spec], plant: TransferMatrix, response: FrequencyResponse | None
) -> tuple[tuple[BandTest, ...], tuple[Reason, ...]]:
    """One row an estimated element that the response says something of, and a note for each outside of its band."""
    if response is None:
        return (), ()
    test = within_band(response, plant.columns(0, study.n_u))
    places = [place for place in sorted(specs) if place[1] < study.n_u and np.isfinite(test.p_value[place])]
    speaks = speaking_band(response, plant.columns(0, study.n_u))
    rows, notes = [], []
    for place, adjusted in zip(places, holm([test.p_value[place] for place in places]), strict=True):
        i, j = place
        within = bool(adjusted >= levels.OUTSIDE_BAND)
        row = BandTest(
            output=study.project.output_names[i],
            input=study.project.input_names[j],
            p_value=float(test.p_value[place]),
            p_adjusted=float(adjusted),
            within=within,
            worst_frequency=float(test.worst[place]),
            speaks=speaks[i][j],
            by=label_of(response),
        )
        rows.append(row)
        if not within:
            notes.append(
                Reason(
                    Code.OUTSIDE_BAND,
                    "the plant as estimated lies outside of the band of the estimate that assumes no structure, most "
                    f"of all at {row.worst_frequency:.3g} rad/{study.project.time_unit}: the structure "
                    f"{specs[place].structure} is too simple for this element, or the plant is not linear",
                    f"{row.input} -> {row.output}",
                )
            )
    return tuple(rows), tuple(notes)
