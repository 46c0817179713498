"""mu with real parameters: closed forms, every value of the parameters on a grid, another library where it is there."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize_scalar

from trueplant.errors import UsageError
from trueplant.robust import Full, Real, Repeated, diagonal, mu, worst_gain

STRUCTURES = {
    "a parameter and a number": (Real(), Full(1)),
    "a parameter twice and a matrix": (Real(2), Full(2)),
    "2 parameters and a matrix": (Real(), Real(), Full(2)),
    "parameters among the rest": (Full(1, 2), Real(), Repeated(2), Real(2)),
    "3 parameters": (Real(), Real(), Real()),
}
SIZES = st.integers(0, 2**32 - 1)


def matrices(blocks, count: int, seed: int, real: bool = False) -> np.ndarray:
    rng = np.random.default_rng(seed)
    shape = (count, sum(b.columns for b in blocks), sum(b.rows for b in blocks))
    return rng.normal(size=shape) + (0 if real else 1j) * rng.normal(size=shape)


def adjoint(M: np.ndarray) -> np.ndarray:
    return M.conj().swapaxes(1, 2)


def check_proofs(M: np.ndarray, blocks, result) -> None:
    """What is returned proves the bounds."""
    assert np.all(result.lower <= result.upper)
    found = result.lower > 0
    assert np.all(np.isnan(result.delta[~found])) and np.all(np.isfinite(result.delta[found]))
    singular = np.linalg.svd(np.eye(M.shape[1]) - M[found] @ result.delta[found], compute_uv=False)
    assert np.all(singular[:, -1] < 1e-11 * np.maximum(singular[:, 0], 1))
    sizes = np.linalg.norm(result.delta[found], ord=2, axis=(1, 2))
    assert sizes * result.lower[found] == pytest.approx(1, rel=1e-9)
    left, right = result.scaling
    crossed = 1j * result.G @ M
    whole = adjoint(M) @ adjoint(left) @ left @ M + crossed + adjoint(crossed)
    back = np.linalg.inv(right)
    squared = np.linalg.eigvalsh(adjoint(back) @ whole @ back)[:, -1]
    scale = np.linalg.norm(left @ M @ back, axis=(1, 2)) ** 2 + np.linalg.norm(
        adjoint(back) @ crossed @ back, axis=(1, 2)
    )
    assert np.all(squared <= result.upper**2 + 1e-9 * scale)
    delta, G = result.delta[found].copy(), result.G.copy()
    z = w = 0
    for block in blocks:
        rows, columns = slice(w, w + block.rows), slice(z, z + block.columns)
        part, own = delta[:, rows, columns], G[:, rows, columns]
        if not isinstance(block, Full):
            assert part == pytest.approx(part[:, :1, :1] * np.eye(block.size), abs=1e-12 * np.abs(part).max(initial=1))
        if isinstance(block, Real):
            assert np.all(part.imag == 0)
            assert own == pytest.approx(adjoint(own), abs=1e-9 * np.abs(own).max(initial=1e-300))
            own[:] = 0
        # the scalings commute with every perturbation
        if not isinstance(block, Full) or block.rows == block.columns == 1:
            assert left[:, columns, columns] == pytest.approx(right[:, rows, rows], rel=1e-9)
        part[:] = 0
        w, z = w + block.rows, z + block.columns
    assert np.all(delta == 0) and np.all(G == 0)


def test_one_parameter_in_closed_form():
    """Only real eigenvalues count, and they count whole."""
    result = mu(np.array([[[3.0 + 0j]], [[-2.0]], [[1 + 1j]], [[0.0]]]), [Real()])
    assert result.upper == pytest.approx([3, 2, 0, 0], rel=1e-7) and result.lower == pytest.approx([3, 2, 0, 0])
    assert result.delta[:2, 0, 0] == pytest.approx([1 / 3, -1 / 2]) and np.all(np.isnan(result.delta[2:]))
    M = matrices([Real(4)], 200, seed=1, real=True)
    values = np.linalg.eigvals(M)
    exact = np.max(np.where(values.imag == 0, np.abs(values.real), 0.0), axis=1)
    result = mu(M, [Real(4)])
    assert result.lower == pytest.approx(exact, rel=1e-9) and np.all(result.upper >= exact * (1 - 1e-9))
    # the spectral radius is that of complex numbers, which a real one cannot reach
    assert np.all(result.upper <= np.max(np.abs(values), axis=1) * (1 + 1e-6)) and np.sum(exact == 0) > 5


def rank_one(a: np.ndarray, b: np.ndarray, parameters: int) -> float:
    """mu of a b^H for so many real numbers and then complex ones, by itself.

    The largest real t for which t - sum q_i c_i, |q_i| <= 1, reaches no further than the complex part: the smallest
    ratio of support functions, over the tangent of the angle, in which it is convex. (Young, Automatica 30, 1994,
    1899-1911, on this case.)
    """
    c = (a * b.conj())[:parameters]
    reach = np.sum(np.abs(a * b)[parameters:])

    def support(tangent: float) -> float:
        return float(np.sum(np.abs(c.real + tangent * c.imag)) + reach * np.hypot(1, tangent))

    kinks = [-x.real / x.imag for x in c if x.imag != 0]
    return min([support(k) for k in kinks] + [minimize_scalar(support, tol=1e-12).fun])


@pytest.mark.parametrize("parameters", [1, 2, 3])
def test_rank_one_in_closed_form(parameters):
    blocks = (*[Real()] * parameters, *diagonal(4 - parameters))
    rng = np.random.default_rng(parameters)
    a, b = rng.normal(size=(2, 60, 4)) + 1j * rng.normal(size=(2, 60, 4))
    M = a[:, :, None] * b[:, None, :].conj()
    result = mu(M, blocks)
    exact = np.array([rank_one(x, y, parameters) for x, y in zip(a, b, strict=True)])
    # the best G grows without bound here
    assert result.upper == pytest.approx(exact, rel=3e-4) and np.all(result.upper >= exact * (1 - 1e-9))
    assert np.all(result.lower <= exact * (1 + 1e-9)) and np.median(result.lower / exact) > 0.9999
    check_proofs(M, blocks, result)


def test_published_example():
    """Of the reference of SLICOT for its AB13MD, which prints an upper bound of 41.74753408."""
    rows = [
        [-1 + 6j, 2 - 3j, 3 + 8j, 3 + 8j, -5 - 9j, -6 + 2j],
        [4 + 2j, -2 + 5j, -6 - 7j, -4 + 11j, 8 - 7j, 12 - 1j],
        [5 - 4j, -4 - 8j, 1 - 3j, -6 + 14j, 2 - 5j, 4 + 16j],
    ]
    blocks = (Real(), Real(), Full(2), Full(1), Full(1))
    result = mu(np.array(rows * 2), blocks)
    assert result.upper[0] == pytest.approx(41.74753408, rel=1e-7) and result.lower[0] > 0.99 * result.upper[0]


@pytest.mark.parametrize("name", STRUCTURES)
@pytest.mark.parametrize("real", [False, True])
def test_bounds_are_proved(name, real):
    blocks = STRUCTURES[name]
    M = matrices(blocks, 60, seed=2, real=real)
    result = mu(M, blocks)
    check_proofs(M, blocks, result)
    covered = mu(M, [Repeated(b.size) if isinstance(b, Real) else b for b in blocks])
    assert np.all(result.upper <= covered.upper * (1 + 1e-12))
    assert np.median(result.upper / covered.upper) < 0.999 or real


def closed(M: np.ndarray, delta: np.ndarray) -> np.ndarray:
    """What the last two channels see of M under parameters (n_d, k) on the first ones, largest singular value."""
    k = delta.shape[1]
    back = np.linalg.solve(np.eye(k) - M[:k, :k] * delta[:, None, :], np.tile(M[:k, k:], (len(delta), 1, 1)))
    return np.linalg.norm(M[k:, k:] + (M[k:, :k] * delta[:, None, :]) @ back, ord=2, axis=(1, 2))


@pytest.mark.parametrize(("parameters", "points"), [(1, 4001), (2, 201), (3, 41)])
@pytest.mark.parametrize("real", [False, True])
def test_every_value_of_the_parameters(parameters, points, real):
    """No value on the grid needs a smaller perturbation than the upper bound allows, or than the one that was found."""
    blocks = (*[Real()] * parameters, Full(2))
    M = matrices(blocks, 12, seed=10 + parameters, real=real)
    result = mu(M, blocks)
    for m, low, high in zip(M, result.lower, result.upper, strict=True):
        axis = np.linspace(-1, 1, points) / low
        grid = np.array(list(itertools.product(axis, repeat=parameters)))
        with np.errstate(divide="ignore"):
            reached = np.max(np.minimum(1 / np.max(np.abs(grid), axis=1), closed(m, grid)))
        assert reached <= high * (1 + 1e-9)
        assert reached <= low * (1 + 1e-3)


def test_two_parameters_alone():
    """1 - a d - b e + c d e = 0 for real d and e: a quadratic equation for d."""
    M = matrices(diagonal(2), 300, seed=3)
    result = mu(M, [Real(), Real()])
    for m, low, high in zip(M, result.lower, result.upper, strict=True):
        a, b, c = m[0, 0], m[1, 1], np.linalg.det(m)
        d = np.roots([(a * c.conj()).imag, -(c.conj() + a * b.conj()).imag, b.conj().imag])
        d = d[np.abs(d.imag) < 1e-12].real
        e = ((1 - a * d) / (b - c * d)).real
        exact = np.max(1 / np.maximum(np.abs(d), np.abs(e)), initial=0.0)
        assert low == pytest.approx(exact, rel=1e-6, abs=1e-12) and high >= exact * (1 - 1e-9)
    assert 0.2 < np.mean(result.lower == 0) < 0.8


def test_real_matrices_are_worst_at_the_corners():
    blocks = [Real()] * 5
    M = matrices(blocks, 40, seed=4, real=True)
    exact = np.zeros(len(M))
    for signs in itertools.product([1.0, -1.0], repeat=5):
        values = np.linalg.eigvals(M * np.array(signs))
        exact = np.maximum(exact, np.max(np.where(values.imag == 0, values.real, 0.0), axis=1))
    assert mu(M, blocks).lower == pytest.approx(exact, rel=1e-6)


def test_stability_limits_of_an_oscillator():
    """s^2 + c (1 + 0.5 d) s + 1 + 0.2 e with feedback k: stable while both coefficients are above 0."""
    w = np.concatenate([np.linspace(1e-9, 3, 600), [np.sqrt(1.5)]])
    s = 1j * w
    H = 1 / (s**2 + 0.4 * s + 1.5)
    # w = delta z: d drives -0.2 s y, e drives -0.2 y
    M = -np.stack([np.stack([0.2 * s * H, 0.2 * s * H], 1), np.stack([0.2 * H, 0.2 * H], 1)], 1)
    result = mu(M, [Real(), Real()])
    # damping vanishes at d = -2 whatever e is, stiffness at e = -7.5
    assert result.lower.max() == pytest.approx(0.5, rel=1e-6) and result.upper.max() == pytest.approx(0.5, rel=1e-5)
    assert mu(M, diagonal(2)).upper.max() > 0.6


@settings(max_examples=4, deadline=None)
@given(seed=SIZES, real=st.booleans())
def test_more_freedom_never_lowers_mu(seed, real):
    M = matrices(diagonal(4), 20, seed, real)
    order = [
        (Real(2), Real(), Full(1)),
        (Real(), Real(), Real(), Full(1)),
        (Full(1), Real(), Real(), Full(1)),
        (Full(2), Real(), Full(1)),
        (Full(2), Full(2)),
    ]
    results = [mu(M, blocks) for blocks in order]
    for smaller, larger in itertools.pairwise(results):
        assert np.all(smaller.lower <= larger.upper * (1 + 1e-9))
        assert np.all(smaller.upper <= larger.upper * (1 + 1e-6) + 1e-4 * np.abs(M).max())


@settings(max_examples=4, deadline=None)
@given(seed=SIZES, factor=st.floats(1e-6, 1e6), sign=st.sampled_from([1, -1]))
def test_scaling_by_a_real_number(seed, factor, sign):
    blocks = STRUCTURES["2 parameters and a matrix"]
    M = matrices(blocks, 20, seed)
    plain, scaled = mu(M, blocks), mu(sign * factor * M, blocks)
    assert scaled.upper == pytest.approx(factor * plain.upper, rel=1e-5)
    # and by any scaling that commutes
    d = 10 ** np.random.default_rng(seed).uniform(-4, 4, size=(20, 3))[:, [0, 1, 2, 2]]
    assert mu(d[:, :, None] * M / d[:, None, :], blocks).upper == pytest.approx(plain.upper, rel=1e-4)


def test_worst_gain_of_a_parameter():
    """|1/(1 - 0.5 d)| over |d| <= 1 is 2, and over complex numbers as well; of 1/(1 - 0.5j d) it is 1, against 2."""
    for m, real, cover in ((0.5, 2.0, 2.0), (0.5j, 1.0, 2.0)):
        N = np.array([[[m, m], [1.0, 1.0]]])
        low, high = worst_gain(N, [Real(), Full(1)], 1)
        assert low[0] == pytest.approx(real, rel=1e-3) and high[0] == pytest.approx(real, rel=1e-3)
        assert worst_gain(N, diagonal(2), 1)[1][0] == pytest.approx(cover, rel=1e-5)


def test_complex_structures_have_no_G():
    result = mu(matrices(diagonal(3), 5, seed=6), diagonal(3))
    assert result.G.shape == (5, 3, 3) and not np.any(result.G)


def test_wrong_input_is_named():
    with pytest.raises(UsageError, match="size of at least 1"):
        Real(0)
    with pytest.raises(UsageError, match="fit a matrix with 3 rows and 3 columns, not 2 and 2"):
        mu(np.eye(2), [Real(2), Full(1)])


@pytest.mark.parametrize("kinds", ["rc", "rrc", "rrrr", "rrrrc", "crcr"])
@pytest.mark.parametrize("real", [False, True])
def test_upper_bound_is_at_least_as_tight_as_slicots(kinds, real):
    slycot = pytest.importorskip(
        "slycot",
        reason="slycot is GPL, so a user's own choice: install trueplant[hinf] to compare mu with its ab13md",
    )
    blocks = [Real() if kind == "r" else Full(2) for kind in kinds]
    M = matrices(blocks, 200, seed=len(kinds), real=real)
    own = mu(M, blocks)
    sizes, types = np.array([b.rows for b in blocks]), np.array([1 if b.is_real else 2 for b in blocks])
    other = np.array([slycot.ab13md(m.astype(complex), sizes, types)[0] for m in M])
    assert np.all(own.upper <= other * (1 + 1e-5) + 1e-4)
    assert np.all(own.lower <= other * (1 + 1e-6) + 1e-4)
