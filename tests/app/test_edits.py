"""What the screens write into a project: just that, with comments, order and line ends as they were."""

from __future__ import annotations

import tomllib
from typing import Any

import pytest

from trueplant.app.screens import edits
from trueplant.errors import ProjectError
from trueplant.project import Project

TEXT = """# our column, by hand
time_unit = "min"   # of all

[data]
files = ["a.csv"]   # the March export
time = "t"
exclude = [
    {from = 1, to = 2},   # a trip
    {from = 5, to = 7},
]

# the top
[[output]]
name = "top"
pv = "pv1"
sp = "sp1"
limits = [0, 100]   # of the transmitter

# its valve
[[input]]
name = "reflux"
op = "op1"
# limits = [0, 100]

# the bottom
[[output]]
name = "bottom"
pv = "pv2"   # an analyser

[[input]]
name = "steam"
op = "op2"

# known from a test
[[model]]
output = "top"
input = "reflux"
tf = "2/(10 s + 1)"

[[model]]
output = "bottom"
input = "steam"
tf = "1/(5 s + 1)"

[[controller]]
input = "steam"
output = "bottom"
form = "ideal"
Kc = 1.0
Ti = 10.0
"""


def said(text: str) -> dict[str, Any]:
    Project.from_toml(text)
    return tomllib.loads(text)


def test_a_key_is_replaced_and_its_comment_stays() -> None:
    after = edits.set_keys(TEXT, "output", "top", {"limits": (0.0, 80.5)})
    assert "limits = [0.0, 80.5]   # of the transmitter" in after
    assert after.replace("[0.0, 80.5]", "[0, 100]") == TEXT


def test_keys_are_added_and_taken_out() -> None:
    after = edits.set_keys(TEXT, "output", "top", {"unit": "degC", "limits": None})
    assert said(after)["output"][0] == {"name": "top", "pv": "pv1", "sp": "sp1", "unit": "degC"}
    assert [line for line in TEXT.splitlines() if "limits = [0, 100]   #" not in line] == [
        line for line in after.splitlines() if "degC" not in line
    ]


def test_modes_that_mean_automatic() -> None:
    after = edits.set_keys(TEXT, "input", "steam", {"mode": "m", "automatic_values": ["AUTO", 2]})
    assert said(after)["input"][1]["automatic_values"] == ["AUTO", 2]


def test_entries_in_one_line() -> None:
    text = 'time_unit = "s"\noutput = [{name = "y", pv = "a"}]\ninput = [{name = "u", op = "b"}]\n'
    after = edits.set_keys(text, "output", "y", {"sp": "c"})
    assert said(after)["output"] == [{"name": "y", "pv": "a", "sp": "c"}]
    more = edits.add_loop(after, {"name": "z", "pv": "d"}, {"name": "v", "op": "e"})
    assert [entry["name"] for entry in said(more)["output"]] == ["y", "z"]
    assert edits.remove_loop(more, "z", "v") == after


def test_an_entry_that_is_gone_is_said() -> None:
    with pytest.raises(ProjectError, match="load the page again"):
        edits.set_keys(TEXT, "output", "middle", {"unit": "%"})


def test_keys_of_the_data() -> None:
    after = edits.set_data(TEXT, {"time_zone": "Europe/Oslo", "time": None})
    assert said(after)["data"]["time_zone"] == "Europe/Oslo"
    assert "time" not in said(after)["data"]
    assert '["a.csv"]   # the March export' in after and "# a trip" in after


def test_a_loop_is_added_behind_the_others_and_removed_with_all_that_names_it() -> None:
    more = edits.add_loop(TEXT, {"name": "side", "pv": "pv3", "sp": "sp3"}, {"name": "gas", "op": "op3"})
    tables = said(more)
    assert [entry["name"] for entry in tables["output"]] == ["top", "bottom", "side"]
    assert more.index("steam") < more.index("gas") < more.index("# known from a test")
    assert said(edits.remove_loop(more, "side", "gas")) == said(TEXT)
    less = edits.remove_loop(TEXT, "bottom", "steam")
    assert [entry["name"] for entry in said(less)["input"]] == ["reflux"]
    assert "controller" not in said(less) and [e["output"] for e in said(less)["model"]] == ["top"]
    assert "# known from a test" in less and "# the top" in less and "# its valve" in less


def test_measured_disturbances() -> None:
    more = edits.add_disturbance(TEXT, {"name": "feed", "column": "FI1", "unit": "t/h"})
    assert said(more)["disturbance"] == [{"name": "feed", "column": "FI1", "unit": "t/h"}]
    assert said(edits.remove_disturbance(more, "feed")) == said(TEXT)


@pytest.mark.parametrize("newline", ["\n", "\r\n"])
def test_stretches_are_excluded_and_included(newline: str) -> None:
    text = TEXT.replace("\n", newline)
    more = edits.exclude(text, [{"from": 11.5, "to": 20}])
    assert said(more)["data"]["exclude"][2] == {"from": 11.5, "to": 20}
    assert ("\n" in more.replace("\r\n", "")) == (newline == "\n")
    back = edits.include(more, 2)
    assert said(back) == said(text) and "# a trip" in back
    none = edits.include(edits.include(back, 1), 0)
    assert "exclude" not in said(none)["data"]


def test_stretches_in_tables_of_their_own() -> None:
    text = TEXT.replace(TEXT[TEXT.index("exclude") : TEXT.index("# the top")], "\n")
    text += "\n# a trip\n[[data.exclude]]\nfrom = 1\nto = 2\n\n# cleaning\n[[data.exclude]]\nfrom = 5\nto = 6\n"
    assert said(edits.include(text, 0))["data"]["exclude"] == [{"from": 5, "to": 6}]
    assert "# cleaning" in edits.include(text, 0)
    assert len(said(edits.exclude(text, [{"from": 8, "to": 9}]))["data"]["exclude"]) == 3
    with pytest.raises(ProjectError, match="not excluded any more"):
        edits.include(text, 2)
