"""Spikes of a sensor: told from disturbances by what they leave in the prediction errors. Simulated records."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from support.lag_loop import LAW, MODEL, PLANT, SPEC, TRUTH
from support.simulated import random_switching, segment_of
from trueplant.identify import Row, identify_matrix, identify_output, pieces_of, specs_of
from trueplant.identify.between_samples import _thinned
from trueplant.identify.spikes import _Errors, set_aside, without_spikes
from trueplant.loop import simulate

POLE = 0.9


def record(seed, size=0.0, heavy=False, samples=2000):
    """One loop under an AR(1) disturbance whose innovations have a standard deviation of 0.05, and its spikes (N,).

    One sample in a hundred is a spike of that `size`, up or down, which the controller sees as well. `heavy`: the
    innovations have Student's t distribution with 3 degrees of freedom, and the same standard deviation.
    """
    rng = np.random.default_rng(seed)
    e = 0.05 * (rng.standard_t(3, samples) / np.sqrt(3) if heavy else rng.standard_normal(samples))
    v = np.zeros(samples)
    for k in range(1, samples):
        v[k] = POLE * v[k - 1] + e[k]
    places = rng.choice(np.arange(20, samples - 20), samples // 100, replace=False)
    spikes = np.zeros(samples)
    spikes[places] = size * rng.choice([-1.0, 1.0], places.size)
    r = random_switching(rng, samples, 1, 60.0)
    measured = simulate(PLANT, LAW, r, 1.0, v=(v + spikes)[:, None])
    return segment_of(measured), spikes


def fitted(segment):
    return without_spikes(identify_output([segment], 0, [SPEC]).fit)


def taken_off(fit):
    (piece,) = fit.row.pieces
    return np.zeros(piece.y.size) if piece.spikes is None else piece.spikes


def test_spikes_are_found_with_their_sizes_and_nothing_else():
    """8 records, spikes of eight innovations: all of 160 but a pair of neighbours, each within four standard errors,
    which are 0.05/sqrt(1 + 0.81), and not one of 15,840 samples more."""
    found, there = [], []
    for seed in range(8):
        segment, spikes = record(seed, 0.4)
        found.append(taken_off(fitted(segment)))
        there.append(spikes)
    sizes, spikes = np.concatenate(found), np.concatenate(there)
    assert np.count_nonzero(spikes) == 160
    assert np.count_nonzero(sizes) >= 158
    assert np.max(np.abs(sizes - spikes)[sizes != 0]) < 4 * 0.05 / np.sqrt(1 + POLE**2)


@pytest.mark.parametrize(("heavy", "most"), [(False, 1), (True, 16)], ids=["normal", "student t"])
def test_disturbances_are_no_spikes(heavy, most):
    """8 records without a spike. Of some 190 innovations of Student's t beyond five standard deviations of the others
    some come in pairs that look like one."""
    taken = [taken_off(fitted(record(seed, heavy=heavy)[0])) for seed in range(8)]
    assert sum(map(np.count_nonzero, taken)) <= most


def test_a_fit_without_spikes_is_the_same_fit():
    fit = identify_output([record(0)[0]], 0, [SPEC]).fit
    assert without_spikes(fit) is fit


def test_the_estimate_is_as_good_as_without_spikes_and_as_sure():
    """24 records: rms errors of gain, lag and dead time are within a quarter of those of the same records without
    spikes, standard errors within 15 %, and as many of the 72 intervals of 95 % cover, three more or less."""
    errors, sure, covered = [], [], np.zeros(2)
    for seed in range(24):
        both = [identify_matrix([record(seed, size)[0]], MODEL, specs_of(MODEL))[0] for size in (0.4, 0.0)]
        errors.append([one.theta - TRUTH for one in both])
        sure.append([np.sqrt(np.diag(one.covariance)) for one in both])
        covered += [int(np.sum((one.intervals[:, 0] <= TRUTH) & (one.intervals[:, 1] >= TRUTH))) for one in both]
    rms = np.sqrt(np.mean(np.square(errors), axis=0))
    assert np.all(rms[0] < 1.25 * rms[1])
    assert np.all(np.abs(np.log(np.median(np.divide(*np.transpose(sure, (1, 0, 2))), axis=0))) < np.log(1.15))
    assert abs(covered[0] - covered[1]) <= 3


def test_spikes_cost_degrees_of_freedom():
    segment, spikes = record(3, 0.4)
    fit = fitted(segment)
    row = Row(fit.row.specs, tuple(replace(piece, spikes=None) for piece in fit.row.pieces))
    assert fit.left == replace(fit, row=row).left - np.count_nonzero(spikes)


def test_they_are_taken_off_the_segments_in_their_places_and_put_back():
    """Two segments with a gap between them, which the fit sees as one piece, at every second sample."""
    segment, spikes = record(1, 0.4)
    cut = [segment.part(0, 901), segment.part(907)]
    spikes[1::2] = 0.0
    row = Row((SPEC,), pieces_of(cut, 0), 2)
    known = np.zeros(2000)
    known[::2] = spikes[::2]
    (piece,) = row.pieces
    fit = identify_output([segment], 0, [SPEC]).fit
    with_spikes = replace(fit, row=replace(row, pieces=(replace(piece, spikes=known),)))
    first, second = set_aside(cut, 0, with_spikes)
    assert np.array_equal(first.spikes[:, 0], known[:901])
    assert np.array_equal(second.spikes[:, 0], known[907:])
    assert np.allclose(second.y[:, 0], segment.y[907:, 0] - known[907:])
    again = pieces_of([first, second], 0)[0]
    assert np.array_equal(again.spikes[:901], known[:901])
    assert not np.any(again.spikes[901:907])
    for one, before in zip(set_aside([first, second], 0, replace(fit, row=row)), cut, strict=True):
        assert one.spikes is None
        assert np.allclose(one.y, before.y)


def test_every_second_sample_keeps_its_own_spikes():
    """As the error of an OP that acts between its samples is asked for (`between_samples`)."""
    fit = fitted(record(2, 0.4)[0])
    (piece,), sizes = fit.row.pieces, taken_off(fit)
    for phase in range(2):
        (thinned,) = _thinned(fit.row, phase).pieces
        assert np.array_equal(thinned.spikes, sizes[phase::2])
        assert np.array_equal(thinned.y, piece.y[phase::2])


def errors_with(*spikes, loud=0, samples=400):
    """White errors that turn into those of AR(1) with a pole of 0.9 when a spike is added to the output; `loud` of
    them in the middle are five times as large."""
    rng = np.random.default_rng(5)
    e = rng.standard_normal(samples)
    middle = slice(samples // 2 - loud // 2, samples // 2 - loud // 2 + loud)
    e[middle] = 5 * np.sign(e[middle]) * np.abs(e[middle]).clip(0.5, 1.5)
    for at, size in spikes:
        e[at] += size
        e[at + 1] -= POLE * size
    return _Errors(e, np.array([-POLE]), 0.0)


def found(errors):
    return list(np.flatnonzero(errors.sizes(np.zeros(errors.errors.size))))


@pytest.mark.holds("identify.SPIKE_SAMPLES")
def test_a_spike_lasts_three_samples_at_most():
    """Of five in a row not all are taken off at once, and of five of one size none: a disturbance came and went."""
    sizes = (30.0, -20.0, 25.0, -30.0, 20.0)
    assert found(errors_with(*enumerate(sizes[:3], start=200))) == [200, 201, 202]
    assert len(found(errors_with(*enumerate(sizes, start=200)))) < 5
    assert found(errors_with(*((200 + k, 30.0) for k in range(5)))) == []


@pytest.mark.holds("identify.SPIKE_AROUND")
def test_a_spike_stands_out_from_the_forty_errors_around_it():
    """One of 12 usual standard deviations is a spike among 15 louder errors, and none among 31 of 41."""
    assert 200 in found(errors_with((200, 12.0), loud=15))
    assert 200 not in found(errors_with((200, 12.0), loud=31))


def test_what_is_below_the_digits_recorded_is_no_spike():
    errors = errors_with((200, 12.0))
    assert found(errors) == [200]
    assert found(replace(errors, rounding=10.0)) == []


def test_neighbouring_spikes_are_sized_together():
    """Two, of which one is known already with a size that takes all there is for its own."""
    errors = errors_with((200, 20.0), (201, -15.0))
    sizes = errors.sizes(np.zeros(400))
    assert list(np.flatnonzero(sizes)) == [200, 201]
    assert sizes[200:202] == pytest.approx([20, -15], abs=3)
