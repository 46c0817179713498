"""Structured singular values: published examples, defining properties, and another library where it is installed."""

from __future__ import annotations

import numpy as np
import pytest

from trueplant.errors import UsageError
from trueplant.robust import Full, Repeated, diagonal, mu

STRUCTURES = {
    "2 numbers": diagonal(2),
    "2 numbers and a matrix": (*diagonal(2), Full(2)),
    "3 matrices": (Full(2), Full(3), Full(1)),
    "not square": (Full(2, 3), Full(1, 2)),
    "a repeated number": (Repeated(3),),
    "a repeated number and a matrix": (Repeated(2), Full(2)),
}
"""All with twice the repeated blocks plus the full blocks at most 3, where the upper bound is exact."""


def random_matrices(blocks, count: int, seed: int, real: bool = False) -> np.ndarray:
    rng = np.random.default_rng(seed)
    shape = (count, sum(b.columns for b in blocks), sum(b.rows for b in blocks))
    return rng.normal(size=shape) + (0 if real else 1j) * rng.normal(size=shape)


def norms(matrices: np.ndarray) -> np.ndarray:
    return np.linalg.norm(matrices, ord=2, axis=(1, 2))


def check_proofs(M: np.ndarray, blocks, result) -> None:
    """What is returned proves the bounds."""
    assert np.all(result.lower <= result.upper)
    found = result.lower > 0
    difference = np.eye(M.shape[1]) - M[found] @ result.delta[found]
    singular = np.linalg.svd(difference, compute_uv=False)
    assert np.all(singular[:, -1] < 1e-11 * np.maximum(singular[:, 0], 1))
    assert norms(result.delta[found]) * result.lower[found] == pytest.approx(1, rel=1e-9)
    left, right = result.scaling
    assert norms(left @ M @ np.linalg.inv(right)) == pytest.approx(result.upper, rel=1e-9)
    # of the structure: only the blocks are there, and the scalings commute with them
    delta = result.delta[found].copy()
    z = w = 0
    for block in blocks:
        part = delta[:, w : w + block.rows, z : z + block.columns]
        if isinstance(block, Repeated):
            one = part[:, :1, :1] * np.eye(block.size)
            assert np.allclose(part, one, rtol=0, atol=1e-12 * np.abs(part).max())
        part[:] = 0
        w, z = w + block.rows, z + block.columns
    assert np.all(delta == 0)


def test_textbook_matrix():
    M = np.array([[2.0, 2.0], [-1.0, -1.0]])
    full, diag, one = mu(M, [Full(2)]), mu(M, diagonal(2)), mu(M, [Repeated(2)])
    for result, value in ((full, np.sqrt(10)), (diag, 3.0), (one, 1.0)):
        assert result.lower[0] == pytest.approx(value, rel=1e-7) and result.upper[0] == pytest.approx(value, rel=1e-7)


def test_spinning_satellite():
    """Input errors of G = [[s - 100, 10 (s + 1)], [-10 (s + 1), s - 100]]/(s^2 + 100) under Q = I."""
    s = 1j * np.concatenate([[0.0], np.geomspace(1e-3, 1e3, 200)])
    G = np.array([[s - 100, 10 * (s + 1)], [-10 * (s + 1), s - 100]]) / (s**2 + 100)
    G = G.transpose(2, 0, 1)
    T = G @ np.linalg.inv(np.eye(2) + G)
    for blocks in ([Full(2)], diagonal(2)):
        result = mu(T, blocks)
        assert result.upper.max() == pytest.approx(np.sqrt(101), rel=1e-9)
        assert result.lower.max() == pytest.approx(np.sqrt(101), rel=1e-9)


@pytest.mark.parametrize("name", STRUCTURES)
@pytest.mark.parametrize("real", [False, True])
def test_bounds_are_proved_and_meet_where_theory_says_so(name, real):
    blocks = STRUCTURES[name]
    M = random_matrices(blocks, 120, seed=1, real=real)
    result = mu(M, blocks)
    assert np.all(result.lower > 0.999 * result.upper)
    check_proofs(M, blocks, result)


def test_many_blocks_leave_a_small_gap():
    blocks = (*diagonal(4), Full(2))
    M = random_matrices(blocks, 100, seed=2)
    result = mu(M, blocks)
    assert np.median(result.lower / result.upper) > 0.999 and np.min(result.lower / result.upper) > 0.9
    check_proofs(M, blocks, result)


def test_extreme_structures_are_norm_and_spectral_radius():
    M = random_matrices([Full(4)], 50, seed=3)
    assert mu(M, [Full(4)]).upper == pytest.approx(norms(M), rel=1e-12)
    radius = np.max(np.abs(np.linalg.eigvals(M)), axis=1)
    one = mu(M, [Repeated(4)])
    assert one.upper == pytest.approx(radius, rel=1e-6) and one.lower == pytest.approx(radius, rel=1e-6)


def test_rank_one_in_closed_form():
    """mu(a b^H) is the sum of |a_k| |b_k| over the blocks."""
    blocks = (*diagonal(3), Full(2))
    rng = np.random.default_rng(4)
    a, b = rng.normal(size=(2, 40, 5)) + 1j * rng.normal(size=(2, 40, 5))
    a[0, 1], b[1, 2] = 0, 0
    result = mu(a[:, :, None] * b[:, None, :].conj(), blocks)
    expected = np.sum(np.abs(a[:, :3] * b[:, :3]), axis=1) + np.linalg.norm(a[:, 3:], axis=1) * np.linalg.norm(
        b[:, 3:], axis=1
    )
    assert result.upper == pytest.approx(expected, rel=1e-7) and result.lower == pytest.approx(expected, rel=1e-7)


def test_scaling_that_commutes_changes_nothing():
    blocks = STRUCTURES["2 numbers and a matrix"]
    M = random_matrices(blocks, 60, seed=5)
    d = 10 ** np.random.default_rng(6).uniform(-9, 9, size=(60, 3))[:, [0, 1, 2, 2]]
    plain, scaled = mu(M, blocks), mu(d[:, :, None] * M / d[:, None, :], blocks)
    assert scaled.upper == pytest.approx(plain.upper, rel=1e-6)
    assert scaled.lower == pytest.approx(plain.lower, rel=1e-6)
    assert mu(1e-120 * M, blocks).upper == pytest.approx(1e-120 * plain.upper, rel=1e-9)


@pytest.mark.parametrize(
    ("matrix", "blocks", "value"),
    [
        (np.zeros((2, 2)), diagonal(2), 0.0),
        (np.array([[0.0, 1.0], [0.0, 0.0]]), diagonal(2), 0.0),
        (np.array([[1.0, 1e5], [0.0, 2.0]]), diagonal(2), 2.0),
        (np.array([[0.0, 1.0, 5.0], [0.0, 3.0, 1.0], [0.0, 0.0, -2j]]), diagonal(3), 3.0),
        (np.array([[1.0, 1e9], [1e-9, 1.0]]), diagonal(2), 2.0),
        (np.array([[3.0 - 4.0j]]), diagonal(1), 5.0),
        (np.array([[2.0, 1.0], [0.0, 2.0]]), [Repeated(2)], 2.0),
        (np.array([[1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [0.0, 0.0, 0.0]]), diagonal(3), 2.0),
    ],
)
def test_zeros_triangles_and_bad_scaling(matrix, blocks, value):
    result = mu(matrix, blocks)
    assert result.upper[0] == pytest.approx(value, rel=1e-4, abs=1e-12)
    assert result.lower[0] == pytest.approx(value, rel=1e-6, abs=1e-12)
    assert np.all(np.isnan(result.delta)) == (value == 0)


def test_unitary_matrices_have_the_size_one():
    """Every singular value is largest: hard for the lower bound, which must still be proved and near."""
    blocks = STRUCTURES["2 numbers and a matrix"]
    M = np.linalg.qr(random_matrices(blocks, 100, seed=8))[0]
    result = mu(M, blocks)
    assert result.upper == pytest.approx(1.0, rel=1e-9)
    assert np.median(result.lower) > 0.999 and np.min(result.lower) > 0.95
    check_proofs(M, blocks, result)


@pytest.mark.parametrize("spread", [1e-12, 1e-6])
def test_elements_of_very_different_size(spread):
    blocks = STRUCTURES["2 numbers and a matrix"]
    M = random_matrices(blocks, 100, seed=9)
    M *= spread ** np.random.default_rng(10).uniform(size=M.shape)
    result = mu(M, blocks)
    assert np.all(result.lower > 0.999 * result.upper)
    check_proofs(M, blocks, result)


def test_zero_among_others():
    M = random_matrices(diagonal(2), 3, seed=7)
    M[1] = 0
    result = mu(M, diagonal(2))
    assert result.upper[1] == 0 and np.all(result.lower[[0, 2]] > 0)
    assert mu(np.zeros((0, 2, 2)), diagonal(2)).upper.shape == (0,)


def test_wrong_input_is_named():
    with pytest.raises(UsageError, match="fit a matrix with 2 rows and 2 columns, not 3 and 3"):
        mu(np.eye(3), diagonal(2))
    with pytest.raises(UsageError, match="finite"):
        mu(np.array([[np.nan]]), diagonal(1))
    with pytest.raises(UsageError, match="shape"):
        mu(np.ones(3), diagonal(3))
    with pytest.raises(UsageError, match="at least one block"):
        mu(np.eye(2), [])
    with pytest.raises(UsageError, match="size of at least 1"):
        Repeated(0)
    with pytest.raises(UsageError, match="one row and one column"):
        Full(-1)


@pytest.mark.parametrize("sizes", [(1, 1), (1, 1, 2), (2, 2, 1), (1, 1, 1, 1), (3, 1, 1), (1, 1, 2, 2)])
def test_upper_bound_is_at_least_as_tight_as_slicots(sizes):
    slycot = pytest.importorskip(
        "slycot",
        reason="slycot is GPL, so a user's own choice: install trueplant[hinf] to compare mu with its ab13md",
    )
    blocks = [Full(n) for n in sizes]
    M = random_matrices(blocks, 500, seed=sum(sizes))
    own = mu(M, blocks)
    other = np.array([slycot.ab13md(m, np.array(sizes), np.full(len(sizes), 2))[0] for m in M])
    assert np.all(own.upper <= other * (1 + 1e-6))
    assert np.all(own.lower <= other * (1 + 1e-9))
