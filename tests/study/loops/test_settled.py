"""A loop that settled refutes a plant on which it could not have; the records are simulated."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import norm

from support.one_loop import declared, one_loop
from trueplant.loop import PID, Controller, LinearLoop, unstable_poles
from trueplant.lti import KnownRow, Structure, TransferMatrix, UncertainPlant
from trueplant.study import levels
from trueplant.study.data.controller_check import check_controllers
from trueplant.study.data.prepare import prepare
from trueplant.study.loops.robustness import _drawn
from trueplant.study.loops.settled import against_settled_loop, settled_for, share_diverging
from trueplant.study.plant.identified import Identified, identify

TF = "2 exp(-13.4 s)/(60 s + 1)"
FOPDT, INTEGRATOR = Structure.parse("fopdt"), Structure.parse("integrator")


def known(structure: Structure, theta: list[float], spread: list[float]) -> UncertainPlant:
    values = np.array(theta)
    row = KnownRow((0,), (structure,), values, np.diag(np.square(spread)))
    return UncertainPlant(TransferMatrix(((structure.transfer(values),),)), {0: row})


def share(plant: UncertainPlant, law: PID, span: float) -> float:
    return share_diverging(0, LinearLoop(plant.nominal, Controller.diagonal([law])), plant, span)


def test_growth_has_to_show_within_the_record():
    """A P controller of the wrong sign on an integrator: a pole at k Kc, and nothing else."""
    plant, span = known(INTEGRATOR, [-0.02, 0.0], [0.004, 0.0]), 60.0
    expected = norm.cdf((-np.log(levels.RUNS_AWAY) / span / 2.0 + 0.02) / 0.004)
    assert share(plant, PID(Kc=2.0), span) == pytest.approx(expected, abs=0.06)
    assert 0.1 < expected < 0.9


def test_over_a_long_record_it_is_the_share_of_unstable_loops():
    plant, law = known(FOPDT, [7.0, 60.0, 13.4], [1.5, 0.0, 0.0]), PID(Kc=1.0, Ti=60.0)
    drawn = plant.draw(levels.STABILITY_DRAWS, 0)
    count = [unstable_poles(drawn.plant(k), Controller.diagonal([law])) > 0 for k in range(100)]
    assert 0.2 < np.mean(count) < 0.8
    assert share(plant, law, 1e5) == pytest.approx(np.mean(count), abs=0.12)


@pytest.fixture(scope="module")
def settled(tmp_path_factory: pytest.TempPathFactory):
    folder: Path = tmp_path_factory.mktemp("settled")
    controller = {"Kc": 1.0, "Ti": 60.0, "sample_time": 1.0}
    study = prepare(declared(folder, one_loop(3, samples=1500), TF, controller))
    return study, identify(study), check_controllers(study)


def scaled(found: Identified, factor: float) -> Identified:
    one = found.estimates[0]
    return replace(found, estimates={0: replace(one, theta=one.theta * np.array([factor, 1.0, 1.0]))})


def test_a_plant_on_which_the_loop_runs_away_is_refuted(settled):
    study, found, checks = settled
    after = against_settled_loop(study, scaled(found, 5.0), checks).estimates[0]
    assert after.refuted is not None
    assert after.refuted.text.startswith("the loop of one.csv settled, but on 100 % of the plants")


def test_no_other_is(settled):
    study, found, checks = settled
    for factor in (1.0, 2.0):
        assert against_settled_loop(study, scaled(found, factor), checks).estimates[0].refuted is None


def test_a_controller_that_is_not_confirmed_refutes_nothing(settled):
    study, found, checks = settled
    doubted = [replace(check, confirmed=False) for check in checks]
    assert against_settled_loop(study, scaled(found, 5.0), doubted).estimates[0].refuted is None
    assert against_settled_loop(study, scaled(found, 5.0), []).estimates[0].refuted is None


def test_plants_on_which_it_would_have_run_away_are_none_of_those_that_are_left_open(settled):
    """Half of the gains that are left open are too large for the loop; a short record shows only the largest."""
    study, _, _ = settled
    plant, law = known(FOPDT, [7.0, 60.0, 13.4], [1.5, 0.0, 0.0]), PID(Kc=1.0, Ti=60.0)
    loop = LinearLoop(plant.nominal, Controller.diagonal([law]))
    every, short, long = (_drawn(study, loop, plant, span) for span in (None, 600.0, 1e5))
    assert every is not None and short is not None and long is not None
    assert every.count == levels.STABILITY_DRAWS
    assert 0.2 < every.share_stable < 0.8
    stable = every.share_stable * every.count
    for found, span in ((short, 600.0), (long, 1e5)):
        assert found.count == pytest.approx((1 - share(plant, law, span)) * every.count)
        assert found.share_stable * found.count == pytest.approx(stable)
    assert long.share_stable > 0.97
    assert every.share_stable < short.share_stable < long.share_stable


def test_for_how_long_it_did_not_run_away(settled):
    study, _, checks = settled
    assert settled_for(study, checks) == pytest.approx(1499, abs=200)
    assert settled_for(study, [replace(checks[0], confirmed=False)]) is None
