"""OP that moves between its recorded samples. All records are simulated."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from support.chance import most
from support.simulated import BLT, WOOD_BERRY, coloured, random_switching, segment_of, wood_berry
from trueplant.identify import identify_matrix, identify_output, specs_of, sticking, try_valves
from trueplant.identify.between_samples import _averaged, covariance_between_looks, covariance_between_samples
from trueplant.identify.pieces import Piece
from trueplant.identify.strides import Sampling
from trueplant.identify.structures import sufficient_p
from trueplant.identify.valves import FoundValve
from trueplant.loop import PID, Controller, Valve, simulate
from trueplant.lti import Structure, TransferMatrix
from trueplant.lti.structure import structure_of
from trueplant.record.types import Segment
from trueplant.result.budget import Source

FOPDT = TransferMatrix.of([["-0.7/(12 s + 1)"]])
TRUTH = [np.concatenate([structure_of(WOOD_BERRY[i, j])[1] for j in range(2)]) for i in range(2)]


def every(segment: Segment, n: int) -> Segment:
    """The record of a historian that keeps each n-th sample."""
    rows = {name: np.ascontiguousarray(getattr(segment, name)[::n]) for name in ("t", "r", "u", "y", "d", "free")}
    return Segment(segment.experiment, n * segment.h, hold=segment.hold, **rows)


def test_a_record_that_is_fine_enough_moves_gains_and_lags_by_little_more_than_chance():
    """Lags of 17 and 21 samples; the dead time of one sample falls between those that are left."""
    row = [spec for (i, _), spec in sorted(specs_of(WOOD_BERRY).items()) if i == 0]
    moved = []
    for seed in range(6):
        fit = identify_output([segment_of(wood_berry(60 + seed, 2000))], 0, row).fit
        moved.append(np.sqrt(np.diag(covariance_between_samples(fit, 0.05)) / np.diag(fit.covariance)))
    assert np.all(np.median(moved, axis=0)[[0, 1, 3, 4]] < 3)
    assert np.median(moved, axis=0)[2] > 10


def test_gains_and_lags_are_covered_where_the_controller_scans_eight_times_a_sample():
    missed, without, index = 0, 0, [0, 1, 3, 4]  # gains and lags
    for seed in range(12):
        rng = np.random.default_rng(900 + seed)
        v = coloured(rng, 8000, 2, [1, -0.95], [1], 0.3)
        fine = segment_of(simulate(WOOD_BERRY, BLT, random_switching(rng, 8000, 2, 200.0), 0.5, v=v))
        record = every(fine, 8)
        for i, found in identify_matrix([record], WOOD_BERRY, specs_of(WOOD_BERRY), timing=record.h / 2).items():
            low, high = found.intervals[index].T
            missed += int(np.sum((TRUTH[i][index] < low) | (TRUTH[i][index] > high)))
            bare = np.sqrt(np.diag(found.covariance - covariance_between_samples(found.fit, record.h / 2)))
            without += int(np.sum(np.abs(found.theta - TRUTH[i])[index] > 1.96 * bare[index]))
    assert missed <= most(96, 0.05) < without


def finely(
    dead_time: float,
    samples: int,
    seed: int,
    *,
    lag: float = 300.0,
    tuning: tuple[float, float] = (4.0, 100.0),
    pole: float = 0.9999,
    size: tuple[float, float] = (0.5, 0.1),
    moves: float = 2.0,
    valve: Valve | None = None,
) -> tuple[TransferMatrix, Segment]:
    """A lag of many samples under a PI, Kc and Ti; a disturbance reaches PV, and the transmitter has noise of its own:
    `size`. The set-point `moves` every so many lags."""
    rng = np.random.default_rng(seed)
    plant = TransferMatrix.of([[f"2 exp(-{dead_time} s)/({lag} s + 1)"]])
    v = coloured(rng, samples, 1, [1, -pole], [1], size[0])
    r = random_switching(rng, samples, 1, moves * lag)
    law = Controller.diagonal([PID(Kc=tuning[0], Ti=tuning[1], sample_time=1.0)])
    valves = None if valve is None else [valve]
    record = simulate(plant, law, r, 1.0, v=v, noise=[size[1]], seed=seed, valves=valves)
    return plant, segment_of(record)


def test_dead_times_are_covered_where_op_acts_between_the_samples_that_are_looked_at():
    """Every second of 60,000: OP has seen the noise of the others as well."""
    missed, without = 0, 0
    for seed in range(12):
        plant, record = finely(10.0, 60_000, 50 + seed)
        found = identify_output([record], 0, list(specs_of(plant).values()), sampling=Sampling(2))
        off = abs(found.theta[2] - 10.0)
        bare = found.covariance[2, 2] - covariance_between_looks(found.fit)[2, 2]
        missed += int(off > 1.96 * np.sqrt(found.covariance[2, 2]))
        without += int(off > 1.96 * np.sqrt(bare))
    assert missed <= 1 < 3 <= without


def test_nothing_is_between_looks_at_every_measurement_or_in_open_loop():
    plant, record = finely(10.0, 3000, 1)
    specs = list(specs_of(plant).values())
    sampled = Sampling(1), Sampling(2, update=2), Sampling(2)
    every, held, second = (identify_output([record], 0, specs, sampling=one) for one in sampled)
    assert not covariance_between_looks(every.fit).any() and not covariance_between_looks(held.fit).any()
    moved = covariance_between_looks(second.fit)
    assert moved.any()
    opened = identify_output([replace(record, closed=False)], 0, specs, sampling=Sampling(2))
    assert not covariance_between_looks(opened.fit).any()
    rounding = [found.uncounted[Source.ROUNDING] for found in (second, opened)]
    np.testing.assert_allclose(rounding[0] - rounding[1], moved, rtol=1e-9, atol=1e-12 * moved.max())


def test_op_that_tells_what_the_disturbance_did_between_looks_is_no_richer_structure():
    """An answer of the plant before the next look, every eighth sample, would pass for the controller's."""
    found = []
    for seed in range(4):
        plant, record = finely(40.0, 40_000, 70 + seed, tuning=(2.0, 300.0), pole=0.95)
        fit = identify_output([record], 0, list(specs_of(plant).values()), sampling=Sampling(8)).fit
        anywhere = replace(fit, row=replace(fit.row, per_look=1))
        found.append([sufficient_p(one, 0.95)[0] for one in (fit, anywhere)])
    bound, anywhere = np.array(found).T
    assert np.all(bound > 0.01) and np.all(anywhere < 1e-6)


def valve_of(plant: TransferMatrix, record: Segment, stride: int) -> list[FoundValve | None]:
    """What is found sticking, and what would be if PV between looks were not asked."""
    found = identify_output([record], 0, list(specs_of(plant).values()), sampling=Sampling(stride))
    alone = replace(found, fit=replace(found.fit, row=replace(found.fit.row, per_look=1)))
    return [sticking(try_valves({0: one}, [0])).get(0) for one in (found, alone)]


def test_what_pv_did_between_looks_is_no_valve_that_sticks():
    """Every tenth of a lag of 3,000: what OP did about the noise of the others looks as if its stem had not."""
    for seed in (4, 5):
        slow = {"lag": 3000.0, "tuning": (2.5, 3000.0), "pole": 0.9996, "size": (0.1, 0.03), "moves": 6.0}
        plant, record = finely(30.0, 200_000, seed, **slow)
        found, alone = valve_of(plant, record, 10)
        assert found is None and alone is not None


def test_a_valve_that_sticks_is_found_where_measurements_are_left_out():
    quiet = {"tuning": (2.0, 300.0), "pole": 0.9995, "size": (0.1, 0.03), "moves": 6.0}
    plant, record = finely(40.0, 60_000, 70, valve=Valve(backlash=0.5), **quiet)
    found, _ = valve_of(plant, record, 8)
    assert found.valve.backlash == pytest.approx(0.5, rel=0.1)


def test_a_dead_time_is_sought_four_looks_away_and_may_be_nearer():
    """Its interval reaches down to 0: what happens before the next looks is not known."""
    plant, record = finely(10.0, 20_000, 90)
    found = identify_output([record], 0, list(specs_of(plant).values()), sampling=Sampling(8))
    assert found.theta[2] >= 32.0 and found.intervals[2, 0] == 0.0


@pytest.mark.parametrize(("count", "apart"), [(4, 1), (3, 2)])
def test_means_of_inputs_move_means_of_pv(count: int, apart: int):
    """The answer to averaged inputs is the averaged answer, but for a PV that was not measured for a moment."""
    rng, theta, fopdt = np.random.default_rng(3), np.array([2.0, 20.0, 3.4]), Structure.parse("fopdt")
    u, valid = np.cumsum(rng.standard_normal(400)), np.ones(400, dtype=bool)
    u, valid[200:202] = u - u[0], False
    y = fopdt.response(theta, u, 1.0)
    piece = _averaged(Piece(0, 1.0, np.where(valid, y, 0.0), valid, u[None], ("zoh",)), count, count * apart)
    answer = fopdt.response(theta, piece.inputs[0], 1.0)
    near = slice(200, 202 + (count - 1) * apart)
    first = (count - 1) * apart
    assert not piece.valid[:first].any() and piece.valid[first:200].all() and piece.valid[near.stop :].all()
    np.testing.assert_allclose(np.delete(answer, near)[count * apart :], np.delete(piece.y, near)[count * apart :])
    assert np.all(np.abs(answer - piece.y)[near][piece.valid[near]] < 0.2 * np.std(np.diff(y)) * count)
