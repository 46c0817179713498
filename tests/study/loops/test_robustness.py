"""What the result says about today's loop: over the plants that the data leave open, looked at one by one."""

from __future__ import annotations

import numpy as np
import pytest

from support.report_sample import LOOP
from trueplant import Project, Result
from trueplant.cli.analyse import demo_text
from trueplant.loop import PID, Controller, unstable_poles
from trueplant.lti import KnownRow, TransferMatrix, UncertainPlant, tf
from trueplant.lti.structure import Structure
from trueplant.plants import mill, splitter, wood_berry
from trueplant.project.simulation import as_file, simulate_record
from trueplant.robust import margins, robust_performance
from trueplant.study.loops.robustness import pairing_of
from trueplant.study.loops.weighted import weights_of
from trueplant.study.pipeline import analyse
from trueplant.study.plant.uncertainty import element_errors

FOPDT = Structure.parse("fopdt")
W = np.geomspace(1e-3, 30, 120)


THETA = np.array([2.0, 5.0, 1.5, -1.0, 8.0, 3.0])
"""One output, two inputs: gain, lag and dead time of each element."""


def plant_of(theta: np.ndarray) -> TransferMatrix:
    return TransferMatrix((tuple(FOPDT.transfer(p) for p in theta.reshape(2, 3)),))


def one_row(spread: np.ndarray) -> UncertainPlant:
    return UncertainPlant(plant_of(THETA), {0: KnownRow((0, 1), (FOPDT, FOPDT), THETA, spread)})


@pytest.mark.parametrize(("size", "least"), [(1e-4, 0.95), (0.3, 0.0)])
def test_errors_of_elements_bound_every_plant_of_the_confidence_region(size, least):
    """Closely where errors are small; with dead times that are uncertain by many periods not at all below."""
    shape = np.tril(np.random.default_rng(0).normal(size=(6, 6)))
    root = size * np.diag([0.05, 1, 1, 0.05, 1, 1]) @ shape / np.linalg.norm(shape)
    bound = element_errors(one_row(root @ root.T), W, 0.9)
    directions = np.random.default_rng(2).normal(size=(4000, 6))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    radius = np.sqrt(10.644640675668422)  # 90 % of chi-square with 6 degrees of freedom
    nominal = plant_of(THETA)(1j * W)
    plants = (plant_of(THETA + radius * root @ d)(1j * W) for d in directions)
    found = np.max([np.abs(plant - nominal) for plant in plants], axis=0)
    assert np.all(found <= 1.1 * bound)
    assert np.all(found > least * bound)


def test_error_of_a_dead_time_is_never_counted_as_more_than_turning_round():
    known = one_row(np.diag([0.0, 0.0, 4.0, 0.0, 0.0, 0.0]))
    assert known.varying == 1
    bound = element_errors(known, W, 0.9)
    nominal = np.abs(known.nominal(1j * W))
    reach = 2.0 * 1.6448536269514722  # 90 % of a normal variable
    assert bound[:, :, 0] == pytest.approx(nominal[:, :, 0] * np.minimum(reach * W, 2)[:, None], rel=1e-4)
    assert np.all(bound[:, :, 1] == 0)


def test_each_delayed_term_has_a_dead_time_of_its_own():
    """2 exp(-s)/(5 s + 1) - exp(-3 s)/(5 s + 1): an error of the second dead time moves the second term only."""
    structure = Structure.parse("fopdt+delayed")
    theta = np.array(
        [{"gain1": 2.0, "gain2": -1.0, "tau1": 5.0, "dead_time1": 1.0, "dead_time2": 3.0}[n] for n in structure.names]
    )
    covariance = np.diag([1e-4 if name == "dead_time2" else 0.0 for name in structure.names])
    known = UncertainPlant(
        TransferMatrix(((structure.transfer(theta),),)), {0: KnownRow((0,), (structure,), theta, covariance)}
    )
    reach = 1e-2 * 1.6448536269514722
    alone = np.abs(1 / (5j * W + 1)) * np.minimum(reach * W, 2)
    assert element_errors(known, W, 0.9)[:, 0, 0] == pytest.approx(alone, rel=1e-4)


# -- in a result ----------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def result(tmp_path_factory) -> Result:
    folder = tmp_path_factory.mktemp("splitter")
    weights = "\n[robustness]\nwI = {gain_percent = 15, dead_time = 0.2}\nwP = {bandwidth = 0.03}\n"
    project = Project.from_toml(demo_text("splitter") + weights, folder)
    (folder / "record.csv").write_bytes(as_file(simulate_record(project), "record.csv"))
    return analyse(project)


def estimated(result: Result) -> TransferMatrix:
    found = {(e.output, e.input): e.tf_plant for e in result.elements}
    outputs, inputs = ("top_temperature", "vaporisation"), ("reflux", "fuel_gas")
    return TransferMatrix.of([[found.get((y, u)) or "0" for u in inputs] for y in outputs], "min")


def law(_: Result) -> Controller:
    """That of the demo: the diagonal of its two PI controllers."""
    controller = Project.from_toml(demo_text("splitter")).controller(0)
    assert controller is not None
    return controller


def test_peaks_under_the_declared_uncertainty_are_those_of_the_library(result):
    wI, wP = tf("((1 + 0.075)*0.2 s + 0.15)/(0.1 s + 1)"), tf("(0.5 s + 0.03)/s")
    for name, plant in (("model", splitter().model), ("plant", estimated(result))):
        found = robust_performance(plant, law(result), wI, wP)
        said = result.to_dict()["robustness"]["peaks"][name]
        for test in ("NP", "RS", "RP"):
            assert said[test]["upper"] == pytest.approx(getattr(found, test).upper, rel=1e-4)
        assert said["robust_performance_holds"] is found.passes


def test_worst_plant_reaches_the_peak_and_stays_in_the_uncertainty(result):
    said = result.to_dict()["robustness"]["peaks"]["plant"]
    found = {(e["output"], e["input"]): e["tf"] for e in said["worst_plant"]}
    outputs, inputs = ("top_temperature", "vaporisation"), ("reflux", "fuel_gas")
    worst = TransferMatrix.of([[found.get((y, u), "0") for u in inputs] for y in outputs], "min")
    s, controller = np.array([1j * said["RP"]["frequency"]]), law(result)
    assert unstable_poles(worst, controller) == 0
    S = np.linalg.inv(np.eye(2) + worst(s) @ controller(s))
    reached = np.abs(tf("(0.5 s + 0.03)/s")(s)) * np.linalg.norm(S, ord=2, axis=(1, 2))
    assert reached[0] == pytest.approx(said["RP"]["lower"], rel=1e-3)
    # G (I + wI Delta): the relative change of each column is wI delta_j, with |delta_j| = 1/mu
    dense = 1j * np.geomspace(1e-3, 30, 50)
    change = worst(dense)[:, [0, 1], [0, 1]] / estimated(result)(dense)[:, [0, 1], [0, 1]] - 1
    allowed = np.abs(tf("((1 + 0.075)*0.2 s + 0.15)/(0.1 s + 1)")(dense))[:, None] / said["RP"]["lower"]
    assert np.abs(change) == pytest.approx(np.broadcast_to(allowed, change.shape), rel=1e-3)


def test_curves_hold_the_peaks(result):
    assert result.curves is not None
    for curves in result.curves.mu:
        for test, bounds in curves.bounds.items():
            frequency, peak = curves.peaks[test]
            assert bounds.shape == (curves.w.size, 2) and np.all(bounds[:, 0] <= bounds[:, 1] * (1 + 1e-9))
            assert bounds[:, 1].max() <= peak * (1 + 1e-9) and bounds[:, 1].max() > 0.98 * peak
            near = curves.w[np.argmax(bounds[:, 1])]
            assert near == pytest.approx(frequency, rel=0.2) if frequency else near == curves.w[0]
    assert [c.system for c in result.curves.mu] == ["model", "plant", "estimate"]


def plants_of_the_region(result: Result, count: int) -> list[TransferMatrix]:
    """Plants inside the intervals of the parameters, each shrunk so that all together fit the joint region."""
    rng = np.random.default_rng(11)
    drawn = []
    for _ in range(count):
        rows = {}
        for e in result.elements:
            p = {q.name: rng.normal(q.plant, 0.5 * q.std_error) for q in e.parameters}
            rows[e.output, e.input] = f"{p['gain']} exp(-{max(p['dead_time'], 0)} s)/({p['tau1']} s + 1)"
        outputs, inputs = ("top_temperature", "vaporisation"), ("reflux", "fuel_gas")
        drawn.append(TransferMatrix.of([[rows.get((y, u), "0") for u in inputs] for y in outputs], "min"))
    return drawn


def test_robust_performance_of_the_estimate_holds_for_the_plants_it_speaks_of(result):
    said = result.to_dict()["robustness"]["peaks"]["estimate"]
    assert said["robust_performance_holds"] and said["RP"]["upper"] < 1
    assert result.to_dict()["robustness"]["peaks"]["plant"]["NP"]["upper"] < said["RP"]["upper"] and "NP" not in said
    s, controller, asked = 1j * np.geomspace(1e-4, 30, 500), law(result), tf("(0.5 s + 0.03)/s")
    for plant in plants_of_the_region(result, 40):
        assert unstable_poles(plant, controller) == 0
        S = np.linalg.inv(np.eye(2) + plant(s) @ controller(s))
        assert np.max(np.abs(asked(s)) * np.linalg.norm(S, ord=2, axis=(1, 2))) < said["RP"]["upper"]


def test_peaks_of_drawn_loops_lie_between_those_at_the_ends_of_the_intervals(result):
    drawn = result.to_dict()["robustness"]["drawn"]
    assert drawn["share_stable"] == 1.0 and drawn["share_performance"] == 1.0 and drawn["count"] == 500
    fuel = next(row for row in drawn["loops"] if row["input"] == "fuel_gas")
    assert fuel["share"] == 1.0
    element = next(e for e in result.elements if (e.output, e.input) == ("vaporisation", "fuel_gas"))
    # the other loop does not reach this one: the vaporisation does not answer to the reflux
    low, high = (
        margins(
            TransferMatrix.of([[f"{k} exp(-{dead} s)/({tau} s + 1)"]], "min"),
            Controller({(0, 0): law(result).entries[1, 1]}, 1, 1),
        ).Ms
        for k, tau, dead in (
            [p.plant + sign * 1.645 * p.std_error * (-1 if p.name == "tau1" else 1) for p in element.parameters]
            for sign in (-1, 1)
        )
    )
    assert low < fuel["Ms_q50"] < fuel["Ms_q95"] < high


@pytest.mark.parametrize("declared", ["{%s}", '[{output = "top_temperature", input = "reflux", %s}]'])
def test_real_errors_of_elements(tmp_path, declared):
    """All plants of the set are looked at, and the worst of them is where the peak says."""
    errors = "gain_percent = 15, dead_time = 0.4"
    text = LOOP.split("[tuning]")[0].replace(f"wI = {{{errors}}}", f"elements = {declared % errors}")
    project = Project.from_toml(text + "[simulate]" + LOOP.split("[simulate]")[1], tmp_path)
    (tmp_path / "record.csv").write_bytes(as_file(simulate_record(project), "record.csv"))
    found = analyse(project)
    said, law = found.to_dict()["robustness"]["peaks"]["plant"], project.controller(0)
    wP = weights_of(project.robustness.wP)
    w = np.geomspace(1e-4, 30, 400)

    def reached(element: str, at: np.ndarray) -> np.ndarray:
        plant = TransferMatrix.of([[element]], "min")
        assert unstable_poles(plant, law) == 0
        return np.abs(wP(1j * at) / (1 + (plant(1j * at) @ law(1j * at))[:, 0, 0]))

    values = {p.name: p.plant for p in found.elements[0].parameters}
    every = [
        f"{values['gain'] * gain} exp(-{values['dead_time'] + later} s)/({values['tau1']} s + 1)"
        for gain in np.linspace(0.85, 1.15, 5)
        for later in np.linspace(-0.4, 0.4, 5)
    ]
    assert (max(reached(one, w).max() for one in every) < 1) == said["robust_performance_holds"]
    worst = said["worst_plant"][0]["tf"]
    assert reached(worst, np.array([said["RP"]["frequency"]]))[0] == pytest.approx(said["RP"]["lower"], rel=1e-3)


def test_what_the_loop_cannot_meet_is_said(tmp_path):
    """P control leaves an offset: no bound of an integrating weight. Without wI only what a wP can say is said."""
    law = LOOP.split("[tuning]")[0].replace("Kc = 0.6, Ti = 8.0", "Kc = 0.7")
    law = law.replace("wI = {gain_percent = 15, dead_time = 0.4}\n", "")
    project = Project.from_toml(law + "[simulate]" + LOOP.split("[simulate]")[1], tmp_path)
    (tmp_path / "record.csv").write_bytes(as_file(simulate_record(project), "record.csv"))
    found = analyse(project)
    peaks = found.to_dict()["robustness"]["peaks"]
    assert peaks["plant"]["NP"] == {"lower": None, "upper": None, "frequency": 0.0} and "RP" not in peaks["plant"]
    assert peaks["plant"]["robust_performance_holds"] is None and peaks["estimate"]["RS"]["upper"] < 1
    assert peaks["estimate"]["robust_performance_holds"] is False
    said = next(note.message for note in found.notes if note.code == "robust-performance")
    assert "wP integrates and the loop does not" in said
    assert found.to_dict()["robustness"]["drawn"]["share_performance"] == 0.0


def test_pairing_of_the_wrong_sign_is_named():
    wrong = TransferMatrix.of([["1/(s + 1)", "2/(s + 1)"], ["2/(s + 1)", "1/(s + 1)"]])
    right = TransferMatrix.of([["2/(s + 1)", "1/(s + 1)"], ["1/(s + 1)", "2/(s + 1)"]])
    diagonal = Controller.diagonal([PID(Kc=0.1, Ti=1.0), PID(Kc=0.1, Ti=1.0)])
    found = pairing_of(("a", "b"), diagonal, {"model": right, "plant": wrong})
    assert found["model"].wrong_sign == () and found["plant"].wrong_sign == ("a", "b")
    assert found["plant"].niederlinski == pytest.approx(-3) and found["model"].niederlinski == pytest.approx(0.75)
    assert found["plant"].rga[0][0] == pytest.approx(-1 / 3)
    # with integral action in both loops it is unstable, as the index says
    assert unstable_poles(wrong, diagonal) > 0 and unstable_poles(right, diagonal) == 0
    crossed = Controller({(0, 1): PID(Kc=0.1, Ti=1.0), (1, 0): PID(Kc=0.1, Ti=1.0)}, 2, 2)
    found = pairing_of(("a", "b"), crossed, {"plant": wrong})
    assert found["plant"].wrong_sign == () and found["plant"].niederlinski == pytest.approx(0.75)
    assert unstable_poles(wrong, crossed) == 0


def test_pairing_says_nothing_where_it_means_nothing():
    case = mill()
    assert pairing_of(("a", "b"), Controller({(0, 0): PID(Kc=-1.0, Ti=3.0)}, 2, 2), {"model": case.model}) == {}
    integrating = TransferMatrix.of([["1/s", "0"], ["0", "1/(s + 1)"]])
    law = Controller.diagonal([PID(Kc=1.0), PID(Kc=1.0, Ti=1.0)])
    assert pairing_of(("a", "b"), law, {"model": integrating}) == {}
    column = wood_berry()
    assert pairing_of(("a", "b"), column.controller, {"model": column.model})["model"].rga[0][0] == pytest.approx(
        2.01, abs=5e-3
    )
