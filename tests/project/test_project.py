"""The project file: what it says reaches the other rooms, and every mistake in it is answered by one message."""

from __future__ import annotations

import re

import numpy as np
import pytest

import trueplant as tp
from trueplant.project.messages import line_numbers

BASE = """\
time_unit = "min"
[data]
files = ["a.csv", "b.csv"]
exclude = [{from = 0, to = 12.5}, {file = "b.csv", from = 100, to = 140}]
[[output]]
name = "top"
pv = "pv1"
sp = "sp1"
limits = [0, 400]
span = [0, 400]
[[output]]
name = "vapour"
pv = "pv2"
[[input]]
name = "reflux"
op = "op1"
limits = [0, 100]
span = [0, 100]
[[input]]
name = "gas"
op = "op2"
[[disturbance]]
name = "ambient"
column = "amb"
[[model]]
output = "top"
input = "gas"
tf = "3.2 exp(-3 s)/(18 s + 1)"
[[model]]
output = "vapour"
input = "gas"
tf = "0"
structure = "fopdt"
[[model]]
output = "top"
input = "ambient"
tf = "0.5/(30 s + 1)"
estimate = false
[[controller]]
input = "reflux"
output = "top"
Kc = 1.5
Ti = 8
action = "direct"
gain_unit = "percent of span"
"""


def _project(text: str = BASE) -> tp.Project:
    return tp.Project.from_toml(text)


def test_model_is_zero_where_nothing_is_declared():
    model = _project().model_matrix()
    assert model.shape == (2, 2)
    assert model[0, 0].is_zero and model[1, 0].is_zero
    assert model(0.1j)[0, 0, 1] == pytest.approx(3.2 * np.exp(-0.3j) / (1.8j + 1))


def test_disturbances_have_columns_of_their_own():
    project = _project()
    matrix = project.disturbance_matrix()
    assert matrix is not None and matrix.shape == (2, 1)
    assert matrix.dc_gain.tolist() == [[0.5], [0.0]]
    without = re.sub(r"\[\[disturbance\]\]\n.*\n.*\n", "", BASE)
    without = re.sub(r'\[\[model\]\]\noutput = "top"\ninput = "ambient"\n.*\n.*\n', "", without)
    assert _project(without).disturbance_matrix() is None


def test_only_what_can_be_estimated_is_estimated():
    project = _project()
    asked = [[project.estimate(i, j) for j in range(3)] for i in range(2)]
    assert asked == [[False, True, False], [False, True, False]]
    assert project.structure(1, 1) == "fopdt"
    assert project.structure(0, 1) is None


def test_controller_has_the_signs_and_units_declared():
    controller = _project().controller()
    assert controller is not None
    # 1.5 % of 100 % per % of 400 degC, direct: all gains times -1
    gain = -1.5 * 100 / 400
    value = controller([1j])
    assert value.shape == (1, 2, 2)
    assert value[0, 0, 0] == pytest.approx(gain * (1 + 1 / 8j))
    assert np.all(value[0, 1] == 0)
    assert controller.limits[0].tolist() == [0, 100]


def test_no_controller_is_none():
    assert _project(BASE[: BASE.index("[[controller]]")]).controller() is None


def test_experiments_put_together_what_differs():
    text = BASE.replace('files = ["a.csv", "b.csv"]\n', "").replace(
        "[data]",
        """[[experiment]]
file = "a.csv"
[[experiment]]
file = "b.csv"
loop = "open"
controllers = [{input = "reflux", Kc = 5.0}]
limits = {gas = [0, 65]}
[data]""",
    )
    first, second = _project(text).experiments
    assert (first.closed, second.closed) == (True, False)
    assert (first.controllers[0].Kc, second.controllers[0].Kc) == (1.5, 5.0)
    assert second.controllers[0].Ti == 8
    assert first.limits == ((0, 100), None)
    assert second.limits == ((0, 100), (0, 65))
    assert [len(e.exclude) for e in (first, second)] == [1, 2]
    assert _project(text).controller(1)([1j])[0, 0, 0] == pytest.approx(
        5 / 1.5 * _project(text).controller(0)([1j])[0, 0, 0]
    )


def test_series_and_transfer_function_forms_are_the_documented_ones():
    s = np.array([0.3j])
    law = "[[controller]]" + BASE.split("[[controller]]")[1]
    head = BASE[: BASE.index("[[controller]]")]
    series = (
        head
        + '[[controller]]\ninput = "gas"\noutput = "top"\nform = "series"\nKc = 2.0\nTi = 8.0\nTd = 0.5\nalpha = 0.2\n'
    )
    assert law.startswith("[[controller]]")
    expected = 2 * (1 + 1 / (8 * s)) * (0.5 * s + 1) / (0.1 * s + 1)
    assert _project(series).controller()(s)[0, 1, 0] == pytest.approx(expected[0])
    free = (
        head + '[[controller]]\ninput = "gas"\noutput = "top"\ntf = "2 (4 s + 1)/(s (0.1 s + 1))"\naction = "direct"\n'
    )
    assert _project(free).controller()(s)[0, 1, 0] == pytest.approx((-2 * (4 * s + 1) / (s * (0.1 * s + 1)))[0])


def test_paths_start_at_the_project_file(tmp_path):
    (tmp_path / "p.toml").write_text(BASE)
    project = tp.Project.load(tmp_path / "p.toml")
    assert project.experiments[0].path == tmp_path / "a.csv"
    moved = tp.Project.from_toml(project.to_toml(folder=tmp_path / "out"), tmp_path / "out")
    assert moved.experiments[1].path.resolve() == (tmp_path / "b.csv").resolve()
    assert len(moved.experiments[1].exclude) == 2


def test_projects_survive_being_written(tmp_path):
    project = _project()
    again = _project(project.to_toml())
    assert again.model_dump() == project.model_dump()
    assert again.sha256 != ""


def test_model_can_be_replaced():
    project = _project().with_model({(0, 1): tp.tf("4 exp(-3 s)/(15 s + 1)"), (0, 0): tp.tf("-0.58/(10 s + 1)")})
    matrix = _project(project.to_toml()).model_matrix()
    assert matrix.dc_gain[0].tolist() == pytest.approx([-0.58, 4.0])
    assert matrix[0, 1].terms[0].dead_time == 3
    assert project.element(0, 2).estimate is False


def test_projects_are_built_in_code():
    project = tp.Project(
        time_unit="s",
        output=[{"name": "y", "pv": "pv", "limits": (0, 1)}],
        input=[{"name": "u", "op": "op"}],
        model=[{"output": "y", "input": "u", "tf": 2}],
    )
    assert project.model_matrix().dc_gain.tolist() == [[2.0]]
    with pytest.raises(tp.ProjectError, match="output: must be a list with at least one entry"):
        tp.Project(time_unit="s", output=[], input=[{"name": "u", "op": "op"}])
    with pytest.raises(tp.ProjectError, match="Outputs.*output"):
        tp.Project(time_unit="s", Outputs=[], input=[{"name": "u", "op": "op"}], output=[{"name": "y", "pv": "pv"}])


MISTAKES = {
    "unknown key": ("Ti = 8", "ti = 8", r'line 43: controller\[1\]\.ti: .*did you mean "Ti"'),
    "unknown table": ("[data]", "[dat]", 'line 2: dat: .*did you mean "data"'),
    "unknown key of an inline table": ("{from = 0,", "{form = 0,", r'line 4: data\.exclude\[1\]\.form: .*"from"'),
    "text for a number": ("Ti = 8", 'Ti = "8"', 'line 43: .*must be a number, not "8"'),
    "true for a number": ("Ti = 8", "Ti = true", "must be a number, not true"),
    "number for text": ('pv = "pv1"', "pv = 1", "line 7: .*must be text"),
    "text for a list": ('files = ["a.csv", "b.csv"]', 'files = "a.csv"', "line 3: data.files: must be a list"),
    "negative time": ("Ti = 8", "Ti = -8", "must be above 0, not -8"),
    "not a number": ("Ti = 8", "Ti = nan", "finite"),
    "unknown unit of time": ('time_unit = "min"', 'time_unit = "minutes"', 'line 1: time_unit: must be .*"min"'),
    "missing unit of time": ('time_unit = "min"\n', "", "time_unit: is missing"),
    "code as a formula": ('"3.2 exp(-3 s)/(18 s + 1)"', "\"__import__('os').system('x')\"", r"line 28: model\[1\]\.tf"),
    "improper formula": ('"3.2 exp(-3 s)/(18 s + 1)"', '"3 s"', "line 28: .*improper"),
    "division by zero": ('"3.2 exp(-3 s)/(18 s + 1)"', '"3.2/(s - s)"', "line 28: .*zero"),
    "prediction": ('"3.2 exp(-3 s)/(18 s + 1)"', '"exp(3 s)"', "line 28"),
    "undeclared input": (
        'input = "gas"\ntf = "3.2',
        'input = "fuel"\ntf = "3.2',
        r'line 27: .*"fuel" is not declared .*reflux, gas',
    ),
    "undeclared output": (
        'output = "top"\ninput = "gas"',
        'output = "tpo"\ninput = "gas"',
        'line 26: .*"tpo" is not declared .*did you mean "top"',
    ),
    "element twice": (
        'output = "vapour"\ninput = "gas"',
        'output = "top"\ninput = "gas"',
        r"line 29: .*declared already as model\[1\]",
    ),
    "name twice": ('name = "vapour"', 'name = "top"', "line 12: .*twice"),
    "disturbance named as an input": ('name = "ambient"', 'name = "gas"', "line 23: .*twice"),
    "column twice": ('pv = "pv2"', 'pv = "pv1"', "line 13: .*pv1"),
    "set-point that is its PV": ('sp = "sp1"', 'sp = "pv1"', 'line 8: .*"pv1" is the PV of this loop'),
    "unknown structure": ('structure = "fopdt"', 'structure = "fodpt"', "line 33: .*fodpt"),
    "limits the wrong way round": ("limits = [0, 400]", "limits = [400, 0]", "line 9: .*low below high"),
    "one limit": ("limits = [0, 400]", "limits = [400]", "line 9: .*pair"),
    "three limits": ("limits = [0, 400]", "limits = [0, 4, 400]", "line 9: .*pair"),
    "percent of span without a span": ("span = [0, 400]\n", "", r'per cent of span: add span .* output "top"'),
    "parallel keys in the ideal form": ("Kc = 1.5", "Kp = 1.5", 'Kp: is no key of form = "ideal".*parallel'),
    "no gain": ("Kc = 1.5\n", "", r"controller\[1\]\.Kc: is needed"),
    "unfiltered derivative": ("Ti = 8", "Ti = 8\nTd = 1\nalpha = 0", "alpha: must be above 0"),
    "backwards span": ("from = 0, to = 12.5", "from = 20, to = 12.5", r"line 4: .*must come after"),
    "span in an unknown file": ('{file = "b.csv"', '{file = "c.csv"', 'line 4: .*"c.csv" is not declared'),
    "files and experiments": ("[data]", '[[experiment]]\nfile = "c.csv"\n[data]', r"line 5: data\.files: .*keep one"),
    "slave without its PV": ('op = "op2"', 'op = "op2"\nslave_sp = "x"', "slave_sp and slave_pv go together"),
    "a moment in quotes": (
        "from = 0, to = 12.5",
        'from = "05.03.2024", to = 12.5',
        "without quotes such as 2024-03-05",
    ),
    "automatic values without a mode": ('op = "op2"', 'op = "op2"\nautomatic_values = [1]', "automatic_values"),
    "second controller of one loop": (
        "[[controller]]",
        BASE[BASE.index("[[controller]]") :] + "[[controller]]",
        "declared already",
    ),
    "anti-windup without limits": (
        'input = "reflux"\noutput = "top"\nKc = 1.5\nTi = 8\naction = "direct"\ngain_unit = "percent of span"',
        'input = "gas"\noutput = "top"\nKc = 1.5\nanti_windup = "clamp"',
        'anti_windup: needs the limits of OP: add limits to the input "gas"',
    ),
    "no value": ("Ti = 8", "Ti = ", r"line 43: is not valid TOML: Ti = \(write a value behind the ="),
    "decimal comma": ("Ti = 8", "Ti = 1,0", r"line 43: is not valid TOML: Ti = 1,0 \(write decimals with a point"),
    "backslashes of Windows": (
        '["a.csv", "b.csv"]',
        r'["C:\data\x.csv"]',
        r'line 3: is not valid TOML: files = \["C:\\data\\x.csv"\] \(write / instead of \\, or .* single quotes',
    ),
    "no quotes": (
        'name = "top"',
        "name = top",
        "line 6: is not valid TOML: name = top .put text in quotes, as in name",
    ),
    "quotes not closed": ('name = "top"', 'name = "top', "line 6: .*the quotes are never closed"),
    "bracket not closed": ("limits = [0, 400]", "limits = [0, 400", "line 10: .*bracket .* never closed"),
    "key that is there twice": ("Ti = 8", "Ti = 8\nTi = 9", "line 44: is not valid TOML: Ti = 9 .it is there twice"),
    "wrong key in the place of one that is needed": (
        'pv = "pv2"',
        'pvv = "pv2"',
        r'line 13: output\[2\]\.pvv: is not a key .*did you mean "pv".*\(1 more after this one\)',
    ),
    "mistake in a formula before another": (
        'tf = "3.2 exp(-3 s)/(18 s + 1)"',
        'tf = "2 (s"\nestmate = true',
        r"model\[1\]\.tf: formula, column 3: .*add '\)' \(1 more after this one\)\n    2 \(s\n      \^$",
    ),
    "unknown method": ("[[controller]]", '[analysis]\nmethod = "best"\n[[controller]]', "analysis.method: must be"),
    "confidence in percent": (
        "[[controller]]",
        "[analysis]\nconfidence = 95\n[[controller]]",
        "confidence: must be below 1",
    ),
    "ar1 without a time constant": (
        "[[controller]]",
        '[[unmeasured]]\noutput = "top"\nkind = "ar1"\nstd = 1\n[[controller]]',
        "time_constant: is needed",
    ),
    "weight that divides by zero": (
        "[[controller]]",
        '[robustness]\nwI = "1/0"\n[[controller]]',
        "robustness.wI: .*zero",
    ),
    "unknown key of a weight": (
        "[[controller]]",
        "[robustness]\nwI = {gain = 10}\n[[controller]]",
        'did you mean "gain_percent"',
    ),
    "no error of any element": (
        "[[controller]]",
        "[robustness]\nelements = {gain_percent = 0}\n[[controller]]",
        "robustness.elements: has no error",
    ),
    "error of an element that is not there": (
        "[[controller]]",
        '[robustness]\nelements = [{output = "top", input = "gass", gain_percent = 5}]\n[[controller]]',
        'did you mean "gas"',
    ),
    "simulated without end": (
        "[[controller]]",
        "[simulate]\nduration = 1e12\nsample_time = 1\n[[controller]]",
        "50 million",
    ),
    "move after the end": (
        "[[controller]]",
        "[simulate]\nduration = 10\nsample_time = 1\n"
        'setpoints = [{time = 11, output = "top", value = 1}]\n[[controller]]',
        "comes after the end",
    ),
}


@pytest.mark.parametrize(("old", "new", "said"), MISTAKES.values(), ids=MISTAKES)
def test_mistakes_are_named(old, new, said):
    assert BASE.count(old) >= 1
    with pytest.raises(tp.ProjectError) as caught:
        _project(BASE.replace(old, new, 1))
    text = str(caught.value)
    assert re.search(said, text, re.DOTALL), text
    assert "pydantic" not in text and "Traceback" not in text


def test_experiment_may_change_only_a_declared_controller():
    base = BASE.replace('files = ["a.csv", "b.csv"]\n', "").replace('{file = "b.csv", from = 100, to = 140}', "")
    for change, said in (
        ('{input = "gas", Kc = 1}', "fits no"),
        ('{input = "reflux", Kp = 1}', "Kp"),
        ("{Kc = 1}", "fits no"),
    ):
        text = base.replace("[data]", f'[[experiment]]\nfile = "a.csv"\ncontrollers = [{change}]\n[data]')
        with pytest.raises(tp.ProjectError, match=rf"experiment\[1\]\.controllers.*{said}"):
            _project(text)


def test_several_mistakes_are_counted_and_the_first_is_told():
    with pytest.raises(tp.ProjectError, match=r"line 9: .*\(1 more after this one\)"):
        _project(BASE.replace("Ti = 8", "Ti = -8").replace("limits = [0, 400]", "limits = [4, 0]"))


def test_missing_and_unreadable_files_are_named(tmp_path):
    with pytest.raises(tp.ProjectError, match=r"gone\.toml does not exist"):
        tp.Project.load(tmp_path / "gone.toml")
    with pytest.raises(tp.ProjectError, match="cannot be read"):
        tp.Project.load(tmp_path)
    (tmp_path / "latin.toml").write_bytes('# ok\nunit = "°C"'.encode("latin-1"))
    with pytest.raises(tp.ProjectError, match="line 2: is not UTF-8"):
        tp.Project.load(tmp_path / "latin.toml")


def test_byte_order_mark_and_windows_lines_are_read(tmp_path):
    (tmp_path / "p.toml").write_bytes(b"\xef\xbb\xbf" + BASE.replace("\n", "\r\n").encode())
    assert tp.Project.load(tmp_path / "p.toml").output_names == ("top", "vapour")


def test_lines_are_found_in_every_kind_of_table():
    text = 'a = 1\n[b]\nc = """\nd = 2\n"""\n[[e]]\nf = 1\n[[e]]\n# f\n"f" = 2\n[e.g]\nh = 3\n'
    lines = line_numbers(text)
    assert lines[("a",)] == 1
    assert lines[("b", "c")] == 3
    assert ("b", "d") not in lines
    assert lines[("e", 0, "f")] == 7
    assert lines[("e", 1, "f")] == 10
    assert lines[("e", 1, "g", "h")] == 12


def test_lines_are_counted_as_toml_does():
    with pytest.raises(tp.ProjectError, match="line 43: "):
        _project(
            BASE.replace('name = "top"', 'name = "top"  # \x85 and \u2028 end no line').replace("Ti = 8", "Ti = -8")
        )
