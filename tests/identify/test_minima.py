"""Other minima of the likelihood: found from a wrong one, held by the intervals. Simulated records."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from support.simulated import coloured, random_switching, segment_of
from trueplant.identify import Row, Spec, fit_row, identify_output, intervals, minima, output, pieces_of
from trueplant.identify.covariance import scaled
from trueplant.identify.fit import refitted
from trueplant.identify.intervals import as_wide_as, profile_of
from trueplant.identify.likelihood import rise
from trueplant.identify.minima import open_minima
from trueplant.loop import PID, Controller, simulate
from trueplant.lti import Structure, TransferMatrix

LAW = Controller.diagonal([PID(Kc=0.3, Ti=15.0, sample_time=1.0)])
FIRST = Structure.parse("fopdt")
TWO_TERMS = Structure.parse("sopdt+delayed")


def record(structure: Structure, truth, seed: int, std: float, samples: int = 1500):
    """One loop, its set-point moved twice, AR(1) noise."""
    rng = np.random.default_rng(seed)
    plant = TransferMatrix(((structure.transfer(np.array(truth)),),), "min")
    r = np.zeros((samples, 1))
    r[samples // 5 :] = 1.0
    r[3 * samples // 5 :] = 0.0
    v = coloured(rng, samples, 1, [1, -0.9], [1], std)
    return segment_of(simulate(plant, LAW, r, 1.0, v=v))


def test_a_wrong_minimum_is_left():
    truth = np.array([2.0, 10.0, 4.6])
    row = Row((Spec(0, FIRST, tuple(truth)),), pieces_of([record(FIRST, truth, 1, 0.05)], 0))
    good = fit_row(row, truth, np.array([-0.9]))
    held = fit_row(row, np.array([2.0, 10.0, 41.4]), good.ar, free=np.array([True, True, False]))
    wrong = fit_row(row, held.theta, held.ar)
    assert wrong.cost > 1.02 * good.cost and abs(wrong.theta[2] - truth[2]) > 5
    found = open_minima(wrong, 0.95)
    assert found.best.cost <= good.cost * (1 + 1e-4)
    assert abs(found.best.theta[2] - truth[2]) < 1


def test_leads_or_terms_that_change_places_are_no_other_minimum():
    """Two leads of 30 and 250 s, and two terms, told apart in 2,000 s; the model, a start, has them the other way."""
    leads = Structure.parse("sopdt+lag+lead+lead")
    for structure, truth, swapped in (
        (leads, [0.65, 400.0, 150.0, 8.0, 30.0, 250.0, 0.5], [0, 1, 2, 3, 5, 4, 6]),
        (TWO_TERMS, [3.0, -1.2, 14.0, 9.0, 3.4, 26.7], [1, 0, 2, 3, 5, 4]),
    ):
        rng, p = np.random.default_rng(3), np.array(truth)
        r, v = random_switching(rng, 2000, 1, 60.0), coloured(rng, 2000, 1, [1, -0.8], [1], 0.003)
        plant = TransferMatrix(((structure.transfer(p),),), "min")
        spec = Spec(0, structure, tuple(p[swapped]))
        row = Row((spec,), pieces_of([segment_of(simulate(plant, LAW, r, 1.0, v=v))], 0))
        fit = fit_row(row, p, np.array([-0.8]))
        other = fit_row(row, p[swapped], fit.ar)
        assert np.abs(other.theta[swapped] - fit.theta).max() < 0.2 * np.abs(p).max()
        found = open_minima(fit, 0.95)
        assert all(np.abs(one.theta - other.theta).max() > 5 for one in found.fits)
        assert np.all(found.added < (0.2 * p) ** 2)


def test_every_open_minimum_belongs_to_the_interval(monkeypatch):
    """Two delayed terms that a record of two moves hardly tells apart: at least one of six records has two minima."""
    truth = np.array([3.0, -1.2, 14.0, 9.0, 3.4, 6.7])
    searched, several = [], 0

    def kept(*args):
        searched.append(open_minima(*args))
        return searched[-1]

    monkeypatch.setattr(output, "open_minima", kept)
    for seed in range(6):
        spec = Spec(0, TWO_TERMS, tuple(truth * [1.1, 0.9, 1.1, 0.9, 1.2, 1.1]))
        estimate = identify_output([record(TWO_TERMS, truth, seed, 0.03)], 0, [spec])
        found = searched[-1]
        assert found.best is estimate.fit
        several += len(found.fits) > 1
        assert found.shares.sum() == pytest.approx(1.0)
        assert found.best.cost == min(fit.cost for fit in found.fits)
        for fit in [one for one, risen in zip(found.fits, found.rises, strict=True) if risen < 3.84]:
            assert np.all(estimate.intervals[:, 0] <= fit.theta + 1e-9 * np.abs(fit.theta))
            assert np.all(fit.theta <= estimate.intervals[:, 1] + 1e-9 * np.abs(fit.theta))
            apart = np.abs(fit.theta - estimate.theta) / 1.96
            assert np.all(np.sqrt(np.diag(estimate.covariance)) >= 0.999 * apart)
        own = scaled(found.best.covariance, found.factor)
        mixture, apart = found.widened(own), np.array([one.theta for one in found.fits]) - found.best.theta
        assert np.all(np.linalg.eigvalsh(mixture - own) > -1e-9 * np.trace(mixture)), "no direction is narrower"
        assert np.all(np.diag(mixture) >= found.shares @ apart**2 * (1 - 1e-9)), "no narrower than the minima are apart"
        net = np.array([1.0, 1.0, 0.0, 0.0, 0.0, 0.0])
        both, alone = np.sqrt(net @ mixture @ net), np.sqrt(net @ own @ net)
        assert both < 1.2 * alone + np.abs(apart @ net).max(), "what is the same at all minima stays known"
    assert several >= 1


def test_lags_that_have_changed_places_are_no_other_minimum():
    sopdt = Structure.parse("sopdt")
    truth = np.array([2.0, 12.0, 4.0, 3.4])
    row = Row((Spec(0, sopdt, tuple(truth)),), pieces_of([record(sopdt, truth, 3, 0.02)], 0))
    fit = fit_row(row, truth[[0, 2, 1, 3]], np.array([-0.9]))
    assert fit.theta[1] < fit.theta[2]
    found = open_minima(fit, 0.95)
    assert len(found.fits) == 1 and found.best.theta[1] > found.best.theta[2]


@pytest.mark.slow
def test_dead_times_cover_where_the_set_point_moves_twice():
    """60 records: 53 or more covered passes with 0.99 at a coverage of 95 %, with 0.07 at 80 %."""
    truth = np.array([2.0, 10.0, 4.6])
    covered = 0
    for seed in range(60):
        spec = Spec(0, FIRST, tuple(truth * [1.2, 0.8, 1.3]))
        low, high = identify_output([record(FIRST, truth, 100 + seed, 0.08)], 0, [spec]).intervals[2]
        covered += low <= truth[2] <= high
    assert covered >= 53


def test_a_parameter_that_is_hardly_known_leaves_others_as_known_as_they_are():
    """Two elements correlated as 0.9: where the first's lag may be 100 times as uncertain, the second's gain follows
    only as far as it was seen to."""
    covariance = np.array([[1.0, 0.9, 0.9], [0.9, 1.0, 0.8], [0.9, 0.8, 1.0]])
    free = as_wide_as(covariance, 0, 1e4, np.full(3, np.inf))
    np.testing.assert_allclose(free[0, 1] / np.sqrt(free[0, 0] * free[1, 1]), 1.0, atol=1e-4)
    held = as_wide_as(covariance, 0, 1e4, np.array([np.inf, np.inf, 0.5]))
    np.testing.assert_allclose(np.diag(held), [1e4, free[1, 1], 1.25])
    assert np.all(np.linalg.eigvalsh(held - covariance) > -1e-9)
    for given in (held, free):
        alone = given[1:, 1:] - np.outer(given[1:, 0], given[1:, 0]) / given[0, 0]
        before = covariance[1:, 1:] - np.outer(covariance[1:, 0], covariance[1:, 0]) / covariance[0, 0]
        assert np.all(np.linalg.eigvalsh(alone - before) > -1e-9), "no less is uncertain than with the first one known"


def test_profiles_say_how_far_the_others_go():
    """Quadratic near the minimum: the ends are at 1.96 standard errors, and the others follow as they correlate."""
    truth = np.array([2.0, 10.0, 4.6])
    fit = fit_row(
        Row((Spec(0, FIRST, tuple(truth)),), pieces_of([record(FIRST, truth, 3, 0.02)], 0)), truth, np.zeros(1)
    )
    profile, sigma = profile_of(fit, 1, 0.95), np.sqrt(np.diag(fit.covariance))
    np.testing.assert_allclose(np.subtract(profile.ends, fit.theta[1]), [-1.96 * sigma[1], 1.96 * sigma[1]], rtol=0.1)
    along = fit.covariance[:, 1] / sigma[1]
    away = [np.abs(side.fitted.theta - fit.theta) / 1.96 for side in profile.sides]
    np.testing.assert_allclose(away[1][[0, 1]], np.abs(along[[0, 1]]), rtol=0.15)
    np.testing.assert_allclose(profile.furthest, np.max(away, axis=0), rtol=1e-4)
    assert profile.reach(profile.ends, 0.0) == profile.ends


@pytest.mark.parametrize(("seed", "std"), [(1, 0.1), (1, 0.3), (2, 0.3), (6, 0.3)])
def test_a_dead_time_of_a_term_that_may_have_no_gain_has_the_hull_of_all_valleys(seed, std):
    """Against the likelihood at every dead time up to 100, begun anew from three places each."""
    truth = np.array([3.0, -0.3, 14.0, 9.0, 3.4, 26.7])
    row = Row((Spec(0, TWO_TERMS, tuple(truth)),), pieces_of([record(TWO_TERMS, truth, seed, std)], 0))
    fit = open_minima(fit_row(row, truth, np.array([-0.9])), 0.95).best
    profile, begun = profile_of(fit, 5, 0.95), (fit.theta, truth, truth * [1, 0, 1, 1, 1, 1])
    places, free = np.arange(0.0, 101.0, 2.0), np.arange(6) != 5

    def lowest(place: float) -> float:
        return min(rise(fit, refitted(fit, np.append(start[:5], place), free)) for start in begun)

    within = places[[lowest(place) < 1.96**2 for place in places]]
    low, high = profile.ends
    assert low <= within.min() + 2 and high >= min(within.max(), 98.0) - 2
    assert np.diff(within).max() > 2, "the first end of a valley is not the last"


@pytest.mark.parametrize("seed", [0, 1])
def test_intervals_of_two_lags_end_where_they_would_change_places(seed):
    """Against the likelihood at all pairs of lags in order: where they change places the same plants come again."""
    sopdt, truth = Structure.parse("sopdt"), np.array([2.0, 8.0, 6.0, 3.4])
    rng = np.random.default_rng(seed)
    plant = TransferMatrix(((sopdt.transfer(truth),),), "min")
    v = coloured(rng, 1500, 1, [1, -0.8], [1], 0.05)
    moved = segment_of(simulate(plant, LAW, random_switching(rng, 1500, 1, 80.0), 1.0, v=v))
    row = Row((Spec(0, sopdt, tuple(truth)),), pieces_of([moved], 0))
    fit = open_minima(fit_row(row, truth, np.array([-0.8])), 0.95).best
    free = np.array([True, False, False, True])

    def risen(*lags: float) -> float:
        return rise(fit, refitted(fit, np.array([fit.theta[0], *lags, fit.theta[3]]), free))

    sums = np.arange(13.2, 15.0, 0.1)
    pairs = [((both + apart) / 2, (both - apart) / 2) for both in sums for apart in np.arange(0.0, 8.0, 0.2)]
    within = np.array([pair for pair in pairs if risen(*pair) < 1.96**2])
    assert np.all(np.abs(within.sum(axis=1) - sums.mean()) < 0.75), "all such sums are looked at"
    for index in (1, 2):
        expected = within[:, index - 1].min(), within[:, index - 1].max()
        np.testing.assert_allclose(profile_of(fit, index, 0.95).ends, expected, atol=0.2)


def test_the_end_of_a_profile_is_found_from_a_first_step_that_gets_lost(monkeypatch):
    """Stub: a fit is lost that begins more than two off what it is held at, or where another one was lost."""
    lost = 1e6

    def held(fit, index, value, begun):
        found = begun.deviance < lost and abs(value - begun.theta[0]) < 2
        return SimpleNamespace(theta=np.array([value]), deviance=value**2 if found else lost)

    monkeypatch.setattr(intervals, "_constrained", held)
    monkeypatch.setattr(intervals, "rise", lambda fit, other: other.deviance)
    bounds = (np.array([-np.inf]), np.array([np.inf]))
    row = SimpleNamespace(bounds=lambda: bounds, limits=lambda: bounds, is_dead_time=np.array([False]))
    fit = SimpleNamespace(theta=np.zeros(1), deviance=0.0, covariance=np.array([[100.0**2]]), row=row)
    np.testing.assert_allclose(profile_of(fit, 0, 0.95, rounds=9).ends, [-1.96, 1.96], rtol=0.02)


def test_the_end_of_a_dead_time_is_found_in_the_next_sample_interval(monkeypatch):
    """Stub: the curvature says 0.02 s, and the likelihood hardly falls until 1.4 s more; the element answers in 9 s."""

    def held(fit, index, value, begun):
        return SimpleNamespace(theta=np.array([value]), deviance=(0.3 + 10 * max(value - 6.4, 0.0)) ** 2)

    monkeypatch.setattr(intervals, "_constrained", held)
    monkeypatch.setattr(intervals, "rise", lambda fit, other: other.deviance)
    bounds = (np.array([4.9]), np.array([np.inf]))
    row = SimpleNamespace(
        bounds=lambda: bounds,
        limits=lambda: bounds,
        is_dead_time=np.array([True]),
        pieces=[SimpleNamespace(h=0.5)],
        stride=2,
        element_of=lambda index: 0,
        slices=[slice(0, 1)],
        specs=[SimpleNamespace(structure=Structure.parse("sopdt+lead"))],
        lag=lambda m, theta: 4.0,
    )
    fit = SimpleNamespace(theta=np.array([5.0]), deviance=0.0, covariance=np.array([[0.02**2]]), row=row)
    low, high = profile_of(fit, 0, 0.95).ends
    assert low == 4.9
    assert high == pytest.approx(6.4 + (1.96 - 0.3) / 10, abs=0.005)


def test_where_a_profile_has_no_end_it_says_how_far_was_looked():
    truth = np.array([3.0, -0.3, 14.0, 9.0, 3.4, 26.7])
    row = Row((Spec(0, TWO_TERMS, tuple(truth)),), pieces_of([record(TWO_TERMS, truth, 2, 0.1)], 0))
    fit = open_minima(fit_row(row, truth, np.array([-0.9])), 0.95).best
    profile, sigma = profile_of(fit, 5, 0.95), np.sqrt(fit.covariance[5, 5])
    assert profile.ends == (0.0, np.inf)
    low, high = profile.reach(profile.ends, 1.0)
    assert low == 0.0 and high >= fit.theta[5] + 1.0 + 11 * sigma


def further_minima(found: int, descents: int) -> float:
    """How many more are expected (Boender and Rinnooy Kan 1987)."""
    return found * (descents - 1) / (descents - found - 2) - found


@pytest.mark.parametrize(("std", "descents"), [(0.05, 8), (0.5, 17)])
def test_the_search_ends_where_no_second_minimum_is_expected(std, descents, monkeypatch):
    """Two delayed terms: in little noise every start finds the same, in much they end in several."""
    begun, truth = [], [3.0, -1.2, 14.0, 9.0, 3.4, 26.7]

    def ended(fit, theta, like):
        begun.append(theta)
        return descend(fit, theta, like)

    descend = minima._ended
    monkeypatch.setattr(minima, "_ended", ended)
    row = Row((Spec(0, TWO_TERMS, tuple(truth)),), pieces_of([record(TWO_TERMS, truth, 1, std)], 0))
    found = open_minima(fit_row(row, np.array(truth), np.array([-0.9])), 0.95)
    assert len(begun) == descents
    assert (len(found.fits) == 1) is (descents == 8)
    assert further_minima(1, 8) < 0.5 <= further_minima(1, 7)
    assert further_minima(2, 16) >= 0.5
