"""How a measured disturbance runs between its samples: found where the record can tell, in the intervals where not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import norm

from support.simulated import Array, coloured, random_switching, segment_of
from trueplant.identify import (
    FoundHold,
    Open,
    OutputEstimate,
    find_holds,
    identify_matrix,
    identify_plant,
    over_open_holds,
    specs_of,
    with_holds,
)
from trueplant.identify.intervals import Mixture
from trueplant.loop import PID, Controller, simulate
from trueplant.lti import TransferMatrix
from trueplant.record.types import Segment

PLANT = TransferMatrix.of([["2 exp(-3.3 s)/(10 s + 1)", "1.5 exp(-2.3 s)/(6 s + 1)"]], "min")
LAW = Controller.diagonal([PID(Kc=0.66, Ti=10.0, sample_time=1.0)])
TRUE = np.array([2.0, 10.0, 3.3, 1.5, 6.0, 2.3])
SAMPLES = 1500
FINE = 10
HELD = ("feed", "laboratory", "held noise")


def held_signal(kind: str, rng: np.random.Generator) -> Array:
    """(N,) a signal that stays at each value until its next sample: moved by hand, a sample every 20 min, noise."""
    if kind == "held noise":
        return coloured(rng, SAMPLES, 1, [1, -0.8], [1], 1.0)[:, 0]
    if kind == "laboratory":
        return np.repeat(rng.standard_normal(SAMPLES // 20), 20)
    moves = np.where(rng.random(SAMPLES) < 1 / 15, np.arange(SAMPLES), 0)
    return rng.standard_normal(SAMPLES)[np.maximum.accumulate(moves)]


def running_signal(kind: str, rng: np.random.Generator) -> Array:
    """(N FINE,) noise of first order ("rough", 5 min) or second ("smooth", 3 min each; "slow", 20 min each)."""
    lag = {"rough": 5.0, "smooth": 3.0, "slow": 20.0}[kind]
    a = [1.0, -np.exp(-1 / (lag * FINE))]
    x = lfilter([1.0], a, rng.standard_normal((SAMPLES + 300) * FINE))
    x = (x if kind == "rough" else lfilter([1.0], a, x))[300 * FINE :]
    return np.asarray(x / np.std(x))


def record(kind: str, seed: int, std: float = 0.03) -> Segment:
    """A loop under a measured disturbance of size 1 (simulated); one that runs on does so between the samples too."""
    rng = np.random.default_rng(seed)
    r = random_switching(rng, SAMPLES, 1, 60.0)
    v = coloured(rng, SAMPLES, 1, [1, -0.8], [1], std)
    own, of_d = PLANT.columns(0, 1), PLANT.columns(1)
    if kind in HELD:
        sim = simulate(own, LAW, r, 1.0, v=v, d=held_signal(kind, rng)[:, None], Gd=of_d)
    else:
        d = running_signal(kind, rng)[:, None]
        r, v = np.repeat(r, FINE, axis=0), np.repeat(v, FINE, axis=0)
        sim = simulate(own, LAW, r, 1 / FINE, v=v, d=d, Gd=of_d, d_hold="linear", record_every=FINE)
    return replace(segment_of(sim), d=sim.d)


def estimated(segment: Segment) -> tuple[FoundHold, OutputEstimate]:
    """As an analysis does where the hold is not declared."""
    found = identify_plant([segment], PLANT, specs_of(PLANT), Open([1]), 0.95, (0.0, 0.0))
    estimates, holds = found.estimates, found.holds
    return holds[1], over_open_holds(estimates, holds, 0.95)[0]


def covers(estimate: OutputEstimate) -> Array:
    return np.asarray((estimate.intervals[:, 0] <= TRUE) & (estimate.intervals[:, 1] >= TRUE))


@pytest.mark.parametrize("kind", ["feed", "held noise", "smooth", "rough"])
def test_the_right_one_is_found(kind):
    """4 records each; the 40 of the slow test say how often."""
    for seed in range(4):
        found, estimate = estimated(record(kind, seed))
        assert found.hold == ("zoh" if kind in HELD else "linear"), seed
        assert estimate.row.pieces[0].hold == ("written", found.hold)
        # straight lines through a smooth signal can cost the element its structure
        assert estimate.rejected or abs(estimate.theta[5] - 2.3) < 0.15, seed
        assert not (estimate.rejected and kind in HELD), seed


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "std"), [(k, s) for k in (*HELD, "smooth", "rough", "slow") for s in (0.03, 0.1)])
def test_found_where_it_matters_and_covered_always(kind, std):
    """40 records each, half a sample being 0.5 min of dead time."""
    right, wrong, covered = [], [], []
    for seed in range(100, 140):
        found, estimate = estimated(record(kind, seed, std))
        wanted = "zoh" if kind in HELD else "linear"
        right.append(found.decided and found.hold == wanted)
        wrong.append(found.decided and (found.gain > 0) != (wanted == "zoh"))
        if not estimate.rejected:
            covered.append(covers(estimate))
    share = np.mean(covered, axis=0)
    print(f"{kind} {std}: decided right {np.mean(right):.2f}, wrong {np.sum(wrong)}, covered {share}")
    assert np.sum(wrong) <= 2  # 0.5 % are to be expected at most
    assert np.all(share >= 0.85)
    if std == 0.03 and kind in ("feed", "held noise"):
        assert np.mean(right) >= 0.9


def test_what_cannot_be_told_is_in_the_interval_of_the_dead_time():
    """The slow signal is the same held half a sample early; its hold declared, the dead time is known."""
    segment = record("slow", 1)
    found, estimate = estimated(segment)
    assert not found.decided and found.hold == "linear"
    for theta in found.thetas[0]:
        assert estimate.intervals[5, 0] < theta[5] < estimate.intervals[5, 1]
    assert np.ptp(found.thetas[0][:, 5]) == pytest.approx(0.5, abs=0.05)
    declared = identify_matrix([segment], PLANT, specs_of(PLANT))[0]
    assert np.ptp(declared.intervals[5]) < np.ptp(estimate.intervals[5]) - 0.4
    assert estimate.covariance[5, 5] > declared.covariance[5, 5] + 0.05
    assert np.all(np.linalg.eigvalsh(estimate.covariance - declared.covariance) > -1e-12)


def test_an_element_that_is_kept_tells_it_too():
    segment = record("feed", 2)
    own = {place: spec for place, spec in specs_of(PLANT).items() if place == (0, 0)}
    found = identify_plant([segment], PLANT, own, Open([1]), 0.95, (0.0, 0.0))
    estimates, holds = found.estimates, found.holds
    assert holds[1].hold == "zoh"
    assert estimates[0].fit.variance < identify_matrix([segment], PLANT, own)[0].fit.variance
    assert estimates[0].theta == pytest.approx(TRUE[:3], rel=0.03)


def test_the_second_fit_is_the_one_that_a_search_finds():
    segment = record("held noise", 3)
    found, quick = estimated(segment)
    searched = identify_matrix(with_holds([segment], {1: found}), PLANT, specs_of(PLANT))[0]
    assert quick.theta.size == searched.theta.size
    assert np.all(np.abs(quick.theta - searched.theta) < 0.3 * np.sqrt(np.diag(searched.covariance)))


def test_a_wrong_hold_is_not_taken_for_a_wrong_structure():
    """Straight lines through a held signal leave errors that follow it: the structure is not to blame."""
    segment = record("held noise", 1)
    taken = identify_matrix([segment], PLANT, specs_of(PLANT))[0]
    _, estimate = estimated(segment)
    assert estimate.structure_p[1] > 1e-3 > taken.structure_p[1] or taken.rejected
    assert not estimate.rejected


def test_a_disturbance_that_moves_nothing_has_no_hold():
    segment = record("feed", 4)
    model = TransferMatrix.of([["2 exp(-3.3 s)/(10 s + 1)", "0"]], "min")
    estimates = identify_matrix([replace(segment, y=segment.y + 0.0)], model, specs_of(model))
    asked = [spec.column for spec in estimates[0].row.specs]
    assert set(find_holds(estimates, model, [1])) == set(asked) - {0}


def test_intervals_of_a_mixture_are_its_quantiles():
    rng = np.random.default_rng(5)
    theta, errors = np.array([3.0, 10.0]), np.array([[0.1, 0.3], [0.5, 0.5]])
    z = norm.ppf(0.975)
    intervals = np.column_stack([theta - z * errors[:, 0], theta + z * errors[:, 1]])
    shifts, shares = np.array([[0.0, 0.0], [-0.5, 1.0], [0.8, 0.0]]), np.array([0.6, 0.3, 0.1])
    variances = np.array([[0.0, 0.0], [0.0, 0.0], [0.04, 2.25]])
    mixture = Mixture(intervals, theta, shifts, shares, 0.95, variances)
    which = rng.choice(3, 4_000_000, p=shares)
    draws = rng.standard_normal((4_000_000, 2))
    own = np.where(draws < 0, errors[:, 0], errors[:, 1])
    draws = theta + shifts[which] + draws * np.sqrt(own**2 + variances[which])
    assert mixture.ends == pytest.approx(np.quantile(draws, [0.025, 0.975], axis=0).T, abs=0.01)
    assert mixture.medians == pytest.approx(np.median(draws, axis=0), abs=0.002)
    nothing = np.zeros((3, 2))
    assert Mixture(intervals, theta, nothing, shares, 0.95, nothing).ends == pytest.approx(intervals)
    known = np.column_stack([theta, theta])
    assert Mixture(known, theta, nothing, shares, 0.95, nothing).ends == pytest.approx(known)
    open_ended = np.array([[-np.inf, 3.2], [9.0, np.inf]])
    at_bound = Mixture(np.array([[0.0, 0.2]]), np.zeros(1), nothing[:, :1], shares, 0.95, nothing[:, :1])
    assert at_bound.ends[0, 0] == at_bound.medians[0] == 0
    without_end = Mixture(open_ended, theta, shifts, shares, 0.95, nothing)
    assert np.array_equal(without_end.ends, open_ended)
    assert np.array_equal(without_end.medians, theta)
