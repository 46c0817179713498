"""trueplant init: loops are recognised from column names, and what it writes is a project."""

from __future__ import annotations

import re
import tomllib

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import trueplant as tp
from trueplant.project.draft import draft_project
from trueplant.project.guess import (
    Seen,
    guess_counted_unit,
    guess_disturbances,
    guess_loops,
    guess_time,
    guess_time_unit,
)
from trueplant.project.tags import meaning_of

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
    project = tp.Project.from_toml(draft_project("data.csv", Seen(tuple(columns))))
    assert project.data.files == ["data.csv"]
    assert project.data.time == columns[0]
    assert [o.pv for o in project.outputs] == [pv for pv, _, _ in loops]
    n = len(loops)
    assert all(project.estimate(i, j) for i in range(n) for j in range(n))


def test_units_of_the_file_are_taken_over():
    project = tp.Project.from_toml(draft_project("d.csv", Seen(tuple(["t", "pv", "op"]), units={"pv": "degC"})))
    assert (project.outputs[0].unit, project.inputs[0].unit) == ("degC", "")


def test_time_is_found_by_name_before_place():
    assert guess_time(["pv", "Timestamp", "op"]) == "Timestamp"
    assert guess_time(["t [s]", "pv"]) == "t [s]"


def test_columns_without_a_loop_are_refused():
    with pytest.raises(tp.DataError, match=r"no pair of PV and OP.*a, b"):
        draft_project("d.csv", Seen(tuple(["a", "b"])))


def test_transmitter_and_controller_tags_of_one_loop_belong_together():
    loops = guess_loops(["t", "TI101.PV", "TIC101.SP", "TIC101.OP", "FT7.PV", "FIC7.OP"])
    assert [(loop.pv, loop.op, loop.sp) for loop in loops] == [
        ("TI101.PV", "TIC101.OP", "TIC101.SP"),
        ("FT7.PV", "FIC7.OP", None),
    ]


def test_no_two_signals_get_the_same_name():
    columns = ["t", "pv", "op", "pv1", "op1", "A.B.PV", "A.B.OP", "AB.PV", "AB.OP"]
    project = tp.Project.from_toml(draft_project("d.csv", Seen(tuple(columns))))
    assert project.output_names == ("y1", "y1_2", "ab_pv", "ab_4_pv")
    assert project.input_names == ("u1", "u1_2", "ab_op", "ab_4_op")


HOSTILE = (
    "a\n[[model]]\n",
    "a\r\nseed = 1",
    'a"\ntime_unit = "h"\n#',
    "a'''\n",
    '"""\nb = 1',
    "\\",
    "\\n",
    "\x00\x07\x1f\x7f",
    "a\x85b",
    "a\u2028b = 1",
    "# a",
    "a]",
    "{x}",
    "${x}",
    "é °C",
)


def shape(project: tp.Project) -> list[object]:
    """What the file declares, without the names in it."""
    tables = tomllib.loads(project.to_toml())
    return [
        tables.keys(),
        tables["data"].keys(),
        *([e.keys() - {"kind"} for e in tables[k]] for k in ("output", "input")),
    ]


PLAIN = shape(
    tp.Project.from_toml(draft_project("d.csv", Seen(tuple(["t", "spare", "a.pv", "a.op"]), units={"a.pv": "degC"})))
)


def declares(file: str, columns: list[str], unit: str) -> None:
    time, _, pv, op = columns
    project = tp.Project.from_toml(draft_project(file, Seen(tuple(columns), units={pv: unit})))
    assert shape(project) == PLAIN
    assert project.data.files == [file]
    assert project.data.time == time
    assert (project.outputs[0].pv, project.outputs[0].unit, project.inputs[0].op) == (pv, unit, op)
    assert project.estimate(0, 0)


@pytest.mark.parametrize("text", HOSTILE)
def test_names_never_become_part_of_the_file(text):
    declares(f"{text}.csv", ["t", f"{text} spare", f"{text}.pv", f"{text}.op"], text)
    declares(text, ["time", text, "pv", "op"], text)


@settings(max_examples=100, deadline=None)
@given(st.lists(st.text(st.characters(exclude_categories=["Cs"]), min_size=1, max_size=12), min_size=3, max_size=3))
def test_any_name_is_quoted(texts):
    loop, file, unit = texts
    declares(file, ["t", f"{loop}\nnot a signal", f"{loop}.pv", f"{loop}.op"], unit)


def test_what_is_not_used_is_named_on_one_line():
    text = draft_project("d.csv", Seen(("t", "pv", "op", "Pumpe, links", "a\n[[model]]")))
    assert "# not used: Pumpe, links, 'a\\n[[model]]'\n" in text


def test_what_is_offered_is_toml_once_the_marks_are_taken_off():
    text = draft_project("d.csv", Seen(("t", 'a"\n.pv', 'a"\n.op', "feed flow"), units={"feed flow": "t/h"}))
    lines = text.split("\n")
    said = [line for line in lines if not line.startswith("#")]
    tables = lines[lines.index("# [[disturbance]]") :]
    offered = [line.removeprefix("# ") for line in tables if re.match(r"# (\[|\w+ = )", line)]
    project = tp.Project.from_toml("\n".join([*said, *offered]))
    assert [(law.form, law.gain, law.reset_minutes, law.action) for law in project.controllers] == [
        ("ideal", 1.0, 1.0, "reverse")
    ]
    assert [element.tf for element in project.model] == ["1.2 exp(-3 s)/(20 s + 1)"]
    assert [(d.name, d.column, d.unit) for d in project.disturbances] == [("feed flow", "feed flow", "t/h")]


def test_a_valve_output_belongs_to_the_loop_of_the_measurement():
    """Two words for OP in one name; "east valve" alone is the loop's name."""
    (one,) = guess_loops(["recycle flow measurement", "recycle flow setpoint", "recycle valve output", "recycle mode"])
    assert (one.pv, one.op) == ("recycle flow measurement", "recycle valve output")
    assert (one.sp, one.mode) == ("recycle flow setpoint", "recycle mode")
    (other,) = guess_loops(["east valve.pv", "east valve.op"])
    assert (other.pv, other.op) == ("east valve.pv", "east valve.op")


MEANINGS = {
    "FIC101.PV": ("fic 101", "pv", "flow", False),
    "Area/FIC101/PV.CV": ("area fic 101", "pv", "flow", False),
    "Area/FIC101/MODE.ACTUAL": ("area fic 101", "mode", "flow", False),
    "FIC101.DACA.PV": ("fic 101", "pv", "flow", False),
    "FIC101.PIDA.OP": ("fic 101", "op", "flow", False),
    r"\\\\srv\\LIC7.PV": ("srv lic 7", "pv", "level", False),
    "FIC101_SPT": ("fic 101", "sp", "flow", False),
    "PDIC4.MV": ("pdic 4", "op", "pressure", False),
    "AIC4.SP": ("aic 4", "sp", "other", False),
    "TI101.PV": ("tic 101", "pv", "temperature", False),
    "FV101.OP": ("fic 101", "op", "flow", False),
    "PV101": ("101", "pv", None, False),
    "Sollwert": ("", "sp", None, False),
    "Stellgröße": ("", "op", None, False),
    "Temperatur Istwert": ("", "pv", "temperature", False),
    "process value": ("", "pv", None, False),
    "reactor temperature": ("reactor", "pv", "temperature", False),
    "FIC101.PV status": ("fic 101", "pv", "flow", True),
    "FIC101.PV_Q": ("fic 101", "pv", "flow", True),
    "FIC101.PV.QUAL": ("fic 101", "pv", "flow", True),
    "FIC101/PV.ST": ("fic 101", "pv", "flow", True),
    "spare": ("spare", None, None, False),
}


@pytest.mark.parametrize("name", MEANINGS)
def test_names_say_what_a_signal_is(name):
    found = meaning_of(name)
    assert (found.key, found.role, found.kind, found.status) == MEANINGS[name]


def test_a_loop_may_be_called_by_what_it_measures():
    columns = [
        "reactor temperature",
        "reactor temp setpoint",
        "reactor output",
        "tank level",
        "tank level sp",
        "tank valve",
    ]
    assert [(loop.pv, loop.sp, loop.op, loop.kind) for loop in guess_loops(columns)] == [
        ("reactor temperature", "reactor temp setpoint", "reactor output", "temperature"),
        ("tank level", "tank level sp", "tank valve", "level"),
    ]


def test_two_quantities_of_one_place_are_two_loops():
    columns = ["drum level", "drum level sp", "drum level op", "drum pressure", "drum pressure sp", "drum pressure op"]
    assert [(loop.pv, loop.sp, loop.op) for loop in guess_loops(columns)] == [tuple(columns[:3]), tuple(columns[3:])]


def test_what_comes_from_outside_is_offered():
    assert guess_disturbances(["feed flow", "FI200.PV", "ambient", "spare", "FI200.PV status", "TIC7.SP"]) == [
        "feed flow",
        "FI200.PV",
        "ambient",
    ]


@pytest.mark.parametrize(("interval", "unit"), [(None, "s"), (1, "s"), (10, "min"), (60, "min"), (3600, "h")])
def test_the_unit_of_time_goes_by_the_interval(interval, unit):
    assert guess_time_unit(interval) == unit


@pytest.mark.parametrize(
    ("name", "unit"), [("t [s]", "s"), ("time (min)", "min"), ("Time_h", "h"), ("t", None), ("ms", None)]
)
def test_a_time_column_may_bear_its_unit(name, unit):
    assert guess_counted_unit(name) == unit


def test_file_name_that_is_not_unicode_is_refused():
    with pytest.raises(tp.DataError, match=r"udcff.*rename the file"):
        draft_project("\udcff.csv", Seen(tuple(["t", "pv", "op"])))
