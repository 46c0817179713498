"""Table, formula, plant.toml, bands, uncertainty and draws of one analysis come from the same numbers."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from jsonschema import Draft202012Validator

from support import ROOT
from support.budgets import sources_of
from trueplant import Project, tf
from trueplant.cli.analyse import demo_text
from trueplant.lti import TransferFunction, UncertainPlant, sampled_response, structure_of
from trueplant.lti.delay import total_delay
from trueplant.output import read_results, write_results
from trueplant.project.simulation import as_file, simulate_record
from trueplant.result import Derived, Result, Source
from trueplant.result.schema import published
from trueplant.study import levels
from trueplant.study.pipeline import analyse

EXAMPLES = sorted(path.stem for path in (ROOT / "examples").glob("*.toml"))
DEMOS = ("splitter", "mill", "wood-berry")


def simulated(name: str, folder: Path) -> Project:
    """A built-in case with its simulated record; the mill and the splitter are the paper's."""
    project = Project.from_toml(demo_text(name), folder)
    record = project.data.files[0]
    (folder / record).write_bytes(as_file(simulate_record(project), record))
    return project


def holds_together(project: Project, folder: Path) -> Result:
    result = analyse(project)
    written = write_results(result, project, folder / "out")
    document = json.loads(written["result.json"].read_text())
    Draft202012Validator(published("result.json")).validate(document)
    again = read_results(folder / "out")
    assert again.to_dict() == {key: value for key, value in document.items() if key != "files"}
    plant = result.plant
    if result.status == "refused" or plant is None:
        assert not any(p.plant is not None for e in result.elements for p in e.parameters)
        return result
    outputs, inputs = project.output_names, (*project.input_names, *project.disturbance_names)
    file = Project.load(written["plant.toml"])
    estimated = {(outputs[i], inputs[j]) for i, row in plant.rows.items() for j in row.columns}
    seed, tail = project.analysis.seed, (1 - project.analysis.confidence) / 2
    drawn = plant.draw(levels.STEP_DRAWS, seed).parameters
    assert Source.NOISE in sources_of(result)
    assert again.plant is not None and result.curves is not None
    for e in result.elements:
        i, j = outputs.index(e.output), inputs.index(e.input)
        told = [p for p in e.parameters if p.plant is not None]
        assert bool(told) == ((e.output, e.input) in estimated)
        if not told:
            continue
        row = plant.rows[i]
        m = row.columns.index(j)
        part, structure = row.slices[m], row.structures[m]
        order = structure.sorted(row.theta[part])
        # of the output: parameters, or elements as a whole, of which nothing is known
        held = bool(row.unknown) or len(row.columns) < sum(one.output == e.output for one in result.elements)
        for k, p in zip(order, e.parameters, strict=True):
            if p.plant is not None:  # the table
                assert row.theta[part][k] == p.plant
                # what is drawn is drawn under the condition that what is not known stays where it is
                drawn_error = np.sqrt(row.covariance[part, part][k, k])
                assert drawn_error <= p.std_error * (1 + 1e-9)
                assert held or drawn_error == pytest.approx(p.std_error)
            else:
                # of several that are not known each, the last is where those held before leave it
                assert part.start + k in row.unknown or any(one in row.unknown for one in range(part.start, part.stop))
        for one in e.derived:
            if one.plant is not None:
                derived_from(one, plant, (i, m), held)
        own = structure.transfer(row.theta[part])
        same(plant.nominal[i, j], own, rtol=1e-12)
        same(again.plant.nominal[i, j], own, rtol=1e-12)
        assert e.tf_plant is not None  # formulas have six digits
        same(tf(e.tf_plant), own)
        declared = file.model_matrix() if j < len(project.inputs) else file.disturbance_matrix()
        assert declared is not None
        same(declared[i, j if j < len(project.inputs) else j - len(project.inputs)], own)
        if j >= len(project.inputs):
            continue
        t = result.curves.step_t
        step = sampled_response(own, np.ones(t.size), t[1], "zoh")
        np.testing.assert_allclose(result.curves.step_plant[:, i, j], step, rtol=1e-9, atol=1e-12)
        found, parameters = drawn[i, j]
        bands = [sampled_response(found.transfer(p), np.ones(t.size), t[1]) for p in parameters]
        low, high = np.quantile(bands, [tail, 1 - tail], axis=0)
        np.testing.assert_allclose(result.curves.step_low[:, i, j], low, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(result.curves.step_high[:, i, j], high, rtol=1e-9, atol=1e-12)
    return result


def derived_from(one: Derived, plant: UncertainPlant, place: tuple[int, int], held: bool) -> None:
    """Values and standard errors of what follows from the parameters: those of the plant and its covariance.

    What is held in the plant's covariance is not in these: where a parameter is not known they are larger.
    """
    i, m = place
    row = plant.rows[i]
    structure, part = row.structures[m], row.slices[m]
    theta, covariance, s = row.theta[part], row.covariance[part, part], np.array([1j * one.frequency])
    if one.name in ("net_gain", "net_slope"):
        value, slope = theta[structure.is_gain].sum(), structure.is_gain.astype(float)
    elif one.name == "total_delay":
        value, slope = total_delay(structure, theta, one.frequency)
    else:
        g = structure.transfer(theta)(s)[0]
        relative = structure.gradient(theta, s)[0] / g
        value, slope = {
            "magnitude": (abs(g), abs(g) * relative.real),
            "phase": (np.degrees(np.angle(g)), np.degrees(relative.imag)),
        }[one.name]
    gap = one.plant - value
    assert abs((gap + 180) % 360 - 180 if one.name == "phase" else gap) < 1e-9 * max(abs(value), 1)
    drawn_error = np.sqrt(slope @ covariance @ slope)
    assert drawn_error <= one.std_error * (1 + 1e-6)
    assert held or drawn_error == pytest.approx(one.std_error)


def same(one: TransferFunction, other: TransferFunction, rtol: float = 2e-5) -> None:
    kind, parameters = structure_of(other)
    rate = 1 / max(kind.lag(parameters), 1e-3)
    s = 1j * rate * np.array([0.01, 0.1, 1.0])
    size = sum(np.abs(TransferFunction((term,))(s)) for term in other.terms)  # delayed terms may nearly cancel
    assert np.all(np.abs(one(s) - other(s)) <= rtol * size)


@pytest.mark.parametrize("name", DEMOS)
def test_demos_hold_together(name, tmp_path):
    assert holds_together(simulated(name, tmp_path), tmp_path).status == "ok"


@pytest.mark.real
@pytest.mark.slow
@pytest.mark.parametrize("name", EXAMPLES)
def test_examples_hold_together(name, tmp_path, real_data):
    holds_together(Project.load(ROOT / "examples" / f"{name}.toml"), tmp_path)
