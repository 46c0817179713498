"""What the estimate takes a noise model, a prior and a search to be: lines of judgement, each held from both sides."""

from __future__ import annotations

from types import SimpleNamespace as Stub
from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter

from support.simulated import segment_of
from trueplant.identify import Row, Spec, between_experiments, estimate, first, intervals, valves
from trueplant.identify.covariance import initial_state_share, least_covariance
from trueplant.identify.joint import _chosen_order, whiteness_p
from trueplant.identify.missing import _Scan
from trueplant.identify.noise import choose_order
from trueplant.identify.output import OutputEstimate
from trueplant.identify.pieces import pieces_of
from trueplant.identify.prior import Prior
from trueplant.identify.shared_disturbance import _at_common_instants, _Errors, _relation_p
from trueplant.identify.validate import squares_p
from trueplant.lti import Structure

Array = np.ndarray
FOPDT = Structure.parse("fopdt")


def white(n: int, seed: int = 1) -> Array:
    return np.random.default_rng(seed).standard_normal(n)


def echo(n: int, lag: int, seed: int = 1) -> Array:
    """White noise and 0.8 of what it was so many samples before."""
    return np.asarray(lfilter(np.r_[1.0], np.r_[1.0, np.zeros(lag - 1), -0.8], white(n, seed)))


def everywhere(x: Array) -> Any:
    return [x], [np.ones(x.size, dtype=bool)]


# -- noise models ----------------------------------------------------------------------------------------------------


@pytest.mark.holds("identify.USUAL_ORDER")
@pytest.mark.parametrize(("lag", "seen"), [(25, True), (40, False)])
def test_noise_that_comes_again_is_seen_within_thirty_samples(lag: int, seen: bool) -> None:
    assert (choose_order(*everywhere(echo(4000, lag)), 240) == lag) is seen


@pytest.mark.holds("identify.FEWEST_PER_ORDER")
@pytest.mark.parametrize(("samples", "seen"), [(50, False), (80, True)])
def test_five_samples_are_enough_to_try_a_coefficient(samples: int, seen: bool) -> None:
    """Noise that comes again after eight: fifty of them, beside the eight before."""
    assert (choose_order(*everywhere(echo(1000 + samples, 8)[1000:]), 8) == 8) is seen


@pytest.mark.holds("identify.SPARE_ORDERS")
def test_a_noise_model_has_two_coefficients_more_than_the_criterion_asks_for(monkeypatch: Any) -> None:
    """That of AR(1) noise has three."""
    monkeypatch.setattr(estimate, "free_of_noise", lambda fit: False)
    monkeypatch.setattr(estimate, "noise_signals", lambda fit: everywhere(echo(4000, 1)))
    fit: Any = None
    assert estimate.fit_noise(fit, None, 30).size == 3


@pytest.mark.holds("identify.LARGEST_ORDER")
@pytest.mark.parametrize("seen", [180, 300])
def test_a_fit_with_a_noise_model_of_its_own_has_240_coefficients_at_most(seen: int, monkeypatch: Any) -> None:
    """Of a record that affords so many."""
    monkeypatch.setattr(estimate, "_with_noise", lambda fit, order, limit, *_, **__: limit)
    n = 41 * seen
    columns = {name: white(n)[:, None] for name in "uy"} | {"t": np.arange(n, dtype=float), "r": np.zeros((n, 1))}
    segments = [segment_of(Stub(h=1.0, **columns))]  # type: ignore[arg-type]
    fit: Any = Stub(row=Row((Spec(0, FOPDT, (2.0, 10.0, 1.0)),), pieces_of(segments, 0)))
    limit: Any = estimate.with_own_noise(fit, 1)
    assert 170 < limit < 190 if seen == 180 else 220 < limit < 260


@pytest.mark.holds("identify.JOINT_LARGEST_ORDER")
@pytest.mark.parametrize(("lag", "seen"), [(32, True), (55, False)])
def test_outputs_together_remember_forty_samples_at_most(lag: int, seen: bool) -> None:
    v = np.column_stack([echo(4000, lag), echo(4000, lag, 2)])
    fits: Any = [Stub(ar=np.zeros(100))] * 2
    assert (_chosen_order([v], [np.ones(4000, dtype=bool)], fits) == lag) is seen


@pytest.mark.holds("identify.JOINT_LAGS")
@pytest.mark.parametrize(("lag", "seen"), [(16, True), (28, False)])
def test_errors_of_outputs_together_are_white_if_nothing_comes_again_within_twenty_samples(
    lag: int, seen: bool
) -> None:
    e = np.column_stack([echo(4000, lag), white(4000, 2)])
    fit: Any = Stub(ar=np.zeros((0, 2, 2)), errors=[e])
    assert (whiteness_p(fit) < 1e-3) is seen


@pytest.mark.holds("identify.SHARED_LAGS")
@pytest.mark.parametrize(("late", "seen"), [(6, True), (12, False)])
def test_one_output_foretells_the_errors_of_another_within_eight_samples(late: int, seen: bool) -> None:
    x, t = white(4000), np.arange(4000.0)
    here, there = ({0: _Errors(1.0, t, e)} for e in (np.roll(x, late) + white(4000, 2), x))
    assert (_relation_p(here, there) < 1e-3) is seen


@pytest.mark.holds("identify.ERRORS_PER_LAG")
@pytest.mark.parametrize(("common", "compared"), [(60, False), (120, True)])
def test_errors_of_two_outputs_are_compared_that_have_eighty_instants_in_common(common: int, compared: bool) -> None:
    t, late = np.arange(400.0), np.arange(400.0) + 400 - common
    e, _ = _at_common_instants({0: _Errors(1.0, t, white(400))}, {0: _Errors(1.0, late, white(400, 2))})
    assert ([part.size for part in e] == [common]) is compared


@pytest.mark.holds("identify.RESIDUAL_LAGS")
@pytest.mark.parametrize(("lag", "seen"), [(20, True), (35, False)])
def test_errors_keep_their_size_if_they_do_so_within_25_samples(lag: int, seen: bool) -> None:
    """Bursts of one sample that come again so many later: what tests of whiteness look at as well."""
    loud = np.zeros(4000)
    loud[::lag] = 1.0
    assert (squares_p([white(4000) * (1 + 5 * loud)]) < 1e-3) is seen


@pytest.mark.holds("identify.INITIAL_STATE_BIAS")
def test_a_hundred_initial_states_in_ten_thousand_samples_bias_by_a_fifth_to_a_half_of_a_standard_error_each() -> None:
    """Over the root of the number of samples, as in simulated records that lost many; what is added allows for it."""
    fit: Any = Stub(row=Stub(nuisance_count=100), count=10_000)
    assert 0.3**2 < initial_state_share(fit) < 0.8**2


@pytest.mark.holds("identify.RECORDED_DIGITS")
def test_no_gain_is_known_to_more_than_six_digits() -> None:
    row: Any = Stub(size=1, specs=[Stub(column=0)], slices=[slice(0, 1)], is_dead_time=np.array([False]))
    assert 0.7e-6 < np.sqrt(least_covariance(row, np.array([2.0]), np.zeros(1))[0, 0]) / 2 < 1.4e-6


# -- priors ----------------------------------------------------------------------------------------------------------


@pytest.mark.holds("identify.PRIOR_SPREAD")
def test_a_plant_is_within_a_factor_of_e_of_its_model_in_two_of_three() -> None:
    prior = Prior.about(FOPDT, np.array([2.0, 10.0, 5.0]))
    assert 0.5 < prior.penalty(np.array([2.0, 10 * np.e, 5.0])) < 2.0


@pytest.mark.holds("identify.STICKS")
def test_one_valve_in_five_does_not_follow_before_its_record_is_looked_at(monkeypatch: Any) -> None:
    monkeypatch.setattr(valves, "behind", lambda fit, valves: fit)

    def silent(kind: Any) -> Stub:
        nothing = np.zeros(len(kind))
        return Stub(evidence=nothing, sums=(nothing, nothing, nothing), shifts=np.zeros((len(kind), 3)))

    fits: Any = {0: Stub(deviance=0.0, theta=np.zeros(3))}
    search: Any = valves.Search(fits, [Stub(of=silent)], 0, Stub(), 3)
    kinds = [[valves.Valve(backlash=width) for width in (1.0, 2.0)], [valves.Valve(stick=1.0)]]
    odds = sum(valves._band(search, kind).odds.sum() for kind in kinds)
    assert 1 / 6 < odds / (1 + odds) < 1 / 4
    assert not valves._end(search, [valves.Valve(high=1.0)]).odds.any()


@pytest.mark.holds("identify.BETWEEN_RUNS")
def test_runs_that_say_nothing_leave_a_spread_of_eight_per_cent_between_them() -> None:
    """The mean of a half-normal distribution: 0.80 of its standard deviation."""
    nothing = np.array([np.eye(2) * 1e4] * 2)
    found = between_experiments._mixture(np.ones((2, 2)), nothing, np.ones(2), np.ones(2), np.array([0, 1]))
    assert found.spread == pytest.approx([0.08] * 3, abs=0.02)


@pytest.mark.holds("identify.THERE_ALL_THE_SAME")
def test_what_a_record_does_not_show_is_there_with_even_odds(monkeypatch: Any) -> None:
    """The gain moves from 2 to 3 beside an element that is not shown: on average by a half."""
    monkeypatch.setattr(first, "replace", lambda spec, guess: spec)
    found: list[float] = []
    monkeypatch.setattr(first, "averaged", lambda own, shifts, shares, *_: found.append(float(shares @ shifts[:, 0])))
    own: Any = Stub(theta=np.array([2.0]), row=Stub(specs=[Spec(0, FOPDT)], slices=[slice(0, 1)], size=1))
    parts = [slice(0, 1), slice(1, 2)]
    beside: Any = Stub(theta=np.array([3.0, 0.1]), row=Stub(specs=[Spec(0, FOPDT), Spec(1, FOPDT)], slices=parts))
    first.with_left_out(own, [1], lambda specs: beside, 0.95)
    assert found == [pytest.approx(0.5, abs=0.1)]


# -- searches --------------------------------------------------------------------------------------------------------


@pytest.mark.holds("identify.PROFILE_FURTHEST")
@pytest.mark.parametrize(("end", "found"), [(9.0, True), (16.0, False)])
def test_the_end_of_an_interval_is_looked_for_within_twelve_standard_errors(
    end: float, found: bool, monkeypatch: Any
) -> None:
    """Where the deviance rises as the square of what it does there; beyond there is none."""
    monkeypatch.setattr(intervals, "_constrained", lambda fit, index, value, begun: Stub(theta=np.array([value])))
    z = 1.959964
    monkeypatch.setattr(intervals, "rise", lambda fit, other: float((other.theta[0] * z / end) ** 2))
    bounds = (np.array([-np.inf]), np.array([np.inf]))
    row = Stub(bounds=lambda: bounds, limits=lambda: bounds, is_dead_time=np.array([False]))
    fit: Any = Stub(theta=np.zeros(1), covariance=np.eye(1), row=row)
    _, high = intervals.profile_of(fit, 0, 0.95).ends
    assert high == (pytest.approx(end, rel=0.02) if found else np.inf)


@pytest.mark.holds("identify.SLOW_SPANS")
@pytest.mark.parametrize(("span", "slow"), [(4.0, 64.0), (2.2, 16.0)])
def test_a_lag_is_looked_for_of_which_the_record_holds_three(span: float, slow: float, monkeypatch: Any) -> None:
    """Lags of 1, 4, 16, 64, 256 samples, in records of so many times 64."""
    n = int(64 * span)
    asked: list[float] = []
    monkeypatch.setattr(_Scan, "_answer", lambda self, column, theta: asked.append(theta[1]) or np.ones(n))
    scan = _Scan.__new__(_Scan)
    scan._fit = Stub(row=Stub(pieces=[Stub(h=1.0, y=np.zeros(n))], stride=1), left=n)  # type: ignore[assignment]
    scan._errors, scan._basis = np.ones(n), np.zeros((n, 0))
    scan.of(0)
    assert max(asked) == slow


@pytest.mark.holds("identify.LOAD_TOLD")
@pytest.mark.parametrize(("left", "told"), [(0.035, False), (0.08, True)])
def test_a_load_is_told_by_what_looks_unlike_the_plant_if_that_is_a_twentieth(
    left: float, told: bool, monkeypatch: Any
) -> None:
    """Of its answer (squared) the plant and the operating point can explain all but that share."""
    n = 400
    answer, other = np.ones(n), np.tile([1.0, -1.0], n // 2)
    monkeypatch.setattr(_Scan, "_answer", lambda *_: np.sqrt(1 - left) * answer + np.sqrt(left) * other)
    scan = _Scan.__new__(_Scan)
    scan._fit = Stub(row=Stub(pieces=[Stub(h=1.0, y=np.zeros(n))], stride=1), left=n)  # type: ignore[assignment]
    scan._errors, scan._basis = other, answer[:, None] / np.sqrt(n)
    assert (scan.of(0) > 1) is told


@pytest.mark.holds("identify.SEARCHED_FREEDOM")
def test_a_search_in_noise_gains_eight_with_three_parameters() -> None:
    """As the mean of 120 simulated records without the element did: it counts as even odds."""
    row = Stub(specs=[Spec(0, FOPDT)], slices=[slice(0, 3)], is_gain=np.array([True, False, False]))
    searched: Any = Stub(row=row, theta=np.ones(3), fit=None, rise=lambda index, values: 8.0, open_valves=None)
    searched._ratio_p = lambda *of: OutputEstimate._ratio_p(searched, *of)
    searched._restricted_p = lambda *of: OutputEstimate._restricted_p(searched, *of)
    assert 0.3 < OutputEstimate.absence_p(searched, 0) < 0.6
