"""trueplant init: loops are recognised from column names, and what it writes is a project."""

from __future__ import annotations

import pytest

import trueplant as tp
from trueplant.project.guess import guess_loops, guess_project, guess_time

NAMINGS = {
    "numbered": (["t", "sp1", "sp2", "op1", "op2", "pv1", "pv2"], [("pv1", "op1", "sp1"), ("pv2", "op2", "sp2")]),
    "tags with dots": (["Time", "FIC101.SP", "FIC101.PV", "FIC101.MV"], [("FIC101.PV", "FIC101.MV", "FIC101.SP")]),
    "tags with underscores": (["date", "TIC_7_PV", "TIC_7_OP"], [("TIC_7_PV", "TIC_7_OP", None)]),
    "slashes and case": (["x", "Area/LC1/pv", "Area/LC1/op"], [("Area/LC1/pv", "Area/LC1/op", None)]),
    "one loop": (["time", "op", "pv", "sp", "mode"], [("pv", "op", "sp")]),
    "words": (["Zeit", "setpoint", "output", "measured"], [("measured", "output", "setpoint")]),
    "two-word set-point": (["t", "set-point 1", "pv 1", "op 1"], [("pv 1", "op 1", "set-point 1")]),
}


@pytest.mark.parametrize(("columns", "loops"), NAMINGS.values(), ids=NAMINGS)
def test_loops_are_recognised(columns, loops):
    assert [(loop.pv, loop.op, loop.sp) for loop in guess_loops(columns)] == loops


@pytest.mark.parametrize(("columns", "loops"), NAMINGS.values(), ids=NAMINGS)
def test_guess_is_a_project_with_every_element_asked_for(columns, loops):
    project = tp.Project.from_toml(guess_project("data.csv", columns))
    assert project.data.files == ["data.csv"]
    assert project.data.time == columns[0]
    assert [o.pv for o in project.outputs] == [pv for pv, _, _ in loops]
    n = len(loops)
    assert all(project.estimate(i, j) for i in range(n) for j in range(n))


def test_units_of_the_file_are_taken_over():
    project = tp.Project.from_toml(guess_project("d.csv", ["t", "pv", "op"], {"pv": "degC"}))
    assert (project.outputs[0].unit, project.inputs[0].unit) == ("degC", "")


def test_time_is_found_by_name_before_place():
    assert guess_time(["pv", "Timestamp", "op"]) == "Timestamp"
    assert guess_time(["t [s]", "pv"]) == "t [s]"


def test_columns_without_a_loop_are_refused():
    with pytest.raises(tp.DataError, match=r"no pair of PV and OP.*a, b"):
        guess_project("d.csv", ["a", "b"])


def test_transmitter_and_controller_tags_of_one_loop_belong_together():
    loops = guess_loops(["t", "TI101.PV", "TIC101.SP", "TIC101.OP", "FT7.PV", "FIC7.OP"])
    assert [(loop.pv, loop.op, loop.sp) for loop in loops] == [
        ("TI101.PV", "TIC101.OP", "TIC101.SP"),
        ("FT7.PV", "FIC7.OP", None),
    ]
