"""Load steps: found where they are, taken along, and not read into records without them. Simulated records."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from support.lag_loop import FOPDT, LAW, MODEL, PLANT, SPEC, TRUTH
from support.simulated import BLT, WOOD_BERRY, coloured, random_switching, segment_of
from trueplant import plants
from trueplant.identify import (
    Row,
    Spec,
    fit_row,
    found_loads,
    identify_matrix,
    identify_output,
    pieces_of,
    specs_of,
)
from trueplant.identify.fit import Whitening
from trueplant.identify.load_gains import likeliest_load
from trueplant.identify.loads import find_loads
from trueplant.identify.noise import whiten
from trueplant.loop import PID, Controller, Step, simulate
from trueplant.lti import Structure, TransferMatrix
from trueplant.record import Load

LOADS = ((450.0, 0.12), (980.0, -0.1), (1350.0, 0.08))


def record(seed, loads=(), samples=1500, noise=None):
    """One loop whose set-point moves three times, under loads at the plant's input."""
    rng = np.random.default_rng(seed)
    r = np.zeros((samples, 1))
    r[samples // 5 :] = 1.0
    r[samples // 2 :] = 0.3
    r[4 * samples // 5 :] = 0.8
    v = 0.02 * rng.standard_normal((samples, 1)) if noise is None else noise
    steps = [Step(at, (size,)) for at, size in loads]
    return segment_of(simulate(PLANT, LAW, r, 1.0, v=v, input_disturbance=steps))


def estimated(segment):
    return identify_matrix([segment], MODEL, specs_of(MODEL))[0]


def test_load_steps_are_found_with_their_sizes_and_the_gain_is_right_beside_them():
    """8 records; sizes within 4 standard errors, instants within half of the lag, gains in their 95 % intervals."""
    covered, narrower = 0, []
    for seed in range(8):
        segment = record(seed, LOADS)
        estimate = estimated(segment)
        found = found_loads({0: estimate.fit})
        assert len(found) == len(LOADS)
        for one, (at, size) in zip(found, LOADS, strict=True):
            assert abs(one.load.time - at) < TRUTH[1] / 2
            assert abs(one.size - size) < 4 * one.error < 0.5 * abs(size)
        low, high = estimate.intervals[0]
        covered += low <= TRUTH[0] <= high
        plain = identify_output([segment], 0, [SPEC])
        narrower.append(np.sqrt(estimate.covariance[0, 0] / plain.covariance[0, 0]))
    assert covered >= 7
    assert np.median(narrower) < 0.5, "what knowing of the loads is worth"


def test_a_load_at_one_input_of_two_is_found_there_by_both_outputs():
    """Wood-Berry, 4 records: reflux and steam move both outputs alike, and only together do they tell which it was."""
    for seed in range(4):
        rng = np.random.default_rng(seed)
        r = random_switching(rng, 1500, 2, 60.0)
        v = coloured(rng, 1500, 2, [1, -0.8], [1], 0.2)
        at, column = float(rng.integers(200, 1300)), seed % 2
        step = Step(at, tuple((0.1, 0.1)[column] * np.eye(2)[column]))
        segment = segment_of(simulate(WOOD_BERRY, BLT, r, 1.0, v=v, input_disturbance=[step]))
        estimates = identify_matrix([segment], WOOD_BERRY, specs_of(WOOD_BERRY))
        (found,) = found_loads({i: estimate.fit for i, estimate in estimates.items()})
        assert found.load.column == column
        assert abs(found.load.time - at) <= 10, "less than the shortest lag"
        assert abs(found.size - 0.1) < 4 * found.error


KINDS = ("white", "AR", "random walk", "1/f", "Student t", "outliers")


@pytest.mark.parametrize("kind", KINDS)
def test_none_is_read_into_a_record_without_any(kind):
    """10 records each: at a chance of 5 % more than three have a chance of 0.1 %."""
    with_some = 0
    for seed in range(10):
        rng = np.random.default_rng([seed, KINDS.index(kind)])
        white = rng.standard_normal((2500, 1))
        slow = np.cumprod(np.concatenate([[1.0], (np.arange(1, 1000) - 0.5) / np.arange(1, 1000)]))
        noise = {
            "white": 0.02 * white,
            "AR": coloured(rng, 2500, 1, [1, -0.95], [1], 0.05),
            "random walk": 0.004 * np.cumsum(white, axis=0),
            "1/f": 0.02 * np.convolve(white[:, 0], slow)[:2500, None],
            "Student t": 0.02 * rng.standard_t(3, (2500, 1)),
            "outliers": 0.02 * white * np.where(rng.random((2500, 1)) < 0.01, 10.0, 1.0),
        }[kind][1000:]
        with_some += bool(found_loads({0: estimated(record(seed, noise=noise)).fit}))
    assert with_some <= 3


def test_a_fit_of_a_record_without_loads_is_left_alone():
    row = Row((SPEC,), pieces_of([record(2)], 0))
    assert find_loads({0: fit_row(row, TRUTH, np.array([0.0, 0.0]))}) == {}


def test_what_a_load_gains_is_what_least_squares_gains():
    """Against columns built one by one, for theta and noise model as they are; samples 3 min apart see it as well."""
    for stride in (1, 3):
        row = Row((SPEC,), pieces_of([record(1, LOADS[:1])], 0), stride)
        fit = fit_row(row, TRUTH, np.array([-0.3, -0.2]))
        best = likeliest_load({0: fit}, 0.0)
        assert abs(best.load.time - LOADS[0][0]) <= 2 * stride
        (whitening,) = Whitening.of(fit)
        known = np.column_stack([whitening.jacobian.T, whitening.basis])
        course = (np.arange(row.pieces[0].y.size) >= best.load.time).astype(float)
        answer = FOPDT.response(fit.theta, course, 1.0, "zoh", stride)

        def left(*more, known=known, e=whitening.errors):
            x = np.column_stack([known, *more])
            x = x / np.linalg.norm(x, axis=0)
            return np.sum((e - x @ np.linalg.lstsq(x, e, rcond=None)[0]) ** 2)

        gain = (left() - left(whitening.weight * whiten(fit.ar, answer)[whitening.use])) / (left() / fit.left)
        assert best.gain == pytest.approx(gain, rel=1e-6)


def test_two_outputs_add_up_what_one_load_gains():
    """The same record twice, as two outputs: a load of one size in both gains twice as much."""
    row = Row((SPEC,), pieces_of([record(1, LOADS[:1])], 0))
    fit = fit_row(row, TRUTH, np.array([-0.3, -0.2]))
    one, two = likeliest_load({0: fit}, 0.0), likeliest_load({0: fit, 1: fit}, 0.0)
    assert two.load == one.load
    assert two.gain == pytest.approx(2 * one.gain, rel=1e-9)


def test_loads_stay_at_their_time_when_a_record_is_cut():
    load = Load(0, 700.0)
    (piece,) = pieces_of([replace(record(0), loads=(load,))], 0)
    assert piece.stepping == (load,)
    assert piece.from_sample(650).stepping == (load,)
    assert piece.from_sample(700).stepping == piece.from_sample(0, 700).stepping == ()
    whole, part = (Row((SPEC,), (own,)).unknown(TRUTH, 0).rows[-1] for own in (piece, piece.from_sample(650)))
    assert np.allclose(whole[650:], part, atol=1e-12)


def test_derivatives_of_loads_against_differences():
    (piece,) = pieces_of([replace(record(0), loads=(Load(0, 700.0), Load(0, 900.0)))], 0)
    for name, p in (("sopdt+lead", [1.5, 8.0, 3.0, -2.0, 2.3]), ("pair", [1.2, 0.2, 0.6, 3.1])):
        structure = Structure.parse(name)
        row = Row((Spec(0, structure),), (piece,))
        amplitudes = np.random.default_rng(1).standard_normal(len(row.unknown(np.array(p), 0).rows))
        gradient = row.unknown(np.array(p), 0).gradient(amplitudes)
        for m in range(row.size):
            step = 1e-4 * p[m] * np.eye(row.size)[m]
            ends = [row.unknown(p + times * step, 0).columns @ amplitudes for times in (-2, -1, 1, 2)]
            expected = (ends[0] - 8 * ends[1] + 8 * ends[2] - ends[3]) / (12 * step[m])
            assert np.allclose(gradient[:, m], expected, rtol=0, atol=1e-6 * max(np.max(np.abs(expected)), 1.0))


SLOW_START = Structure.parse("sopdt").transfer(np.array([0.65, 12.0, 9.0, 1.0]))
FIRST_ORDER = TransferMatrix(((FOPDT.transfer(np.array([0.65, 30.0, 2.0])),),), "min")


def of_a_second_lag(seed, loads=()):
    """400 samples of a plant with a second lag, which its model lacks, in little noise."""
    rng = np.random.default_rng(seed)
    r = np.zeros((400, 1))
    r[80:] = 1.0
    r[240:] = 0.2
    law = Controller.diagonal([PID(Kc=3.0, Ti=15.0, sample_time=1.0)])
    plant = TransferMatrix(((SLOW_START,),), "min")
    steps = [Step(at, (size,)) for at, size in loads]
    v = 0.001 * rng.standard_normal((400, 1))
    return segment_of(simulate(plant, law, r, 1.0, v=v, input_disturbance=steps))


@pytest.mark.parametrize("structures", [True, False])
def test_what_a_structure_leaves_after_a_move_is_no_load(structures):
    """Beside the first order that was said, half of such records seem to have steps after the moves; these are among
    them."""
    for seed in (1, 2, 3, 6):
        segment = of_a_second_lag(seed)
        estimate = identify_matrix([segment], FIRST_ORDER, specs_of(FIRST_ORDER), structures=structures)[0]
        assert found_loads({0: estimate.fit}) == []
        assert not structures or estimate.row.specs[0].structure.names == ("gain", "tau1", "tau2", "dead_time")
        asked = identify_output([segment], 0, [Spec(0, FOPDT, (0.65, 30.0, 2.0))])
        assert find_loads({0: asked.fit})


def test_a_load_beside_a_structure_that_does_not_suffice_is_found():
    for seed in range(4):
        segment = of_a_second_lag(seed, [(160.0, 0.1)])
        estimate = identify_matrix([segment], FIRST_ORDER, specs_of(FIRST_ORDER), structures=True)[0]
        (found,) = found_loads({0: estimate.fit})
        assert abs(found.load.time - 160) < 2
        assert abs(found.size - 0.1) < 4 * found.error < 0.02
        assert estimate.row.specs[0].structure.names == ("gain", "tau1", "tau2", "dead_time")
        assert estimate.intervals[0, 0] < 0.65 < estimate.intervals[0, 1]


def test_rounding_holds_no_loads():
    """The paper's mill without noise: its second output's errors, of a few billionths, were predicted to rounding."""
    case = plants.mill("eq37")
    r = random_switching(np.random.default_rng(1), 8000, 2, 135.0)
    segment = segment_of(simulate(case.plant, case.controller, r, 0.037))
    estimate = identify_output([segment], 1, [spec for (i, _), spec in sorted(specs_of(case.model).items()) if i == 1])
    assert estimate.fit.ar.size == 0
    assert not find_loads({1: estimate.fit})
    assert np.allclose(estimate.theta, [2.2, 6.6, 0.6, 2.547, 3.5, 0.13], rtol=1e-6)
