"""The mismatch expression (17)-(20), the joint form, and the first-order covariance of both.

All functions work on arrays over complex points s: signals are (n_s, n_signals, n_experiments), one column an
experiment (or a segment of one record); transfer matrices are (n_s, rows, columns). Systems of equations are
solved for all points at once; no matrix is inverted that could be solved with.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trueplant.arrays import Array, BoolArray, ComplexArray
from trueplant.errors import LoopError, Refused, UsageError
from trueplant.mismatch import levels


@dataclass(frozen=True, eq=False)
class Mismatch:
    """Mismatch and plant at the points s. NaN where `usable` is False."""

    delta: ComplexArray
    """(n_s, n_y, n_u) plant minus model."""
    plant: ComplexArray
    """(n_s, n_y, n_u)"""
    X: ComplexArray
    """(n_s, n_y, n_r) from set-points to e: the paper's e r^-1."""
    condition: Array
    """(n_s,) condition number of the excitation matrix, its rows and columns scaled to length 1 so that units
    and step sizes do not count."""
    usable: BoolArray
    """(n_s,) True where the excitation matrix can be inverted."""


def closed_form(
    R: ComplexArray,
    E: ComplexArray,
    Ghat: ComplexArray,
    Q: ComplexArray,
    V: ComplexArray | None = None,
    F: ComplexArray | None = None,
    weights: Array | None = None,
) -> Mismatch:
    """Equations (17)-(20): the mismatch from set-points, residuals, model and controller.

    R, E and V (disturbances at the outputs, known) are (n_s, n_y, n_experiments); Ghat and Q (n_s, n_y, n_y);
    F (n_s, n_y, n_y) makes the controller u = Q (F r - y). With more experiments than outputs
    X = (E - V)(F R - V)^-1 is their least-squares solution, `weights` (n_experiments,) being the relative
    inverse variance of each. Written as Delta = (I - X)^-1 (X Ghat + X Q^-1), which neither overflows where
    Q is infinite nor loses digits where the mismatch is small.

    Raises Refused where the set-points excite no point s enough, LoopError for a plant that is not square,
    UsageError for arrays that do not fit together.
    """
    n_s, n_y, _ = R.shape
    V = np.zeros_like(E) if V is None else V
    _same_shape(E, R, "E", "R")
    _same_shape(V, R, "V", "R")
    if Ghat.shape[1] != Ghat.shape[2]:
        raise LoopError(
            f"(17)-(20) need as many inputs as outputs, not {Ghat.shape[2]} and {Ghat.shape[1]}: use the joint form"
        )
    _has_shape(Ghat, (n_s, n_y, n_y), "Ghat")
    _has_shape(Q, (n_s, n_y, n_y), "Q")
    moved = (R if F is None else F @ R) - V
    condition, usable = _excitation(moved)
    X = _ratio(E - V, moved, usable, weights)
    left = np.eye(n_y) - X
    usable = usable & (_condition(left) < 1 / np.finfo(float).eps)
    left = np.where(usable[:, None, None], left, np.eye(n_y))
    delta = np.linalg.solve(left, X @ Ghat + over_controller(X, Q))
    delta[~usable] = np.nan
    return Mismatch(delta, Ghat + delta, X, condition, usable)


def joint(
    R: ComplexArray,
    Y: ComplexArray,
    U: ComplexArray,
    Ghat: ComplexArray | None = None,
    weights: Array | None = None,
) -> Mismatch:
    """Joint form G = (Y R^-1)(U R^-1)^-1, Delta = (E R^-1)(U R^-1)^-1, which needs no controller.

    R (n_s, n_r, n_experiments) are the set-points and whatever else moved the loop from outside; n_r must be at
    least n_u, and the experiments at least n_r. Y is (n_s, n_y, n_experiments), U (n_s, n_u, n_experiments).
    Without a model, Ghat counts as 0 and `delta` is the plant.

    Raises Refused where the experiments do not span the set-points or the inputs.
    """
    n_s, n_u, n_experiments = U.shape
    n_y, n_r = Y.shape[1], R.shape[1]
    _has_shape(Y, (n_s, n_y, n_experiments), "Y")
    _has_shape(R, (n_s, n_r, n_experiments), "R")
    model = np.zeros((n_s, n_y, n_u), complex) if Ghat is None else Ghat
    _has_shape(model, (n_s, n_y, n_u), "Ghat")
    if n_r < n_u:
        raise Refused(
            f"{n_r} external signals cannot tell {n_u} inputs apart: add experiments in which further inputs are moved "
            "from outside, and list those movements beside the set-points"
        )
    condition, usable = _excitation(R)
    X = _ratio(Y - model @ U, R, usable, weights)
    U_r = _ratio(U, R, usable, weights)
    spans = usable & (_condition(U_r) < levels.WORST_CONDITION)
    if not spans.any():
        raise Refused(
            "the inputs move in proportion in all experiments, so that their effects cannot be told apart: "
            "add an experiment that moves them differently"
        )
    delta = _ratio(X, U_r, spans, None)
    return Mismatch(delta, model + delta, X, condition, spans)


def consistency(
    R: ComplexArray, Y: ComplexArray, U: ComplexArray, Q: ComplexArray, F: ComplexArray | None = None
) -> Array:
    """Gap (n_s, n_u) between the recorded U and Q (F R - Y), relative to U.

    Near 0 where the declared controller is what ran. Wrong tuning shows at some frequencies, a wrong action at
    all (a gap of 2), manual mode and saturation at low ones, a wrong scan time at high ones.
    """
    declared = Q @ ((R if F is None else F @ R) - Y)
    _same_shape(declared, U, "Q (F R - Y)", "U")
    size = np.linalg.norm(U, axis=2)
    gap = np.linalg.norm(U - declared, axis=2)
    return np.where(size > 0, gap / np.where(size > 0, size, 1.0), np.where(gap > 0, np.inf, 0.0))


def plant_covariance(U: ComplexArray, spectrum: ComplexArray) -> ComplexArray:
    """First-order covariance (n_s, n_y n_u, n_y n_u) of vec G under unmeasured v, of either form.

    cov vec G = (U U*)^-T kron Phi_v, columns of G stacked (element (i, j) at j n_y + i). U (n_s, n_u,
    n_experiments) are the inputs without noise, `spectrum` (n_s, n_y, n_y) = E V V* for one experiment, in the
    units of U's transform. For s on the imaginary axis, where noise is circular and E|dG|^2 says all; Re and Im
    have half of it each.
    """
    gram = U @ _adjoint(U)
    return _kron(np.linalg.inv(gram).transpose(0, 2, 1), spectrum)


def closed_form_covariance(X: ComplexArray, plant: ComplexArray, Q: ComplexArray, of_X: ComplexArray) -> ComplexArray:
    """Covariance of vec G from that of vec X: dG = (I - X)^-1 dX (G + Q^-1)."""
    identity = np.broadcast_to(np.eye(X.shape[1], dtype=complex), X.shape)
    right = plant + over_controller(identity, Q)
    step = _kron(right.transpose(0, 2, 1), np.linalg.inv(identity - X))
    return step @ of_X @ _adjoint(step)


def standard_errors(covariance: ComplexArray, shape: tuple[int, int]) -> Array:
    """sqrt(E|dG|^2) (n_s, n_y, n_u) from a covariance of vec G."""
    n_y, n_u = shape
    variance = np.diagonal(covariance, axis1=1, axis2=2).real
    return np.sqrt(variance.reshape(-1, n_u, n_y).transpose(0, 2, 1))


def over_controller(X: ComplexArray, Q: ComplexArray) -> ComplexArray:
    """X Q^-1. An infinite entry of Q (integral action at s = 0) counts as what it is: its inverse is 0."""
    infinite = ~np.isfinite(Q)
    if infinite.any():
        crossed = (Q[infinite.any(axis=(1, 2))] != 0).sum(axis=1).max() > 1
        if crossed:
            raise LoopError("integral action across loops has no value at s = 0: use a small s instead")
        Q = np.where(infinite, 1e150, Q)
    try:
        value: ComplexArray = np.linalg.solve(Q.transpose(0, 2, 1), X.transpose(0, 2, 1)).transpose(0, 2, 1)
    except np.linalg.LinAlgError as error:
        raise LoopError(
            "the controller has no inverse, as when a loop is open or has gain 0: (17)-(20) do not apply; "
            "use the joint form"
        ) from error
    return value


def _excitation(R: ComplexArray) -> tuple[Array, BoolArray]:
    """Condition number at each s and where it is good enough; Refused with the reason if nowhere."""
    n_r, n_experiments = R.shape[1:]
    if n_experiments < n_r:
        raise Refused(
            f"{n_experiments} experiments for {n_r} set-points: at one s each experiment gives one direction only. "
            "Add experiments, or split the record into segments in which different set-points move"
        )
    still = np.flatnonzero(~np.any(R != 0, axis=(0, 2)))
    if still.size:
        raise Refused(
            f"set-point {still[0] + 1} does not move in any experiment: move it in one of them, "
            "or leave its loop out of the matrix"
        )
    condition = _condition(R)
    usable = condition < levels.WORST_CONDITION
    if not usable.any():
        raise Refused(
            "the set-points move in proportion in all experiments, so that R(s) has no inverse and their effects "
            "cannot be told apart (Appendix A of the paper): add an experiment in which one set-point moves by itself"
        )
    return condition, usable


def _condition(matrix: ComplexArray) -> Array:
    finite = np.all(np.isfinite(matrix), axis=(1, 2))
    scaled = np.where(finite[:, None, None], matrix, 0.0)
    for axis in (2, 1):
        length = np.linalg.norm(scaled, axis=axis, keepdims=True)
        scaled = scaled / np.where(length > 0, length, 1.0)
    singular = np.linalg.svd(scaled, compute_uv=False)
    smallest = singular[:, -1]
    return np.where(smallest > 0, singular[:, 0] / np.where(smallest > 0, smallest, 1.0), np.inf)


def _ratio(A: ComplexArray, B: ComplexArray, usable: BoolArray, weights: Array | None) -> ComplexArray:
    """X in X B = A, of least squares where B is wide; NaN where not usable."""
    n, wide = B.shape[1:]
    safe = np.where(usable[:, None, None], B, np.eye(n, wide))
    if n == wide:
        value: ComplexArray = np.linalg.solve(safe.transpose(0, 2, 1), A.transpose(0, 2, 1)).transpose(0, 2, 1)
    else:
        root = np.sqrt(np.ones(wide) if weights is None else np.asarray(weights, dtype=float))
        value = (A * root) @ np.linalg.pinv(safe * root)
    value[~usable] = np.nan
    return value


def _kron(a: ComplexArray, b: ComplexArray) -> ComplexArray:
    product = np.einsum("sjl,sik->sjilk", a, b)
    value: ComplexArray = product.reshape(a.shape[0], a.shape[1] * b.shape[1], a.shape[2] * b.shape[2])
    return value


def _adjoint(a: ComplexArray) -> ComplexArray:
    return a.conj().transpose(0, 2, 1)


def _same_shape(a: ComplexArray, b: ComplexArray, name: str, other: str) -> None:
    if a.shape != b.shape:
        raise UsageError(f"{name} has shape {a.shape} and {other} {b.shape}: they must agree")


def _has_shape(a: ComplexArray, shape: tuple[int, ...], name: str) -> None:
    if a.shape != shape:
        raise UsageError(f"{name} must have shape {shape}, not {a.shape}: points s first, then rows, then columns")
