"""Structures that are too simple are rejected, the right one is named, and the gain then covers. Simulated records."""

from __future__ import annotations

import numpy as np
import pytest

from support.chance import most
from support.simulated import coloured, random_switching, segment_of
from trueplant.identify import Spec, identify_matrix, specs_of, structures
from trueplant.identify.estimate import estimate_row, polished
from trueplant.identify.levels import STRUCTURE_SHARE
from trueplant.identify.pieces import pieces_of
from trueplant.identify.row import Row
from trueplant.identify.structures import richer, sufficient_p, with_real_lags
from trueplant.loop import PID, Controller, simulate
from trueplant.lti import Structure, TransferMatrix
from trueplant.record.types import Segment

SLOW = Controller.diagonal([PID(Kc=0.3, Ti=12.0, sample_time=1.0)])
FAST = Controller.diagonal([PID(Kc=0.8, Ti=10.0, sample_time=1.0)])
FIRST = "2 exp(-3 s)/(10 s + 1)"
TRUTH = {
    "sopdt": "2 exp(-3 s)/((12 s + 1)(8 s + 1))",
    "sopdt+lead": "2 (-4 s + 1) exp(-3 s)/((12 s + 1)(5 s + 1))",
    "pair": "2 exp(-3 s)/(100 s^2 + 10 s + 1)",
}
TAIL = "2 (70 s + 1) exp(-2 s)/((10 s + 1)(100 s + 1))"


def found(plant: str, seed: int, samples: int = 1500, std: float = 0.1, law: Controller = SLOW):
    """A simulated single loop under PI, declared as of first order."""
    rng = np.random.default_rng(seed)
    r = random_switching(rng, samples, 1, 40.0)
    v = coloured(rng, samples, 1, [1, -0.8], [1], std)
    record = segment_of(simulate(TransferMatrix.of([[plant]], "min"), law, r, 1.0, v=v))
    model = TransferMatrix.of([[FIRST]], "min")
    return identify_matrix(
        [record], model, {(0, 0): Spec(0, Structure.parse("fopdt"), (2.0, 10.0, 3.0))}, structures=True
    )[0]


@pytest.mark.parametrize("name", TRUTH)
def test_the_right_structure_is_named(name):
    estimates = [found(TRUTH[name], seed) for seed in range(4)]
    for estimate in estimates:
        assert str(estimate.row.specs[0].structure) == name
        assert str(estimate.rejected[0].structure) == "fopdt" and estimate.rejected[0].p_value < 0.01
        assert abs(estimate.theta[0] - 2) < 4 * np.sqrt(estimate.covariance[0, 0])
    # what was right in the model's element is still said: its gain, and that alone
    assert estimates[0].row.specs[0].initial[0] == 2.0
    assert 0 not in estimates[0].row.specs[0].undeclared


def test_a_slow_tail_is_seen_where_correlation_over_its_first_samples_sees_nothing():
    estimates = [found(TAIL, seed, law=FAST, std=0.03) for seed in range(4)]
    assert all(0 in estimate.rejected for estimate in estimates)
    assert all(estimate.intervals[0, 0] <= 2.0 <= estimate.intervals[0, 1] for estimate in estimates)


def test_what_a_richer_structure_lacks_is_looked_for_in_its_turn():
    """A second lag shows first; then that a slow part follows, which the gain at rest hangs on."""
    slow = "2 (40 s + 1) exp(-2 s)/((120 s + 1)(14 s + 1)(4 s + 1))"
    for seed in range(3):
        estimate = found(slow, seed, samples=3000, std=0.02, law=FAST)
        assert estimate.row.specs[0].structure.lags == 3, "fopdt lacks two lags"
        assert str(estimate.rejected[0].structure) == "fopdt", "the structure that was declared"
        low, high = estimate.intervals[0]
        assert low <= 2.0 <= high


@pytest.mark.parametrize(("second", "named"), [(0.02, "sopdt+lead"), (0.06, "sopdt")])
def test_one_that_took_the_place_of_another_is_asked_at_an_ordinary_level(second, named, monkeypatch):
    """The declared one has been said by somebody, and is rejected at a share of that level only."""
    following, p_values, asked = {"fopdt": "sopdt", "sopdt": "sopdt+lead"}, iter([1e-6, second, 0.5]), []

    def chosen(fit, m, confidence, level):
        asked.append(level)
        wanted = following[str(fit.row.specs[m].structure)]
        offered = richer(fit.row.specs[m].structure, fit.theta[fit.row.slices[m]], 5.0)
        return next(one for one in offered if str(one[0]) == wanted)

    monkeypatch.setattr(structures, "sufficient_p", lambda fit, confidence: np.array([next(p_values)]))
    monkeypatch.setattr(structures, "simplest", chosen)
    assert str(found(TRUTH["sopdt"], 0).row.specs[0].structure) == named
    assert asked == pytest.approx([STRUCTURE_SHARE * 0.05, 0.05][: len(asked)])


def test_pairs_that_do_not_swing_are_lags():
    pair = Structure.parse("pair+lead")
    p = pair.parameters(2.0, [], 0.2, 1.25, 5.0, 3.0)
    structure, q = with_real_lags(pair, p)
    assert str(structure) == "sopdt+lead"
    s = 1j * np.geomspace(1e-3, 10, 50)
    np.testing.assert_allclose(structure.transfer(q)(s), pair.transfer(p)(s), rtol=1e-12)
    swinging = pair.parameters(2.0, [], 0.2, 0.5, 5.0, 3.0)
    assert with_real_lags(pair, swinging)[0] == pair


def test_rounding_rejects_no_structure():
    r = random_switching(np.random.default_rng(0), 1500, 1, 40.0)
    record = segment_of(simulate(TransferMatrix.of([[FIRST]], "min"), SLOW, r, 1.0))
    row = Row((Spec(0, Structure.parse("fopdt"), (1.8, 9.0, 3.3)),), pieces_of([record], 0))
    assert np.array_equal(sufficient_p(polished(estimate_row(row, 10.0)), 0.95), [1.0])


@pytest.mark.slow
def test_level_where_the_structure_is_the_plants():
    """80 seeded runs, at most 9 below 5 %: passes with 0.992 at that level, with 0.029 at 20 %."""
    estimates = [found(FIRST, seed, samples=800, std=0.2) for seed in range(80)]
    p = np.array([estimate.structure_p[0] for estimate in estimates])
    assert np.sum(p < 0.05) <= most(80, 0.05)
    # What is replaced is beyond the share that is kept for structures.
    assert all(p[k] < 0.05 * STRUCTURE_SHARE for k, estimate in enumerate(estimates) if estimate.rejected)


@pytest.mark.parametrize(
    "text",
    ["gain", "fopdt+lead", "fopdt", "sopdt", "sopdt+lead", "pair", "integrator", "integrator+lag", "sopdt+delayed"],
)
def test_richer_structures_begin_with_parameters_of_their_own(text):
    structure = Structure.parse(text)
    p = structure.parameters(2.0, [9.0, 4.0][: structure.lags], 0.1, 0.7, -3.0, [2.0, 5.0][: structure.delayed])
    offered = list(richer(structure, p, 5.0))
    assert offered
    for one, start in offered:
        low, high = one.bounds()
        assert start.shape == (len(one.names),) and np.isfinite(start).all()
        assert np.all(start >= low) and np.all(start <= high)
        assert one.relative_degree > 0 and one != structure


@pytest.mark.parametrize("seed", [0, 7])
def test_a_trace_of_op_in_pv_is_not_taken_for_the_plant(seed):
    """A hundredth of OP reaches PV at once, the rest by two lags and a dead time: an autoregression describes how PV
    follows its set-point well, and the trace all the rest. The gain at rest is 0.99, and not -0.01."""
    record = with_trace(seed, -0.01)
    model = TransferMatrix.of([["exp(-10 s)/(50 s + 1)"]])
    found = identify_matrix([record], model, specs_of(model), structures=True)[0]
    assert str(found.row.specs[0].structure) == "sopdt"
    low, high = found.intervals[0]
    assert 0 < low < 0.99 < high and found.theta[0] == pytest.approx(0.99, rel=0.1)


def with_trace(seed: int, trace: float, samples: int = 1000) -> Segment:
    """A simulated loop under PI whose PV shows so much of OP three samples later."""
    rng = np.random.default_rng(seed)
    r, v = random_switching(rng, samples, 1, 80.0)[:, 0], coloured(rng, samples, 1, [1, -0.8], [1], 0.01)[:, 0]
    slow, fast, gone = np.exp(-1 / np.array([73.0, 8.6])), np.zeros(2), 0.0
    u, y = np.zeros(samples), np.zeros(samples)
    for k in range(samples):
        y[k] = fast[1] + v[k] + trace * u[max(k - 3, 0)]
        gone += (r[k] - y[k]) / 25
        u[k] = 2 * (r[k] - y[k]) + gone
        fast = slow * fast + (1 - slow) * np.array([u[k - 12] if k >= 12 else 0.0, fast[0]])
    columns = (x[:, None] for x in (r, u, y))
    ones = np.ones((samples, 1), dtype=bool)
    return Segment(0, 1.0, np.arange(samples) * 1.0, *columns, np.zeros((samples, 0)), ones, ("zoh",))
