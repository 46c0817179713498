"""Where the lines of the estimate are that no significance level draws: each held from both of its sides."""

from __future__ import annotations

from types import SimpleNamespace as Stub
from typing import Any

import numpy as np
import pytest
from scipy.stats import norm

from support.simulated import segment_of
from trueplant.identify import Spec, answers, between_experiments, intervals, noise_order, pieces_of, shared_disturbance
from trueplant.identify.covariance import noise_freedom, student_factor
from trueplant.identify.instrumental.choice import Candidate, _said
from trueplant.identify.instrumental.order import Order
from trueplant.identify.unanswered import WhyUnanswered
from trueplant.lti import Structure

Array = np.ndarray
FOPDT = Structure.parse("fopdt")


def unanswered_of(
    lag: float, dead_time: float, errors: tuple[float, ...], structure: Structure = FOPDT
) -> dict[int, WhyUnanswered]:
    """What is left unanswered of gain 2, lag and dead time, estimated with these standard errors from samples of 1.

    Of another structure all lags are this one, and leads are twice as long.
    """
    piece = Stub(h=1.0, inputs=np.ones((1, 5)))
    theta = structure.parameters(2.0, lag, 1 / lag, 0.7, 2 * lag, dead_time)
    row = Stub(pieces=[piece], specs=[Spec(0, structure, tuple(theta))], slices=[slice(0, theta.size)])
    row.lag = lambda m, p: structure.lag(p)
    fit = Stub(row=row, standard_errors_by_data=np.zeros(theta.size))
    estimate: Any = Stub(
        fit=fit,
        theta=theta,
        intervals=theta[:, None] + norm.ppf([0.025, 0.975]) * np.array(errors)[:, None],
        refuted=None,
        covariance=np.diag(np.square(errors)),
        order_dependence={},
        withheld={},
        budget=Stub(parts={}),
    )
    return {index: one.why for index, one in answers.unanswered(estimate).items()}


@pytest.mark.holds("identify.FEWEST_SAMPLES")
@pytest.mark.parametrize(("lag", "fast"), [(1.5, True), (2.5, False)])
def test_a_loop_that_answers_within_two_and_a_half_samples_has_no_dynamics(lag, fast):
    found = unanswered_of(lag, 0.5, (0.01, 0.01, 0.01))
    assert found == (dict.fromkeys((1, 2), WhyUnanswered.FASTER_THAN_RECORD) if fast else {})
    # a lead is no better known than the lags it stands against
    found = unanswered_of(lag / 2, 0.5, (0.01,) * 5, Structure.parse("sopdt+lead"))
    assert found == (dict.fromkeys((1, 2, 3, 4), WhyUnanswered.FASTER_THAN_RECORD) if fast else {})


@pytest.mark.holds("identify.TOO_UNCERTAIN")
@pytest.mark.parametrize(("error", "known"), [(0.4, True), (0.6, False)])
def test_what_is_known_to_half_of_itself_is_not_known(error, known):
    assert (1 not in unanswered_of(10.0, 5.0, (0.01, 10 * error, 0.01))) is known


@pytest.mark.holds("identify.PROFILED", "identify.HOPELESS_ERROR")
@pytest.mark.parametrize(("relative", "profiled"), [(0.15, False), (0.3, True), (800.0, True), (1500.0, False)])
def test_an_interval_is_profiled_where_a_lag_is_known_poorly_but_not_hopelessly(relative, profiled, monkeypatch):
    monkeypatch.setattr(intervals, "free_of_noise", lambda fit: False)
    row = Stub(is_gain=np.array([False]), is_dead_time=np.array([False]))
    fit: Any = Stub(row=row, theta=np.array([10.0]), covariance=np.array([[(10 * relative) ** 2]]), free=[True])
    assert (intervals.profiled(fit) == [0]) is profiled


@pytest.mark.holds("identify.NOISE_SHIFT_ERRORS", "identify.NOISE_SHIFT_SHARE", "identify.RIVAL_NEAR")
@pytest.mark.parametrize(
    ("shift", "error", "variance", "depends"),
    [
        (0.9, 0.01, 1.0, True),
        (0.28, 0.01, 1.0, False),  # by less than a third of it
        (0.4, 0.01, 1.0, True),
        (1.0, 0.4, 1.0, False),  # by 2.5 standard errors
        (1.0, 0.25, 1.0, True),
        (1.0, 0.01, 1.008, True),  # by one that is 8 worse in the Bayesian criterion
        (1.0, 0.01, 1.012, False),  # by one that is 12 worse, and nobody would choose
    ],
)
def test_a_parameter_depends_on_the_noise_model_that_moves_it_by_a_third(shift, error, variance, depends, monkeypatch):
    covariance = np.array([[error**2]])
    row = Stub(lag_of_dead_times=lambda theta: np.zeros(1), pieces=[0], measured=lambda k: (np.zeros(1000), None))
    fit: Any = Stub(ar=np.zeros(2), theta=np.ones(1), row=row, variance=1.0, covariance=covariance, count=1000)
    moved = Stub(theta=np.ones(1) + shift, covariance=covariance, variance=variance, ar=np.zeros(2))
    monkeypatch.setattr(noise_order, "of_a_part", lambda run: run)
    monkeypatch.setattr(noise_order, "refit_noise", lambda run, order: moved)
    found, _ = noise_order.order_dependence(fit, covariance, np.array([0.5]), [fit])
    assert bool(found) is depends


@pytest.mark.holds("identify.SHARED_FACTOR")
def test_a_disturbance_that_outputs_share_widens_intervals_to_hold_a_bias_of_four_standard_errors(monkeypatch):
    """As large as they were in simulation; not so far that one of eight would be held as well."""
    z = float(norm.ppf(0.975))
    monkeypatch.setattr(shared_disturbance, "replace", lambda estimate, **changes: Stub(**changes))
    estimate: Any = Stub(
        theta=np.array([1.0]),
        covariance=np.array([[1.0]]),
        intervals=np.array([[1.0 - z, 1.0 + z]]),
        unprofiled=None,
        budget=Stub(including=lambda *_: None),
    )
    _, high = shared_disturbance.widened_for_shared_disturbance(estimate, [1], 0.95).intervals[0]
    assert 4.0 < high - 1.0 < 8.0


@pytest.mark.holds("identify.QUIET_SAMPLES")
@pytest.mark.parametrize(("samples", "rest"), [(15, False), (30, True)])
def test_a_record_starts_at_rest_if_its_input_stood_still_for_20_samples(samples, rest):
    n = 100
    u = (np.arange(n) >= samples) * 1.0
    y = 0.01 * np.random.default_rng(1).standard_normal(n) + np.maximum(np.arange(n) - samples, 0)
    columns = {"t": np.arange(n, dtype=float), "r": np.zeros((n, 1)), "u": u[:, None], "y": y[:, None]}
    (piece,) = pieces_of([segment_of(Stub(h=1.0, **columns))], 0)  # type: ignore[arg-type]
    assert piece.starts_at_rest is rest


@pytest.mark.holds("identify.ORDER_CLEAR")
@pytest.mark.parametrize(("gap", "words"), [(8.0, "hardly better"), (13.0, "clearly better")])
def test_a_structure_is_clearly_better_by_ten_in_the_bayesian_criterion(gap, words):
    first, second = (Candidate(Order(0, 1 + k), k * gap, 90.0) for k in range(2))
    assert words in _said((first, second))


@pytest.mark.holds("identify.SAMPLES_PER_PARAMETER")
@pytest.mark.parametrize(("samples", "fitted"), [(14, False), (18, True)])
def test_a_run_is_fitted_alone_if_it_has_four_samples_for_each_coefficient(samples, fitted, monkeypatch):
    """Three parameters and one coefficient of the noise model."""
    monkeypatch.setattr(between_experiments, "grid_guess", lambda row, theta, *_, **__: theta)
    monkeypatch.setattr(between_experiments, "fit_row", lambda *_, **__: Stub(cost=1.0))
    monkeypatch.setattr(between_experiments, "replace", lambda row, pieces: row)
    row = Stub(
        pieces=(Stub(experiment=0),),
        measured=lambda k: (None, np.ones(samples, dtype=bool)),
        bounds=lambda: (np.zeros(3), np.ones(3)),
    )
    pooled: Any = Stub(row=row, theta=np.full(3, 0.5), ar=np.zeros(1), free=np.ones(3, dtype=bool))
    assert bool(between_experiments.single_runs(pooled)) is fitted


@pytest.mark.holds("identify.FEWEST_FREEDOM")
def test_hardly_any_noise_known_widens_intervals_by_a_fifth_at_most(monkeypatch):
    """Student's quantile over the normal one; with fewer degrees of freedom it would say nothing sensible."""
    monkeypatch.setattr("trueplant.identify.covariance.restriction_of", lambda fit: None)
    monkeypatch.setattr("trueplant.identify.covariance._uncertain", lambda *_: np.array([100.0]))
    fit: Any = Stub(variance=1.0, information=np.eye(2), theta=np.zeros(1), ar=np.zeros(1), left=3.0)
    (widening,) = np.sqrt(student_factor(noise_freedom(fit), 0.95))
    assert 1.1 < widening < 1.2
