"""What the estimators of the literature look at: lines of judgement, each held from just inside and just outside."""

from __future__ import annotations

from importlib import import_module
from types import SimpleNamespace as Stub
from typing import Any

import numpy as np
import pytest

from support.simulated import segment_of
from trueplant.identify.instrumental import choice, closed_loop, initial, noise
from trueplant.identify.instrumental.order import Order
from trueplant.identify.varx import _enough, _settling
from trueplant.loop import PID, Controller
from trueplant.lti import TransferMatrix

Array = np.ndarray
equation_error: Any = import_module("trueplant.identify.equation_error")
subspace: Any = import_module("trueplant.identify.subspace")


def white(n: int, columns: int = 1, seed: int = 1) -> Array:
    return np.random.default_rng(seed).standard_normal((n, columns))


# -- the black box ---------------------------------------------------------------------------------------------------


@pytest.mark.holds("identify.VARX_SPAN")
def test_a_black_box_remembers_two_lags_of_the_plant_and_its_dead_time() -> None:
    element = TransferMatrix.of([["2 exp(-5 s)/((10 s + 1)(3 s + 1))"]], "min")[0, 0]
    assert 20 < _settling(element) < 35


@pytest.mark.holds("identify.SAMPLES_PER_COEFFICIENT")
@pytest.mark.parametrize(("samples", "enough"), [(230, False), (450, True)])
def test_each_coefficient_of_a_black_box_has_eight_samples(samples: int, enough: bool) -> None:
    """Twenty lags of one PV and one OP: forty."""
    assert _enough([(white(samples + 20), white(samples + 20))], 20) is enough


@pytest.mark.holds("identify.SUBSPACE_LARGEST_ORDER")
def test_a_state_space_model_has_forty_states_at_most(monkeypatch: Any) -> None:
    """Of sixty directions that the past has, none of which says enough."""
    tried: list[int] = []
    monkeypatch.setattr(subspace, "_realised", lambda states, rows: tried.append(states.shape[1]) or (None,) * 4)
    monkeypatch.setattr(subspace, "SubspaceModel", lambda *_: Stub(response=lambda w: (None, None)))
    monkeypatch.setattr(subspace, "replace", lambda model, reason: reason)
    p_values = np.zeros((1, 1))
    first = Stub(lags=60, B=np.zeros((60, 1, 1)), A=0.5 * white(60, 1)[:, :, None], h=1.0, noise=np.eye(1))
    first.B = white(60, 1, 2)[:, :, None]
    first.tested, first.distance = None, lambda response, w: (p_values, None)
    monkeypatch.setattr(subspace, "varx", lambda segments, lags: first)
    monkeypatch.setattr(subspace, "regression", lambda *_: Stub(past=white(4000, 120), y=white(4000)))
    assert "largest tried" in subspace.subspace([], None)
    assert 30 < max(tried) < 55


# -- the paper's error model -----------------------------------------------------------------------------------------


@pytest.mark.holds("identify.PAPER_LARGEST_ORDER")
def test_the_papers_error_model_has_five_poles_at_most(monkeypatch: Any) -> None:
    tried: list[int] = []

    def noted(r: Any, e: Any, h: float, n: int, m: int, lam: float) -> Any:
        tried.append(n)
        raise equation_error.Refused("enough")

    monkeypatch.setattr(equation_error, "equation_error", noted)
    equation_error._best([white(100)], [white(100)[:, 0]], 1.0, None, None)
    assert 3 < max(tried) < 8


@pytest.mark.holds("identify.PAPER_FASTEST")
def test_the_papers_plant_is_reduced_up_to_twice_the_fastest_pole_of_the_model() -> None:
    """Noise (simulated), a model with a pole at 0.1 rad/min."""
    n, h = 500, 0.5
    columns = {"r": np.sign(white(n)), "u": white(n, seed=2), "y": white(n, seed=3)}
    segment = segment_of(Stub(h=h, t=h * np.arange(n), **columns))  # type: ignore[arg-type]
    model = TransferMatrix.of([["2/(10 s + 1)"]], "min")
    found = equation_error.paper_route([segment], model, Controller.diagonal([PID(Kc=1.0, Ti=10.0)]), {})
    assert 0.15 < found.w.max() < 0.3


# -- instrumental variables ------------------------------------------------------------------------------------------


@pytest.mark.holds("identify.ORDER_WHITENING")
def test_structures_are_compared_beside_noise_of_eight_coefficients(monkeypatch: Any) -> None:
    raw = [white(500)[:, 0]]
    monkeypatch.setattr(choice, "best_from_guesses", lambda orders, samples: Stub(point=Stub(raw=raw)))
    samples: Any = [Stub(valid=np.ones(500, dtype=bool))]
    assert 5 < choice._whitening([], samples).d.size < 13


@pytest.mark.holds("identify.HOPELESS")
@pytest.mark.parametrize(("times", "kept"), [(2.0, 2), (4.5, 1)])
def test_a_minimum_over_dead_time_is_left_out_that_costs_three_times_the_best(
    times: float, kept: int, monkeypatch: Any
) -> None:
    """Two minima, one at a dead time of 2 and one at 8."""

    def refined(orders: Any, theta: Any, samples: Any, rounds: int) -> Any:
        dead_time = orders[0].dead_time
        cost = 1 + (dead_time - 2) ** 2 if dead_time < 5 else times + (dead_time - 8) ** 2
        return Stub(theta=np.array([1.0, dead_time]), point=Stub(cost=cost))

    monkeypatch.setattr(initial, "_attempt", lambda order, samples, lam: Stub(theta=None, lam=1.0, cost=1.0))
    monkeypatch.setattr(initial, "refine", refined)
    monkeypatch.setattr(Order, "keeps_dead_time", property(lambda self: True))
    samples: Any = [Stub(span=100.0, t=np.arange(101.0))]
    found = initial.scan(Order(0, 1, dead_time=(0.0, 10.0)), samples)
    assert [float(theta[-1]) for _, theta in found] == [2.0, 8.0][:kept]


@pytest.mark.holds("identify.LONGEST_DEAD_TIME")
def test_a_dead_time_that_nobody_declared_is_looked_for_up_to_a_tenth_of_the_record(monkeypatch: Any) -> None:
    tried: list[float] = []
    monkeypatch.setattr(initial, "_attempt", lambda order, *_: tried.append(order.dead_time) and None)
    samples: Any = [Stub(span=300.0, t=np.arange(301.0))]
    with pytest.raises(initial.Refused, match="no dead time"):
        initial.scan(Order(0, 1, dead_time=None), samples)
    assert 20 < max(tried) < 45


@pytest.mark.holds("identify.LONGEST_AR")
def test_an_autoregression_from_which_an_arma_model_begins_has_sixty_coefficients_at_most(monkeypatch: Any) -> None:
    """Of a model that would take ninety."""
    orders: list[int] = []

    def noted(signals: Any, valid: Any, order: int) -> Any:
        orders.append(order)
        raise initial.Refused("enough")

    monkeypatch.setattr(noise, "fit_ar", noted)
    with pytest.raises(initial.Refused):
        noise.fit_arma([white(4000)[:, 0]], [np.ones(4000, dtype=bool)], 15, 15)
    assert 45 < max(orders) < 80


@pytest.mark.holds("identify.SETPOINT_MEMORY")
def test_an_op_is_what_the_setpoint_did_within_a_fifth_of_the_record() -> None:
    """A pulse is looked back at for so long."""
    pulse = np.eye(1000)[:, :1]
    assert 150 < np.flatnonzero(np.any(closed_loop._blocks(pulse), axis=1)).max() < 350


@pytest.mark.holds("identify.FORGOTTEN")
def test_a_filter_has_forgotten_all_but_a_hundredth_of_its_start() -> None:
    """With a zero at 0.9: after 44 samples, and one of its own."""
    memory = noise.ArmaNoise(np.array([-0.5]), np.array([-0.9])).memory
    assert 0.9 ** (memory - 1) == pytest.approx(0.01, rel=0.2)
