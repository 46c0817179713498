"""Levels: a dead time is long or short beside what the vessel takes, though an integrator has no lag."""

from __future__ import annotations

from pathlib import Path

import pytest

from trueplant import Project, Result
from trueplant.project.simulation import as_file, simulate_record
from trueplant.study.pipeline import analyse

LEVEL = """
time_unit = "min"
data = {{files = ["record.csv"], time = "t"}}
output = [{{name = "level", pv = "pv1", sp = "sp1", unit = "%"}}]
input = [{{name = "outflow", op = "op1", unit = "%"}}]
model = [{{output = "level", input = "outflow", tf = "{model}"}}]
controller = [{{input = "outflow", output = "level", Kc = -2, Ti = 40.0, sample_time = {scan}}}]

[simulate]
plant = [{{output = "level", input = "outflow", tf = "{plant}"}}]
duration = 600
sample_time = {scan}
noise = 0.1
setpoints = [
    {{time = 20, output = "level", value = 2}},
    {{time = 220, output = "level", value = -1}},
    {{time = 420, output = "level", value = 1}},
]
"""


def result(folder: Path, model: str, plant: str, scan: float = 0.5) -> Result:
    project = Project.from_toml(LEVEL.format(model=model, plant=plant, scan=scan), folder)
    (folder / "record.csv").write_bytes(as_file(simulate_record(project), "record.csv"))
    return analyse(project)


@pytest.mark.parametrize("scan", [0.1, 0.5])
def test_a_level_without_dead_time_that_has_not_changed_is_called_so(tmp_path, scan):
    """However fast it is recorded: the vessel, not the interval, says what a short dead time is."""
    found = result(tmp_path, "-0.05/s", "-0.05/s", scan).elements[0]
    slope, dead_time = found.parameters
    assert found.verdict == "unchanged" and found.grade == "A"
    assert slope.ci[0] < -0.05 < slope.ci[1]
    assert 0 <= dead_time.ci[0] < 1e-9 and dead_time.ci[1] < 0.3


def test_its_dead_time_is_found_where_it_came_to_be(tmp_path):
    found = result(tmp_path, "-0.05/s", "-0.05 exp(-2 s)/s").elements[0]
    assert found.verdict == "changed"
    dead_time = found.parameters[1]
    assert dead_time.changed and dead_time.ci[0] < 2 < dead_time.ci[1]


def test_its_step_axis_is_no_longer_than_what_the_data_tell(tmp_path):
    """It never settles: shown is what a lag would take that is as slow as the lowest frequency known."""
    curves = result(tmp_path, "-0.05/s", "-0.07/s").curves
    lowest = curves.band[0][0][0]
    assert curves.step_t[-1] == pytest.approx(1 / lowest) and curves.step_t[-1] < 200


WALK = 'loads = [{{at = "outflow", kind = "random walk", std = 0.15, seed = {seed}}}]\n'


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(6))
def test_an_inflow_that_walks_is_not_taken_for_the_vessel(tmp_path, seed):
    """PV integrates it: a disturbance that grows as t^1.5 and shows late below the noise of the measurement."""
    text = LEVEL.replace("setpoints", WALK.replace("{seed}", str(seed)) + "setpoints", 1)
    project = Project.from_toml(text.format(model="-0.05/s", plant="-0.05/s", scan=0.2), tmp_path)
    (tmp_path / "record.csv").write_bytes(as_file(simulate_record(project), "record.csv"))
    found = analyse(project).elements[0]
    slope = found.parameters[0]
    assert found.verdict in ("unchanged", "not identifiable")
    assert slope.plant is None or abs(slope.plant + 0.05) < 3.5 * slope.std_error
