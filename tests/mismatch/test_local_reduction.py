"""Structures fitted to the response of one element."""

from __future__ import annotations

import numpy as np
import pytest

from trueplant.errors import Refused
from trueplant.lti.structure import Structure
from trueplant.mismatch import fit_structure, sampled_frequency_response

W = np.geomspace(0.01, 3, 60)


@pytest.mark.parametrize("h", [None, 0.3])
@pytest.mark.parametrize(
    ("name", "truth"),
    [
        ("fopdt", [2.0, 5.0, 1.37]),
        ("sopdt", [-1.5, 12.0, 4.0, 2.2]),
        ("sopdt+lead", [3.0, 20.0, 2.0, -3.0, 4.4]),
        ("pair", [0.7, 0.4, 0.3, 0.9]),
        ("integrator+lag", [0.2, 3.0, 1.1]),
        ("gain", [4.0]),
        ("sopdt+delayed", [4.0, -4.4056, 6.0, 2.0, 0.21, 0.67]),
    ],
)
def test_structures_are_recovered_from_their_own_response(name, truth, h):
    structure, truth = Structure.parse(name), np.array(truth)
    g = structure.transfer(truth)
    value = g(1j * W) if h is None else sampled_frequency_response(g, W, h)
    start = truth * 1.1 if structure.delayed > 1 else None
    found = fit_structure(W, value, 0.01 * np.abs(value), structure, h, initial=start).parameters
    fitted = structure.transfer(found)
    np.testing.assert_allclose(
        fitted(1j * W) if h is None else sampled_frequency_response(fitted, W, h), value, rtol=1e-5, atol=1e-8
    )
    if structure.delayed == 1:
        np.testing.assert_allclose(found, truth, rtol=1e-4)


def test_the_right_one_of_several_minima_in_dead_time_is_found():
    """A resonance rings: dead times one period apart look alike."""
    structure, truth = Structure.parse("pair+lead"), np.array([0.125, 2.0, 0.25, -8.0, 8.0])
    rng = np.random.default_rng(1)
    value = structure.transfer(truth)(1j * np.linspace(0.05, 6, 80))
    noise = 0.05 * (rng.standard_normal(80) + 1j * rng.standard_normal(80)) / np.sqrt(2)
    found, covariance, *_ = fit_structure(np.linspace(0.05, 6, 80), value + noise, np.full(80, 0.05), structure)
    assert np.all(np.abs(found - truth) < 4 * np.sqrt(np.diag(covariance)))


def test_covariance_is_that_of_many_noisy_responses():
    """300 seeded draws with neighbours correlated in threes, as in a window of the local method."""
    structure, truth = Structure.parse("fopdt"), np.array([2.0, 5.0, 1.37])
    rng = np.random.default_rng(2)
    root = np.array([[1.0, 0, 0], [0.6, 0.8, 0], [0.3j, 0.5, 0.8]]) * 0.02
    covariance = np.broadcast_to(root @ root.conj().T, (20, 3, 3))
    std = np.tile(np.sqrt(np.diag(covariance[0]).real), 20)
    value = structure.transfer(truth)(1j * W)
    draws, claimed = [], None
    for _ in range(300):
        e = (rng.standard_normal((20, 3, 1)) + 1j * rng.standard_normal((20, 3, 1))) / np.sqrt(2)
        noisy = value + (root @ e).ravel()
        found, claimed, *_ = fit_structure(W, noisy, std, structure, covariance=covariance, initial=truth)
        draws.append(found)
    np.testing.assert_allclose(np.std(draws, axis=0), np.sqrt(np.diag(claimed)), rtol=0.15)
    np.testing.assert_allclose(np.mean(draws, axis=0), truth, atol=4 * np.sqrt(np.diag(claimed).max() / 300))


def test_points_without_a_value_are_left_out_and_too_few_are_refused():
    structure, truth = Structure.parse("fopdt"), np.array([2.0, 5.0, 1.37])
    value = structure.transfer(truth)(1j * W)
    std = np.full(W.size, 0.01)
    value[10:20], std[30:40] = np.nan, np.nan
    found = fit_structure(W, value, std, structure).parameters
    np.testing.assert_allclose(found, truth, rtol=1e-5)
    value[1:] = np.nan
    with pytest.raises(Refused, match="1 frequencies say something"):
        fit_structure(W, value, std, structure)
