"""Parts of a result that are shown whole go by the names of result.json."""

from __future__ import annotations

import math

import pytest

from trueplant.report import walk
from trueplant.result import Exclusion, FitRow


def test_a_class_is_walked_one_level_by_the_names_of_its_json():
    cut = Exclusion(1.0, math.nan, "all", "spike")
    assert walk.is_record(cut) and list(walk.entries(cut)) == ["from", "to", "signal", "reason"]
    row = FitRow("y", "run", 80.0, 90.0)
    assert walk.entries(row) == {
        "output": "y",
        "experiment": "run",
        "fit_percent_model": 80.0,
        "fit_percent_plant": 90.0,
        "validation": None,
    }


def test_records_are_a_table_with_every_entry_that_any_of_them_has():
    table = walk.as_table([{"output": "y"}, {"output": "z", "p, white": 0.5}])
    assert table == walk.Table(("Output", "p, white"), (("y", None), ("z", 0.5)))


@pytest.mark.parametrize("value", [None, math.nan, math.inf])
def test_what_is_null_in_json_is_missing(value):
    assert walk.is_missing(value) and not walk.is_missing(0.0)
    assert walk.is_spans(((0.0, 1.0),)) and not walk.is_spans(((0.0, value),))
