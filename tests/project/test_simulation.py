"""What the table [simulate] of a project asks for is what the simulator is asked by hand."""

from __future__ import annotations

import numpy as np
import pytest

import trueplant as tp
from trueplant.loop import PID, Coloured, Controller, Filtered, Ramp, RandomWalk, Step, simulate
from trueplant.lti import TransferMatrix

BASE = """
time_unit = "min"
[data]
files = ["record.csv"]
[[output]]
name = "top"
pv = "pv1"
sp = "sp1"
[[output]]
name = "bottom"
pv = "pv2"
sp = "sp2"
[[input]]
name = "reflux"
op = "op1"
limits = [0, 4]
[[input]]
name = "steam"
op = "op2"
[[disturbance]]
name = "feed"
column = "f"
hold = "zoh"
[[disturbance]]
name = "ambient"
column = "a"
[[controller]]
input = "reflux"
output = "top"
Kc = 0.375
Ti = 8.29
sample_time = SCAN
[[controller]]
input = "steam"
output = "bottom"
Kc = -0.0754
Ti = 23.6
sample_time = SCAN
MODEL
[simulate]
duration = 200
sample_time = 1.0
noise = 0.01
seed = 4
start = { top = 96.0, bottom = 0.5, reflux = 1.95, steam = 1.7, feed = 2.5 }
setpoints = [{ time = 10, output = "top", value = 97.0 }]
"""
ELEMENTS = {
    ("top", "reflux"): "12.8 exp(-1.4 s)/(16.7 s + 1)",
    ("top", "steam"): "-18.9 exp(-3.4 s)/(21 s + 1)",
    ("bottom", "reflux"): "6.6 exp(-7.4 s)/(10.9 s + 1)",
    ("bottom", "steam"): "-19.4 exp(-3.4 s)/(14.4 s + 1)",
    ("top", "feed"): "3.8 exp(-8.1 s)/(14.9 s + 1)",
    ("bottom", "feed"): "4.9 exp(-3.4 s)/(13.2 s + 1)",
    ("bottom", "ambient"): "0.5/(3 s + 1)",
}
MODEL = "".join(f'[[model]]\noutput = "{y}"\ninput = "{u}"\ntf = "{g}"\n' for (y, u), g in ELEMENTS.items())
OUTPUTS, INPUTS, DISTURBANCES = ("top", "bottom"), ("reflux", "steam"), ("feed", "ambient")
LOADS = """
[[simulate.loads]]
at = "feed"
kind = "noise"
std = 0.1
time_constant = 10
[[simulate.loads]]
at = ["feed"]
kind = "step"
size = 0.3
time = 60
[[simulate.loads]]
at = "ambient"
kind = "ramp"
size = -1
time = 20
until = 90
[[simulate.loads]]
at = ["bottom", "top"]
kind = "noise"
std = [0.05, 0.1]
c = [1, 0.3]
a = [1, -0.8]
correlation = 0.7
[[simulate.loads]]
at = "steam"
kind = "random walk"
std = 0.002
seed = 9
[[simulate.loads]]
at = ["top", "bottom"]
kind = "step"
size = 0.2
time = 120
tf = ["1/(5 s + 1)", "-2 exp(-1.5 s)/(8 s + 1)"]
[[simulate.loads]]
at = ["reflux"]
kind = "step"
size = [0.05]
time = 150
"""


def project(loads: str = "", scan: float = 1.0, model: str = MODEL) -> tp.Project:
    return tp.Project.from_toml(BASE.replace("SCAN", f"{scan}").replace("MODEL", model) + loads)


def matrix(sources: tuple[str, ...]) -> TransferMatrix:
    return TransferMatrix.of([[ELEMENTS.get((y, u), 0.0) for u in sources] for y in OUTPUTS], "min")


def test_loads_and_measured_disturbances_are_those_of_the_simulator():
    frame = tp.simulate(project(LOADS))
    assert frame.columns == ["t", "sp1", "sp2", "op1", "op2", "pv1", "pv2", "f", "a"]
    r = np.tile([96.0, 0.5], (201, 1))
    r[10:, 0] = 97.0
    law = Controller.diagonal(
        [
            PID(Kc=0.375, Ti=8.29, sample_time=1.0, limits=(0, 4), anti_windup="clamp"),
            PID(Kc=-0.0754, Ti=23.6, sample_time=1.0),
        ]
    )
    both = ((1.0, 0.7), (0.7, 1.0))
    model = TransferMatrix.of([["1/(5 s + 1)"], ["-2 exp(-1.5 s)/(8 s + 1)"]], "min")
    sim = simulate(
        matrix(INPUTS),
        law,
        r,
        1.0,
        v=[Coloured((0.1, 0.05), c=(1, 0.3), a=(1, -0.8), correlation=both), Filtered(model, Step(120.0, 0.2))],
        input_disturbance=[RandomWalk((0.0, 0.002), seed=9), Step(150.0, (0.05, 0.0))],
        d=[Coloured((0.1, 0.0), 10.0), Step(60.0, (0.3, 0.0)), Ramp(20.0, 90.0, (0.0, -1.0))],
        Gd=matrix(DISTURBANCES),
        d_hold=("zoh", "linear"),
        noise=0.01,
        u0=(1.95, 1.7),
        y0=(96.0, 0.5),
        seed=4,
    )
    assert np.allclose(frame.select("pv1", "pv2").to_numpy(), sim.y, atol=1e-8)
    assert np.allclose(frame.select("op1", "op2").to_numpy(), sim.u, atol=1e-8)
    assert np.allclose(frame.select("f", "a").to_numpy() - np.array([2.5, 0.0]), sim.d, atol=1e-8)
    assert np.ptp(frame["f"].to_numpy()) > 0.3 and frame["a"][-1] == -1.0


def test_a_faster_scan_sees_the_same_loads():
    """The record of the disturbances is the same whatever the controllers do; the loop is rejecting them faster."""
    slow, fast = tp.simulate(project(LOADS)), tp.simulate(project(LOADS, scan=0.25))
    assert np.array_equal(slow.select("f", "a").to_numpy(), fast.select("f", "a").to_numpy())
    assert not np.array_equal(slow["pv1"].to_numpy(), fast["pv1"].to_numpy())


def test_the_plant_may_say_what_disturbances_do():
    plant = MODEL.replace("[[model]]", "[[simulate.plant]]").replace("4.9 exp", "9.8 exp")
    here = tp.simulate(project(LOADS + plant))
    there = tp.simulate(project(LOADS))
    assert np.max(np.abs(here["pv2"].to_numpy() - there["pv2"].to_numpy())) > 0.1
    assert np.array_equal(here["f"].to_numpy(), there["f"].to_numpy())


@pytest.mark.parametrize(
    ("load", "said"),
    [
        ('at = "fed"\nkind = "step"\nsize = 1', 'did you mean "feed"'),
        ('at = ["feed", "top"]\nkind = "step"\nsize = 1', "of one kind"),
        ('at = ["top", "top"]\nkind = "step"\nsize = 1', "each once"),
        ('at = "top"\nkind = "step"', r"size.*is needed"),
        ('at = "top"\nkind = "step"\nsize = 1\nstd = 2', r"std.*no key of kind"),
        ('at = "top"\nkind = "ramp"\nsize = 1\ntime = 5\nuntil = 5', "must come after time"),
        ('at = "top"\nkind = "noise"\nstd = 1\ntime_constant = 2\na = [1, -0.5]', "keep one"),
        ('at = ["top", "bottom"]\nkind = "step"\nsize = [1, 2, 3]', "or 2: one for each"),
        ('at = ["top", "bottom"]\nkind = "step"\nsize = [1, 2]\ntf = "1/(s + 1)"', "or 1: one for each"),
        ('at = ["top", "bottom"]\nkind = "step"\nsize = 1\ntf = ["1/(s + 1)"]', "each of the 2 places"),
        ('at = "top"\nkind = "jump"\nsize = 1', "kind"),
        ('at = []\nkind = "step"\nsize = 1', "at"),
    ],
)
def test_mistakes_are_named(load, said):
    with pytest.raises(tp.ProjectError, match=rf"(?s)simulate\.loads.*{said}"):
        project(f"[[simulate.loads]]\n{load}\n")


def test_a_colour_that_is_not_stationary_is_refused():
    with pytest.raises(tp.LoopError, match="stationary"):
        tp.simulate(project('[[simulate.loads]]\nat = "top"\nkind = "noise"\nstd = 1\na = [1, -1]\n'))


def test_how_a_measured_disturbance_runs_is_one_of_two():
    with pytest.raises(tp.ProjectError, match="hold"):
        tp.Project.from_toml(project().to_toml().replace('hold = "zoh"', 'hold = "held"'))
