"""A project that was read keeps its text: comments, order and formatting stay, and only what has to change changes."""

from __future__ import annotations

import difflib
import re
import tomllib
from datetime import UTC, date, datetime, time, timedelta, timezone
from pathlib import Path

import pytest
import tomlkit
from hypothesis import given, settings
from hypothesis import strategies as st

import trueplant as tp
from support import ROOT
from trueplant.project import plant_project
from trueplant.project.document import edited, sections, to_toml, with_exclusions, with_formulas

TEXT = """\
# Splitter, March. Ask Kari before changing [limits].
time_unit   =   "min" # all of them

[data]
files = [
    'a.csv',       # before the shutdown
    "dataset:pid_oven/x.csv",
    "/srv/b.csv",  # after it
]
exclude = [{from = 0, to = 12.5}, {file = 'a.csv', from = 100, to = 140}]   # start-up

# -- loop 1 --
[[output]]
name = "top"
pv   = "pv1"
[[input]]
name = "reflux"
op   = "op1"

# -- loop 2 --
[[output]]
name = "bottom"
pv   = "pv2"
[[input]]
name = "gas"
op   = "op2"

[[model]]   # from the step test
output = "top"
input = "gas"
tf = '3.2 exp(-3 s)/(18 s + 1)'   # 2019

[analysis]
confidence = 0.9_5   # not 0.99

[[model]]
output = "bottom"
input = "reflux"
tf = 2   # a guess
# end
"""
NEW = {(0, 1): tp.tf("4 exp(-2 s)/(15 s + 1)")}


def changed_lines(before: str, after: str) -> list[str]:
    """Lines removed (-) and added (+)."""
    found = difflib.ndiff(before.splitlines(), after.splitlines())
    return [line for line in found if line.startswith(("-", "+"))]


def test_nothing_changes_where_nothing_has_to(tmp_path):
    (tmp_path / "p.toml").write_text(TEXT)
    project = tp.Project.load(tmp_path / "p.toml")
    assert project.to_toml() == TEXT
    assert project.to_toml(tmp_path) == TEXT
    declared = {(0, 1): project.model_matrix()[0, 1], (1, 0): tp.tf(2)}
    assert project.with_model(declared).to_toml() == TEXT


def test_only_the_formula_changes():
    after = tp.Project.from_toml(TEXT).with_model(NEW).to_toml()
    assert changed_lines(TEXT, after) == [
        "- tf = '3.2 exp(-3 s)/(18 s + 1)'   # 2019",
        '+ tf = "4 exp(-2 s)/(15 s + 1)"   # 2019',
    ]


def test_number_becomes_a_formula():
    after = tp.Project.from_toml(TEXT).with_model({(1, 0): tp.tf("2.5/(s + 1)")}).to_toml()
    assert changed_lines(TEXT, after) == ["- tf = 2   # a guess", '+ tf = "2.5/(s + 1)"   # a guess']


def test_only_relative_paths_change(tmp_path):
    after = tp.Project.from_toml(TEXT, tmp_path).to_toml(tmp_path / "out")
    assert changed_lines(TEXT, after) == [
        "-     'a.csv',       # before the shutdown",
        '+     "../a.csv",       # before the shutdown',
        "- exclude = [{from = 0, to = 12.5}, {file = 'a.csv', from = 100, to = 140}]   # start-up",
        '+ exclude = [{from = 0, to = 12.5}, {file = "../a.csv", from = 100, to = 140}]   # start-up',
    ]


def test_paths_of_every_table_are_moved(tmp_path):
    text = (
        TEXT[: TEXT.index("[data]")]
        + """\
[[experiment]]
file = "a.csv" # first
[experiment.limits]
gas = [0, 1]
[[experiment]]
file = "sub/b.csv"
[[data.exclude]]
file = "sub/b.csv"
from = 1
to = 2
[simulate]
plant = "plant.toml" # found in March
duration = 10
sample_time = 1
"""
        + TEXT[TEXT.index("# -- loop 1") :]
    )
    project = tp.Project.from_toml(text, tmp_path)
    moved = tp.Project.from_toml(project.to_toml(tmp_path / "x" / "y"), tmp_path / "x" / "y")
    assert [e.path.resolve() for e in moved.experiments] == [tmp_path / "a.csv", tmp_path / "sub" / "b.csv"]
    assert moved.experiments[0].limits == (None, (0, 1))
    assert moved.data.exclude[0].file == "../../sub/b.csv"
    assert moved.simulate is not None and moved.simulate.plant == "../../plant.toml"
    assert "# first" in moved.to_toml() and "# found in March" in moved.to_toml()


def test_simulated_elements_are_no_paths(tmp_path):
    text = (
        TEXT + '[simulate]\nduration = 10\nsample_time = 1\n[[simulate.plant]]\noutput = "top"\ninput = "gas"\ntf = 1\n'
    )
    assert tp.Project.from_toml(text, tmp_path).to_toml(tmp_path / "out").endswith(text[text.index("[simulate]") :])


def test_new_element_comes_at_the_end():
    after = tp.Project.from_toml(TEXT).with_model({(0, 0): tp.tf("-0.5/(3 s + 1)")}).to_toml()
    assert after == f'{TEXT}\n[[model]]\noutput = "top"\ninput = "reflux"\ntf = "-0.5/(3 s + 1)"\n'
    without = TEXT[: TEXT.index("[[model]]")]
    project = tp.Project.from_toml(without).with_model(NEW)
    assert project.to_toml().startswith(without)
    assert project.model_matrix()[0, 1].dc_gain == 4


def test_list_of_elements_stays_a_list():
    model = 'model = [\n  {output = "top", input = "gas", tf = "1"}, # main\n]\n'
    text = TEXT[: TEXT.index("[[model]]")].replace("[data]", f"{model}[data]")
    after = tp.Project.from_toml(text).with_model(NEW | {(1, 1): tp.tf("2/(s + 1)")})
    assert after.model_matrix().dc_gain.tolist() == [[0, 4], [0, 2]]
    assert changed_lines(text, after.to_toml()) == [
        '-   {output = "top", input = "gas", tf = "1"}, # main',
        '+   {output = "top", input = "gas", tf = "4 exp(-2 s)/(15 s + 1)"}, # main',
        '+   {output = "bottom", input = "gas", tf = "2/(s + 1)"},',
    ]


def test_windows_lines_stay(tmp_path):
    windows = TEXT.replace("\n", "\r\n")
    (tmp_path / "p.toml").write_bytes(windows.encode())
    project = tp.Project.load(tmp_path / "p.toml")
    for elements in (NEW, {(0, 0): tp.tf("-0.5/(3 s + 1)")}):
        after = plant_project(project, elements, tmp_path / "out")
        assert after.count("\n") == after.count("\r\n")
        assert after.replace("\r\n", "\n") == plant_project(
            tp.Project.from_toml(TEXT, tmp_path), elements, tmp_path / "out"
        )


def test_plant_file_is_the_project_with_its_comments(tmp_path):
    project = tp.Project.from_toml(TEXT, tmp_path)
    text = plant_project(project, NEW, tmp_path / "out")
    plant = tp.Project.from_toml(text, tmp_path / "out")
    assert [line[line.index("#") :] for line in text.splitlines() if "#" in line] == [
        line[line.index("#") :] for line in TEXT.splitlines() if "#" in line
    ]
    assert plant.model_matrix()[0, 1].dc_gain == 4
    assert plant.model_matrix()[1, 0].dc_gain == 2
    assert plant.experiments[0].path.resolve() == tmp_path / "a.csv"


def test_plant_of_a_project_built_in_code(tmp_path):
    project = tp.Project(
        time_unit="s",
        data={"files": ["a.csv"], "time": None},
        output=[{"name": "y", "pv": "pv", "limits": (0, 1)}],
        input=[{"name": 'u "1"\n', "op": "op"}],
    )
    plant = tp.Project.from_toml(plant_project(project, {(0, 0): tp.tf("2/(s + 1)")}, tmp_path), tmp_path)
    assert plant.model_matrix().dc_gain.tolist() == [[2]]
    assert plant.input_names == ('u "1"\n',)
    assert plant.experiments[0].path.resolve() == Path("a.csv").resolve()


def test_an_updated_copy_is_written_as_it_is():
    project = tp.Project.from_toml(TEXT)
    assert project.model_copy().to_toml() == TEXT
    bold = project.model_copy(update={"analysis": project.analysis.model_copy(update={"confidence": 0.8})})
    assert tp.Project.from_toml(bold.to_toml()).analysis.confidence == 0.8
    assert bold.sha256 != project.sha256


def test_headers_are_told_from_lists_and_strings():
    text = (
        "a = [\n[1],\n[2]\n]\nb = \"\"\"\n[no]\n\"\"\"\nc = '''\n[[no]]'''\n [d] # x\ne = {f = [\n[3]]}\n[[g]]\n[g.h]"
    )
    assert [part.split("\n")[0] for part in sections(text)] == ["a = [", " [d] # x", "[[g]]", "[g.h]"]
    assert "".join(sections(text)) == text


_TEXTS = st.text(st.characters(exclude_categories=["Cs"]))
_NAMES = st.text(st.characters(exclude_categories=["Cs"]), min_size=1, max_size=8) | st.sampled_from(
    ["a\n[[model]]\n", '"', "'", '"""', "\\", "\x7f", "\x00", "\x85", "\u2028", "# x", "a.b", "tf", "°C"]
)
_ZONES = st.none() | st.just(UTC) | st.integers(-720, 720).map(lambda m: timezone(timedelta(minutes=m)))
_SCALARS = (
    st.booleans()
    | st.integers(-(2**63), 2**63 - 1)
    | st.floats(allow_nan=False)
    | _TEXTS
    | st.datetimes(min_value=datetime(1900, 1, 1), timezones=_ZONES)
    | st.dates(min_value=date(1000, 1, 1))
    | st.times()
)
_VALUES = st.recursive(_SCALARS, lambda inner: st.lists(inner, max_size=4) | st.dictionaries(_NAMES, inner, max_size=4))
_TABLES = st.dictionaries(
    _NAMES, _VALUES | st.lists(st.dictionaries(_NAMES, _VALUES, max_size=3), min_size=1, max_size=3), max_size=5
)


@settings(max_examples=150, deadline=None)
@given(_TABLES)
def test_tables_survive_being_written_and_edited(tables):
    text = to_toml(tables)
    assert tomllib.loads(text) == tables
    assert "".join(sections(text)) == text
    assert edited(text, lambda section: None) == text


def test_entries_that_are_none_are_left_out():
    assert to_toml({"a": None, "b": {"c": None, "d": (1, time(7, 30))}}) == "[b]\nd = [1, 07:30:00]\n"


def quoted(text: str) -> str:
    return tomlkit.item(text).as_string()


@settings(max_examples=100, deadline=None)
@given(
    st.lists(_NAMES, min_size=2, max_size=4, unique=True),
    st.lists(st.sampled_from(["", "# note", "# [[model]]", '# tf = "0"']), min_size=4, max_size=4),
    st.data(),
)
def test_formulas_reach_the_elements_that_they_are_for(names, notes, data):
    pairs = [(output, input_) for output in names for input_ in names]
    declared = data.draw(st.lists(st.sampled_from(pairs), unique=True, max_size=4))
    updated = data.draw(st.lists(st.sampled_from(pairs), unique=True, max_size=4))
    blocks = [
        f"{note}\n[[model]] {note}\noutput={quoted(o)}{note}\ninput={quoted(i)}\ntf='1' {note}\n"
        for (o, i), note in zip(declared, notes, strict=False)
    ]
    text = "".join([*blocks[:1], "[x]\n", *blocks[1:]])
    after = tomllib.loads(with_formulas(text, dict.fromkeys(updated, "new")))
    expected = dict.fromkeys(declared, "1") | dict.fromkeys(updated, "new")
    assert {(e["output"], e["input"]): e["tf"] for e in after.get("model", [])} == expected


def test_every_example_keeps_its_text():
    for file in sorted((ROOT / "examples").glob("*.toml")):
        text = file.read_text(encoding="utf-8")
        project = tp.Project.load(file)
        assert project.to_toml(file.parent.parent) == text, file.name
        after = project.with_model({(0, 0): tp.tf("1.5/(7 s + 1)")}).to_toml()
        assert after.count("#") == text.count("#")
        assert 0 < len(changed_lines(text, after)) <= 5


MORE = [
    {"from": datetime(2024, 3, 1, tzinfo=timezone(timedelta(hours=1))), "to": datetime(2024, 3, 2, 7, 30)},
    {"from": 1, "to": 2.5, "file": "b.csv"},
]


@pytest.mark.parametrize(
    "text",
    [
        '[data]   # the data\nfiles = ["a.csv"]  # one\n\n# outputs follow\n[[output]]\nname = "x"\n',
        '[data]\nfiles = ["a.csv"]\nexclude = [{from = 1, to = 2}]  # trip\ntime = "t"\n[[output]]\nname = "x"\n',
        "[data]\nexclude = [\n  {from = 1, to = 2},  # trip\n  # more\n  {from = 5, to = 6},\n]\n[[output]]\n",
        '[data]\nfiles = ["a.csv"]\n[[data.exclude]]\nfrom = 1  # trip\nto = 2\n[[output]]\nname = "x"\n',
        'time_unit = "min"\ndata = {files = ["a.csv"]}\noutput = [{name = "x"}]  # all\n',
        'data.files = ["a.csv"]  # one\ndata.time = "t"\n[[output]]\nname = "x"\n',
        '[[experiment]]\nfile = "a.csv"  # one\n',
        '[data]\r\nfiles = ["a.csv"]  # one\r\n\r\n[[output]]\r\nname = "x"\r\n',
        '[data]\nfiles = ["a.csv"]',
        '[data]\nfiles = ["a.csv"]\nexclude = []\n',
    ],
)
def test_exclusions_are_added_and_nothing_else_changes(text: str):
    wanted = tomllib.loads(text)
    data = wanted.setdefault("data", {})
    data["exclude"] = [*data.get("exclude", []), *MORE]
    found = with_exclusions(text, MORE)
    assert tomllib.loads(found) == wanted
    # what was there stands in its order, comments and all
    rest = iter(re.findall(r"#.*|\w+|\S", found))
    assert all(part in rest for part in re.findall(r"#.*|\w+|\S", text))
    assert ("\r\n" in text) == ("\r\n" in found) and ("\r\n" not in text or "\n" not in found.replace("\r\n", ""))
