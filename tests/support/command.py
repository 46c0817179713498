"""A sound project of one simulated loop, for tests of what a command makes of mistakes in it."""

from __future__ import annotations

import os
from pathlib import Path

import trueplant

ENVIRONMENT = os.environ | {"PYTHONPATH": str(Path(trueplant.__file__).parents[1])}
"""For commands in processes of their own."""
PROJECT = """\
time_unit = "s"
[data]
files = ["record.csv"]
time = "t"
[[output]]
name = "y"
pv = "pv"
sp = "sp"
[[input]]
name = "u"
op = "op"
[[model]]
output = "y"
input = "u"
tf = "2 exp(-2 s)/(10 s + 1)"
[[controller]]
input = "u"
output = "y"
Kc = 0.8
Ti = 8.0
sample_time = 0.5
[simulate]
duration = 300
sample_time = 0.5
noise = 0.02
setpoints = [{time = 5, output = "y", value = 1}, {time = 100, output = "y", value = -1}]
"""
