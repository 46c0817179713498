"""The example projects and the built-in demos are what they say they are."""

from __future__ import annotations

import textwrap

import numpy as np
import polars as pl
import pytest

import trueplant as tp
from support import ROOT
from trueplant import datasets, loop
from trueplant.cli.analyse import demo_text
from trueplant.project.simulation import simulate_record

EXAMPLES = sorted((ROOT / "examples").glob("*.toml"))
DEMOS = ("mill", "splitter", "wood-berry")


@pytest.mark.parametrize("file", EXAMPLES, ids=lambda p: p.stem)
def test_example_loads_and_names_known_records(file):
    project = tp.Project.load(file)
    names = [plan.name for plan in project.experiments]
    assert names
    assert all(name.removeprefix("dataset:") in datasets.REGISTRY for name in names)
    assert any(project.estimate(i, j) for i in range(len(project.outputs)) for j in range(len(project.inputs)))


@pytest.mark.real
@pytest.mark.parametrize("file", EXAMPLES, ids=lambda p: p.stem)
def test_declared_controller_reproduces_the_recorded_op(file, real_data):
    project = tp.Project.load(file)
    for k, plan in enumerate(project.experiments):
        frame = pl.read_csv(plan.path, infer_schema_length=None)
        columns = {o.pv for o in project.outputs} | {i.op for i in project.inputs}
        assert columns <= set(frame.columns)
        controller = project.controller(k)
        if controller is None:
            continue
        r = frame.select([o.sp for o in project.outputs]).to_numpy()
        y = frame.select([o.pv for o in project.outputs]).to_numpy()
        u = frame.select([i.op for i in project.inputs]).to_numpy()
        h = float(frame["t"][1] - frame["t"][0])
        # what the integral held before the record began is not recorded: the best of whole numbers
        starts = np.arange(0, 10) if plan.name.startswith("dataset:pid_oven") else [0]
        rms = min(np.sqrt(np.mean((loop.replay(controller, r, y, h, bias=b) - u)[20:] ** 2)) for b in starts)
        assert rms < 2e-3 * np.ptp(u), plan.name


@pytest.mark.parametrize("name", DEMOS)
def test_demo_record_follows_the_declared_plant_and_not_the_model(name):
    from trueplant.lti import TransferMatrix
    from trueplant.lti.sampled import sampled_response

    project = tp.Project.from_toml(demo_text(name))
    plan = project.simulate
    assert plan is not None and isinstance(plan.plant, list)
    frame = simulate_record(project)
    u = frame.select([i.op for i in project.inputs]).to_numpy()
    y = frame.select([o.pv for o in project.outputs]).to_numpy()
    cells = {(e.output, e.input): e.tf for e in plan.plant}
    plant = TransferMatrix.of([[cells.get((o, i), 0) for i in project.input_names] for o in project.output_names])
    noise = [plan.noise[o] if isinstance(plan.noise, dict) else plan.noise for o in project.output_names]

    def residual(g):
        answer = sampled_response(g, u - u[0], plan.sample_time)
        return y - y[0] - answer - np.mean(y - y[0] - answer, axis=0)

    assert np.std(residual(plant), axis=0) == pytest.approx(noise, rel=0.06)
    assert np.max(np.std(residual(project.model_matrix()), axis=0) / noise) > 1.5
    # nothing sits at a limit, so the record is good for every method
    for j, entry in enumerate(project.inputs):
        if entry.limits is not None:
            assert entry.limits[0] < u[:, j].min() and u[:, j].max() < entry.limits[1]


def test_demo_is_the_papers_splitter():
    project = tp.Project.from_toml(demo_text("splitter"))
    model = project.model_matrix()
    assert [str(model[i, j]) for i in (0, 1) for j in (0, 1)] == [
        str(tp.tf(g)) for g in ("-0.464/(12 s + 1)", "3.2 exp(-3 s)/(18 s + 1)", "0", "3.8 exp(-0.5 s)/(2.8 s + 1)")
    ]
    assert simulate_record(project).equals(simulate_record(project))


def test_project_file_of_the_readme_is_one():
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    block = readme[readme.index("    time_unit") : readme.index("`plant.toml` is")]
    project = tp.Project.from_toml(textwrap.dedent(block))
    assert project.controller()([1e9j])[0, 0, 0].real < 0
    assert project.estimate(0, 0)
