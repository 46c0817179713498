"""Net gain, total delay and response of elements: closed forms, draws, coverage, and what is not told.

All records are simulated.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from support import two_loops
from support.one_loop import declared
from support.simulated import WOOD_BERRY, coloured, random_switching, wood_berry
from trueplant import Project, tf
from trueplant.cli.analyse import demo_text
from trueplant.loop import PID, Controller, simulate
from trueplant.lti import TransferMatrix, UncertainPlant
from trueplant.project.simulation import as_file, simulate_record
from trueplant.result import Derived, Element, ElementVerdict
from trueplant.study.data.prepare import prepare
from trueplant.study.loops.derived import with_derived
from trueplant.study.plant.elements import judge
from trueplant.study.plant.identified import identify
from trueplant.study.plant.updated import updated_plant

TRUE_GAIN, TRUE_LAG, TRUE_DEAD_TIME = 2.4, 9.0, 2.3
PLANT = TransferMatrix.of([[f"{TRUE_GAIN} exp(-{TRUE_DEAD_TIME} s)/({TRUE_LAG} s + 1)"]])
LAW = {"Kc": 0.9, "Ti": 9.0, "sample_time": 1.0}


def known(project: Project) -> tuple[UncertainPlant, tuple[Element, ...]]:
    """As `analyse` does it, without what comes after."""
    study = prepare(project)
    identified = identify(study)
    plant = updated_plant(study.model, identified.estimates)
    return plant, with_derived(study, plant.nominal, judge(study, identified, plant.nominal)).elements


def one_loop(seed: int, folder: Path, controller: bool = True) -> tuple[UncertainPlant, Element]:
    rng = np.random.default_rng(seed)
    r = random_switching(rng, 500, 1, 40.0)
    v = coloured(rng, 500, 1, [1, -0.6], [1], 0.15)
    record = simulate(PLANT, Controller.diagonal([PID(**LAW)]), r, 1.0, v=v)
    plant, (element,) = known(declared(folder, record, "2 exp(-2 s)/(10 s + 1)", LAW if controller else None))
    return plant, element


def by_name(element: Element) -> dict[tuple[str, str], Derived]:
    return {(one.name, one.at): one for one in element.derived}


def truth(w: float) -> dict[str, float]:
    """What the plant does at a frequency: written down, not computed by the package."""
    return {
        "net_gain": TRUE_GAIN,
        "total_delay": TRUE_LAG / (1 + (w * TRUE_LAG) ** 2) + TRUE_DEAD_TIME,
        "magnitude": TRUE_GAIN / np.hypot(1, w * TRUE_LAG),
        "phase": -np.degrees(np.arctan(w * TRUE_LAG) + w * TRUE_DEAD_TIME),
    }


def test_a_first_order_element_by_hand(tmp_path):
    """Values, and standard errors from derivatives written down for K exp(-theta s)/(tau s + 1)."""
    plant, element = one_loop(1, tmp_path)
    found, (K, tau, theta) = by_name(element), plant.rows[0].theta
    covariance = plant.rows[0].covariance
    w = found["phase", "crossover"].frequency
    size = np.hypot(1, w * tau)
    # where the declared loop has a gain of 1, up to the grid
    assert abs(PID(**LAW).feedback(np.array([1j * w]))[0]) * abs(K) / size == pytest.approx(1, rel=0.1)
    expected = {
        ("net_gain", "rest"): (K, [1, 0, 0]),
        ("total_delay", "rest"): (tau + theta, [0, 1, 1]),
        ("total_delay", "crossover"): (tau / size**2 + theta, [0, (1 - (w * tau) ** 2) / size**4, 1]),
        ("magnitude", "crossover"): (K / size, [1 / size, -K * w**2 * tau / size**3, 0]),
        ("phase", "crossover"): (
            -np.degrees(np.arctan(w * tau) + w * theta),
            np.degrees([0, -w / size**2, -w]),
        ),
    }
    assert set(found) == set(expected)
    for place, (value, slope) in expected.items():
        error = np.sqrt(np.array(slope) @ covariance @ np.array(slope))
        one = found[place]
        assert one.plant == pytest.approx(value) and one.std_error == pytest.approx(error)
        assert one.ci == pytest.approx((value - 1.959964 * error, value + 1.959964 * error), rel=1e-6)
    gain = element.parameters[0]
    assert (gain.plant, gain.std_error, gain.unit) == (K, found["net_gain", "rest"].std_error, "")
    assert found["magnitude", "crossover"].model == pytest.approx(2 / np.hypot(1, 10 * w))
    assert found["phase", "crossover"].model == pytest.approx(-np.degrees(np.arctan(10 * w) + 2 * w))


def test_it_agrees_with_the_plants_that_are_drawn(tmp_path):
    plant, element = one_loop(2, tmp_path)
    found = by_name(element)
    magnitude, phase = found["magnitude", "crossover"], found["phase", "crossover"]
    drawn = plant.draw(4000, 0).response(np.array([magnitude.frequency]))[:, 0, 0, 0]
    assert magnitude.ci == pytest.approx(tuple(np.quantile(np.abs(drawn), [0.025, 0.975])), rel=0.01)
    assert phase.ci == pytest.approx(tuple(np.quantile(np.degrees(np.angle(drawn)), [0.025, 0.975])), rel=0.02)


def test_without_a_controller_the_response_is_at_the_corner(tmp_path):
    plant, element = one_loop(3, tmp_path, controller=False)
    found = by_name(element)
    w = found["magnitude", "corner"].frequency
    assert w == pytest.approx(1 / np.sum(plant.rows[0].theta[1:]))
    assert found["phase", "corner"].plant == pytest.approx(np.degrees(np.angle(plant.nominal[0, 0](1j * w))))


@pytest.mark.slow
def test_intervals_cover(tmp_path):
    """200 records: three standard deviations of 95 % coverage by the binomial are 4.6 %."""
    hits: dict[tuple[str, str], list[bool]] = {}
    for seed in range(200):
        _, element = one_loop(1000 + seed, tmp_path)
        for place, one in by_name(element).items():
            true = truth(one.frequency)[one.name]
            hits.setdefault(place, []).append(one.ci is not None and one.ci[0] <= true <= one.ci[1])
    assert len(hits) == 5
    for place, inside in hits.items():
        assert len(inside) == 200
        assert 0.91 <= np.mean(inside) <= 0.98, (place, np.mean(inside))


def demo(folder: Path) -> Project:
    project = Project.from_toml(demo_text("mill"), folder)
    record = project.data.files[0]
    (folder / record).write_bytes(as_file(simulate_record(project), record))
    return project


def test_two_delayed_terms_have_a_net_gain_although_neither_gain_is_known(tmp_path):
    """The mill: the gains cancel but for a hundredth of each. The record is that of `trueplant demo mill`."""
    project = demo(tmp_path)
    plant, elements = known(project)
    element = next(e for e in elements if (e.output, e.input) == ("particle_size", "dilution_water"))
    gains = {p.name: p for p in element.parameters}
    net = by_name(element)["net_gain", "rest"]
    assert net.plant is not None and net.std_error is not None and gains["gain1"].std_error is not None
    assert net.std_error < 1e-3 < 0.01 * gains["gain1"].std_error
    assert abs(net.plant - 4 * (1 - 1.0137)) < 3 * net.std_error
    assert net.model == pytest.approx(4 * (1 - 0.9938))
    _, drawn = plant.draw(4000, 0).parameters[0, 1]
    assert np.std(drawn[:, :2].sum(axis=1)) == pytest.approx(net.std_error, rel=0.1)


def test_what_is_known_of_a_sum_is_in_the_draws_where_neither_gain_is_known(tmp_path):
    """One gain is held then, and the other beside it as surely known as their sum."""
    study = prepare(demo(tmp_path))
    estimate = identify(study).estimates[0]
    (m,) = (m for m, spec in enumerate(estimate.row.specs) if spec.column == 1)
    first = estimate.row.slices[m].start
    away = np.zeros(estimate.theta.size)
    away[first : first + 2] = 3.0, -3.0
    unsure = replace(estimate, covariance=estimate.covariance + np.outer(away, away))
    _, drawn = updated_plant(study.model, {0: unsure}).draw(4000, 0).parameters[0, 1]
    assert sorted(np.std(drawn[:, :2], axis=0) > 1e-6) == [False, True]
    known_sum = np.sqrt(estimate.covariance[first : first + 2, first : first + 2].sum())
    assert np.std(drawn[:, :2].sum(axis=1)) == pytest.approx(known_sum, rel=0.1)


@pytest.mark.filterwarnings("error")
def test_of_what_is_known_to_rounding_nothing_is_drawn(tmp_path):
    """Two gains of which next to nothing is known but their sum: given one, all that is left of the other is rounding,
    on either side of 0."""
    study = prepare(demo(tmp_path))
    estimate = identify(study).estimates[0]
    (m,) = (m for m, spec in enumerate(estimate.row.specs) if spec.column == 1)
    first = estimate.row.slices[m].start
    for size in np.geomspace(1e7, 1e9, 20):
        away = np.zeros(estimate.theta.size)
        away[first : first + 2] = size, -size
        unsure = replace(estimate, covariance=estimate.covariance + np.outer(away, away))
        (row,) = updated_plant(study.model, {0: unsure}).rows.values()
        assert np.all(np.diag(row.covariance) >= 0)


def test_what_has_no_gain_has_no_delay(tmp_path):
    """Of an element that the plant no longer has, the gain is known to be about zero, and its dynamics are not."""
    plant = two_loops.scaled(0, 1, 1e-4)
    two_loops.written(tmp_path, "record.csv", wood_berry(4, 2000, plant=plant))
    _, elements = known(two_loops.project(tmp_path, controller=two_loops.CONTROLLERS))
    element = next(e for e in elements if (e.output, e.input) == ("top", "steam"))
    assert element.verdict == ElementVerdict.CHANGED
    found = by_name(element)
    net = found["net_gain", "rest"]
    assert net.ci is not None and net.ci[0] < 0 < net.ci[1] and net.model == pytest.approx(-18.9)
    for one in element.derived:
        if one is not net:
            assert one.plant is None and one.ci is None and "cannot be told from zero" in one.reason
            assert one.model is not None
    others = [one for e in elements if e is not element for one in e.derived]
    assert all(one.plant is not None for one in others) and len(others) == 15


def test_an_element_that_the_model_lacks_has_no_phase_there(tmp_path):
    rows = [list(row) for row in WOOD_BERRY.elements]
    rows[1][0] = tf("0")
    two_loops.written(tmp_path, "record.csv", wood_berry(5, 2000))
    model = TransferMatrix(tuple(map(tuple, rows)), "min")
    _, elements = known(two_loops.project(tmp_path, model, controller=two_loops.CONTROLLERS))
    found = by_name(next(e for e in elements if (e.output, e.input) == ("bottom", "reflux")))
    assert found["net_gain", "rest"].model == 0.0 and found["magnitude", "crossover"].model == 0.0
    assert found["phase", "crossover"].model is None and found["total_delay", "rest"].model is None
    net = found["net_gain", "rest"]
    assert net.ci is not None and net.ci[0] < 6.6 < net.ci[1]


def test_of_an_input_that_stands_still_nothing_is_said(tmp_path):
    rng = np.random.default_rng(7)
    law = Controller.diagonal([PID(**LAW)])
    record = simulate(PLANT, law, random_switching(rng, 500, 1, 40.0), 1.0, noise=0.05, seed=7)
    project = declared(tmp_path, record, "2 exp(-2 s)/(10 s + 1)", LAW)
    still = pl.read_csv(tmp_path / "one.csv").with_columns(other=pl.lit(40.0))
    still.write_csv(tmp_path / "one.csv")
    more = """
[[input]]
name = "other"
op = "other"

[[model]]
output = "y"
input = "other"
tf = "1 exp(-3 s)/(5 s + 1)"
"""
    _, elements = known(Project.from_toml(project.to_toml() + more, tmp_path))
    found = {e.input: e.derived for e in elements}
    assert len(found["other"]) == len(found["u"]) == 5
    for one in found["other"]:
        assert one.plant is None and one.std_error is None and one.ci is None
        assert one.model is not None and "does not move" in one.reason
    net = found["u"][0]
    assert net.plant is not None and net.std_error is not None
    assert abs(net.plant - TRUE_GAIN) < 3 * net.std_error
