"""The fit's normal equations against a plain reference, and what they are made of against other libraries."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import lstsq, orth

from trueplant.identify import Row, Spec, levels
from trueplant.identify.fit import evaluate, linearised
from trueplant.identify.linear_algebra import eliminated, remove
from trueplant.identify.noise import measured_from, whitened_valid
from trueplant.identify.pieces import Piece
from trueplant.lti import sampled_response
from trueplant.lti.structure import Structure

STRUCTURES = ("sopdt+lead", "integrator+lag", "pair+lag", "sopdt+delayed")
AR = np.array([-0.9, 0.2, 0.05])
H = 0.5


def parameters(name: str) -> np.ndarray:
    """Lags differ from element to element: two that are equal have one free response between them."""
    structure = Structure.parse(name)
    slowest = 6.0 + len(name) / 5
    p = structure.parameters(0.8, slowest / np.arange(1, structure.lags + 1), 0.4, 0.45, 2.5, 1.3)
    if structure.delayed > 1:
        p[1], p[-1] = -0.5, 3.6
    return p


def row_of(names: tuple[str, ...], stride: int = 1, gaps: bool = False) -> Row:
    """Two pieces of simulated data: one begins in motion, with a gap and a load step if asked for; one at rest."""
    rng = np.random.default_rng(7)
    pieces = []
    for n, motion in ((331, True), (240, False)):
        inputs = np.repeat(rng.standard_normal((len(names), -(-n // 9))), 9, axis=1)[:, :n]
        inputs = inputs - inputs[:, :1]
        inputs[:, : 0 if motion else 40] = 0.0
        y = 0.05 * rng.standard_normal(n)
        for name, u in zip(names, inputs, strict=True):
            y += sampled_response(Structure.parse(name).transfer(1.1 * parameters(name)), u, H)
        y += np.exp(-np.arange(n) * H / 8) * motion
        valid = np.ones(n, dtype=bool)
        valid[[5, 100]] = not gaps
        valid[150:161] = not (gaps and motion)
        restarts, jumps = ((161,), (200,)) if gaps and motion else ((), ())
        hold = ("zoh",) * len(names)
        pieces.append(Piece(0, H, np.where(valid, y, 0.0), valid, inputs, hold, restarts, 0.0, jumps))
    return Row(tuple(Spec(k, Structure.parse(name)) for k, name in enumerate(names)), tuple(pieces), stride)


def plain_errors(row: Row, theta: np.ndarray, ar: np.ndarray, k: int) -> np.ndarray:
    """Prediction errors of one piece: responses of transfer functions, exponentials, least squares."""
    piece, specs = row.pieces[k], row.specs
    at = np.arange(0, piece.y.size, row.stride)
    v = piece.y[at].copy()
    columns = [np.ones(at.size)]
    for spec, part in zip(specs, row.slices, strict=True):
        p = theta[part]
        v -= sampled_response(spec.structure.transfer(p), piece.inputs[spec.column], piece.h)[at]
        for start in ([] if row.rests(k) else [0]) + list(piece.restarts):
            t, began = np.maximum(at - start, 0) * piece.h, at >= start
            columns += [began * np.exp(-t / tau) for tau in p[spec.structure.is_lag]]
            for w, z in zip(p[spec.structure.is_frequency], p[spec.structure.is_damping], strict=True):
                swing = began * np.exp(-z * w * t)
                columns += [swing * np.cos(w * np.sqrt(1 - z**2) * t), swing * np.sin(w * np.sqrt(1 - z**2) * t)]
            if spec.structure.integrators:
                columns.append(began * (t if start == 0 else 1.0))
    columns += [(at >= jump).astype(float) for jump in piece.jumps]
    seen = np.flatnonzero([piece.valid[at][m - ar.size : m + 1].all() for m in range(ar.size, at.size)])

    def white(x: np.ndarray) -> np.ndarray:
        return sum(a * x[ar.size - m : at.size - m] for m, a in enumerate([1.0, *ar]))[seen]

    basis = orth(np.column_stack([white(c) / np.linalg.norm(white(c)) for c in columns]), rcond=1e-9)
    e = white(v)
    return e - basis @ (basis.T @ e)


@pytest.mark.parametrize(("stride", "gaps"), [(1, False), (1, True), (3, False)])
@pytest.mark.parametrize("names", [STRUCTURES[:2], STRUCTURES[2:], ("fopdt",), ()])
def test_cost_information_and_slope_against_a_plain_reference(names, stride, gaps):
    row = row_of(names, stride, gaps)
    theta = np.concatenate([np.zeros(0), *(parameters(name) for name in names)])
    weights = np.array([1.0, 0.7])
    point = evaluate(row, theta, AR, weights)
    errors = [w * plain_errors(row, theta, AR, k) for k, w in enumerate(weights)]
    power = sum(float(e @ e) for e in errors)
    assert np.isclose(point.power[:, 0].sum(), power, rtol=1e-9)
    assert point.count == sum(e.size for e in errors)
    found = list(linearised(row, theta, AR, weights))
    for piece, e in zip(found, errors, strict=True):
        assert np.allclose(piece.errors, e, rtol=0, atol=1e-9 * np.max(np.abs(e)))
    stacked = np.hstack([piece.jacobian for piece in found])
    slope = stacked @ np.hstack([piece.errors for piece in found])
    x = np.concatenate([theta, AR])
    for m in range(x.size):
        step = 2e-4 * x[m] * np.eye(x.size)[m]
        ends = [_cost(row, x + times * step, theta.size, weights) for times in (-2, -1, 1, 2)]
        expected = (ends[0] - 8 * ends[1] + 8 * ends[2] - ends[3]) / (12 * step[m]) / 2
        assert abs(slope[m] - expected) < 1e-8 * np.linalg.norm(stacked[m]) * np.sqrt(power)


@pytest.mark.parametrize(("stride", "gaps"), [(1, False), (1, True), (2, True)])
@pytest.mark.parametrize("names", [STRUCTURES[:2], ()])
def test_normal_equations_are_the_same_whether_or_not_derivatives_are_written_out(names, stride, gaps, monkeypatch):
    row = row_of(names, stride, gaps)
    theta = np.concatenate([np.zeros(0), *(parameters(name) for name in names)])
    ar = np.concatenate([AR, 0.02 * np.random.default_rng(3).standard_normal(20)])
    weights = np.array([1.0, 0.7])
    plain = evaluate(row, theta, ar, weights)
    monkeypatch.setattr(levels, "WRITTEN_OUT", 5)
    by_correlations = evaluate(row, theta, ar, weights)
    size = np.sqrt(np.diag(plain.information))
    assert plain.cost == by_correlations.cost
    assert np.all(np.abs(by_correlations.information - plain.information) < 1e-11 * np.outer(size, size))
    assert np.all(np.abs(by_correlations.slope - plain.slope) < 1e-11 * size * np.sqrt(plain.power[:, 0].sum()))


def _cost(row: Row, x: np.ndarray, size: int, weights: np.ndarray) -> float:
    return sum(float(w**2 * np.sum(plain_errors(row, x[:size], x[size:], k) ** 2)) for k, w in enumerate(weights))


@pytest.mark.parametrize(("stride", "gaps"), [(1, True), (3, False)])
def test_derivatives_of_free_responses_against_differences(stride, gaps):
    row = row_of(STRUCTURES, stride, gaps)
    theta = np.concatenate([parameters(name) for name in STRUCTURES])
    unknown = row.unknown(theta, 0)
    amplitudes = np.random.default_rng(1).standard_normal(len(unknown.rows))
    gradient = unknown.gradient(amplitudes)
    for m in range(row.size):
        step = 1e-3 * theta[m] * np.eye(row.size)[m]
        ends = [row.unknown(theta + times * step, 0).columns @ amplitudes for times in (-2, -1, 1, 2)]
        expected = (ends[0] - 8 * ends[1] + 8 * ends[2] - ends[3]) / (12 * step[m])
        assert np.allclose(gradient[:, m], expected, rtol=0, atol=1e-9 * max(np.max(np.abs(expected)), 1.0))


@given(st.integers(0, 2**32 - 1), st.integers(1, 9), st.integers(0, 4), st.integers(0, 8))
@settings(max_examples=60, deadline=None)
def test_elimination_of_dependent_columns_against_scipy(seed, rank, more, decades):
    """Columns of very different sizes, some of them sums of others, some 0."""
    rng = np.random.default_rng(seed)
    independent = rng.standard_normal((40, rank))
    columns = np.hstack([independent, independent @ rng.standard_normal((rank, more)), np.zeros((40, 1))])
    columns *= 10.0 ** rng.uniform(-decades, decades, columns.shape[1])
    target = rng.standard_normal(40)
    weights, basis = eliminated(columns, target)
    assert basis.shape == (40, rank)
    assert np.allclose(basis.T @ basis, np.eye(rank), atol=1e-12)
    sizes = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    expected = columns @ (lstsq(columns / sizes, target, cond=1e-7)[0] / sizes)
    assert np.allclose(columns @ weights, expected, atol=1e-9)
    rest = np.array([target])
    remove(basis.T.copy(), rest)
    assert np.allclose(rest[0], target - expected, atol=1e-9)


@given(st.lists(st.booleans(), min_size=1, max_size=40), st.integers(0, 8))
def test_where_prediction_errors_begin_and_whether_all_follow(measured, order):
    valid = np.array(measured)
    good = whitened_valid(order, valid)
    first, all_follow = measured_from(order, valid)
    assert first == (int(np.argmax(good)) if good.any() else -1)
    assert first < 0 or all_follow == bool(good[first:].all())
