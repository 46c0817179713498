"""The step responses in the matrix at the head of a report."""

from __future__ import annotations

import dataclasses
import re

import numpy as np
import pytest

from support.report_sample import sample
from trueplant.report.cells import step_cells

END = re.compile(r'class="(plant|model)" points="[^"]* (?P<x>[\d.]+),(?P<y>[\d.]+)"')


@pytest.fixture(scope="module")
def curves():
    return sample(experiments=1).curves


def last(drawn: str) -> dict[str, tuple[float, float]]:
    """Where plant and model end; y grows downwards."""
    return {one[1]: (float(one["x"]), float(one["y"])) for one in END.finditer(drawn)}


def test_each_element_is_drawn_to_its_scale_until_it_rests(curves):
    cells = step_cells(curves)
    for (output, name), drawn in cells.items():
        at = np.s_[:, curves.outputs.index(output), curves.inputs.index(name)]
        ends = last(drawn)
        assert ends["plant"][0] == pytest.approx(157.0)
        higher = curves.step_plant[at][-1] > curves.step_model[at][-1]
        assert (ends["plant"][1] < ends["model"][1]) == higher
        assert drawn.count("<polygon") == 1 and curves.time_unit in drawn
    assert len(cells) == sum(
        bool(np.ptp(curves.step_plant[:, i, j]) > 0)
        for i in range(len(curves.outputs))
        for j in range(len(curves.inputs))
    )


def test_what_has_no_response_is_not_drawn(curves):
    still = dataclasses.replace(
        curves, step_model=0 * curves.step_model, step_plant=np.full_like(curves.step_plant, np.nan)
    )
    assert step_cells(still) == {}
