"""Weights: how wrong the model may be over frequency, and what is asked of the loop."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from trueplant.arrays import Array, ComplexArray
from trueplant.errors import UsageError
from trueplant.lti import TransferFunction
from trueplant.robust import levels

KINDS = ("input", "output", "additive")


def _positive(**values: float) -> None:
    for name, value in values.items():
        if not (np.isfinite(value) and value > 0):
            raise UsageError(f"{name} must be a number above 0, not {value:g}")


def _not_negative(**values: float) -> None:
    for name, value in values.items():
        if not (np.isfinite(value) and value >= 0):
            raise UsageError(f"{name} must be a number of 0 or more, not {value:g}")


def uncertainty_weight(r0: float, tau: float, r_inf: float) -> TransferFunction:
    """wI = (tau s + r0)/((tau/r_inf) s + 1), (27): relative error r0 at rest, 1 near 1/tau, r_inf at high frequency."""
    _not_negative(r0=r0)
    _positive(tau=tau, r_inf=r_inf)
    return TransferFunction.rational([tau, r0], [tau / r_inf, 1.0])


def performance_weight(bandwidth: float, M: float, A: float = 0.0) -> TransferFunction:
    """wP = (s/M + wB)/(s + wB A), (28): |S| below A at rest (0 asks for integral action), below M at high frequency.

    bandwidth wB in rad per time unit.
    """
    _positive(bandwidth=bandwidth, M=M)
    _not_negative(A=A)
    return TransferFunction.rational([1 / M, bandwidth], [1.0, bandwidth * A])


def gain_and_dead_time_weight(gain: float, dead_time: float, covers: bool = False) -> TransferFunction:
    """First-order weight for a relative gain error and a dead-time error (time units), both up to the given size.

    ((1 + gain/2) dead_time s + gain)/(dead_time/2 s + 1), of the form (27) with r_inf = 2 + gain; for 0.1 and 0.2 min
    it is (31). It falls short of the exact error by up to 18 %, near 2.6/dead_time; covers=True adds the factor of
    second order that lifts it there (Skogestad and Postlethwaite 2005, section 7.4.3).
    """
    _not_negative(gain=gain, dead_time=dead_time)
    simple = TransferFunction.rational([(1 + gain / 2) * dead_time, gain], [dead_time / 2, 1.0])
    if not covers:
        return simple
    tau = dead_time / 2.363
    return simple * TransferFunction.rational([tau**2, 2 * 0.838 * tau, 1.0], [tau**2, 2 * 0.685 * tau, 1.0])


def covariance_weight(
    response: Callable[[Array], ComplexArray],
    parameters: ArrayLike,
    covariance: ArrayLike,
    kind: str = "input",
    confidence: float = levels.CONFIDENCE,
) -> Array:
    """Size of the model error (n_s,) that the parameters' covariance leaves, for all frequencies jointly.

    `response` gives G (n_s, n_y, n_u) for parameters (n_p,). The error is the largest Frobenius norm, which is never
    below sigma_max and equal to it for a single element, over the ellipsoid that holds the parameters with the given
    confidence, to first order in their errors: of dG for kind "additive", of G^-1 dG for "input" and dG G^-1 for
    "output" (square plants). Raises UsageError.
    """
    from scipy.stats import chi2

    if kind not in KINDS:
        raise UsageError(f"the kind of uncertainty must be one of {', '.join(KINDS)}, not {kind!r}")
    if not 0 < confidence < 1:
        raise UsageError(f"confidence must lie between 0 and 1, not {confidence:g}")
    theta, spread = (
        np.atleast_1d(np.asarray(parameters, dtype=float)),
        np.atleast_2d(np.asarray(covariance, dtype=float)),
    )
    if spread.shape != (theta.size, theta.size):
        raise UsageError(
            f"{theta.size} parameters need a covariance of {theta.size} by {theta.size}, not {spread.shape}"
        )
    values, vectors = np.linalg.eigh((spread + spread.T) / 2)
    if not np.all(np.isfinite(values)) or values[0] < -1e-9 * abs(values[-1]):
        raise UsageError("the covariance of the parameters is not positive semi-definite")
    axes = vectors * np.sqrt(np.maximum(values, 0.0))
    nominal = response(theta)
    # along the axes of the ellipsoid, by central differences of a hundredth of a standard deviation
    step = levels.STANDARD_DEVIATIONS
    changes = np.stack([(response(theta + step * a) - response(theta - step * a)) / (2 * step) for a in axes.T])
    along = _relative(changes, nominal, kind)
    flat = along.reshape(*along.shape[:2], -1).swapaxes(0, 1)
    gram = (flat @ flat.conj().swapaxes(1, 2)).real
    return np.asarray(np.sqrt(chi2.ppf(confidence, theta.size) * np.linalg.eigvalsh(gram)[:, -1]))


def set_weight(nominal: ArrayLike, members: ArrayLike, kind: str = "output") -> Array:
    """Size of the model error (n_s,) that a set of known plants asks for: the largest sigma_max over its members.

    nominal: G (n_s, n_y, n_u), members: (n_m, n_s, n_y, n_u), such as plants identified in several runs or drawn from
    an estimate. The error is G_k - G for kind "additive", G^-1 (G_k - G) for "input" and (G_k - G) G^-1 for "output"
    (square plants): with `covering_weight` a weight under which every one of these plants lies in the set
    (Skogestad and Postlethwaite 2005, section 7.4.2). Raises UsageError.
    """
    G, plants = np.asarray(nominal, dtype=np.complex128), np.asarray(members, dtype=np.complex128)
    if kind not in KINDS:
        raise UsageError(f"the kind of uncertainty must be one of {', '.join(KINDS)}, not {kind!r}")
    if G.ndim != 3 or plants.ndim != 4 or plants.shape[1:] != G.shape or plants.shape[0] == 0:
        raise UsageError(f"a set of plants needs the shape (n_m, {', '.join(map(str, G.shape))}), not {plants.shape}")
    return np.asarray(np.max(np.linalg.norm(_relative(plants - G, G, kind), ord=2, axis=(2, 3)), axis=0))


def _relative(changes: ComplexArray, nominal: ComplexArray, kind: str) -> ComplexArray:
    """Changes of G (n, n_s, n_y, n_u) as the uncertainty of that kind has them."""
    if kind == "additive":
        return changes
    if nominal.shape[1] != nominal.shape[2]:
        raise UsageError(f'errors at the {kind} need as many inputs as outputs: take kind "additive"')
    inverse = np.linalg.inv(nominal)
    return np.asarray(inverse @ changes if kind == "input" else changes @ inverse, dtype=np.complex128)


def covering_weight(w: ArrayLike, magnitude: ArrayLike) -> TransferFunction:
    """The first-order weight of the form (27) that covers the magnitudes at the frequencies w most closely.

    Closest in the mean logarithm over the given points; never below any of them. Raises UsageError.
    """
    from scipy.optimize import minimize

    frequency, size = np.asarray(w, dtype=float), np.asarray(magnitude, dtype=float)
    if frequency.shape != size.shape or frequency.ndim != 1 or frequency.size < 2:
        raise UsageError("a covering weight needs as many magnitudes as frequencies, at least 2")
    if not (np.all(frequency > 0) and np.all(size > 0) and np.all(np.isfinite(size))):
        raise UsageError("a covering weight needs frequencies and magnitudes above 0")
    log_w, log_size = np.log(frequency), np.log(size)

    def shape(corners: Array) -> Array:
        """log |(s/z + 1)/(s/p + 1)|"""
        return np.asarray(np.logaddexp(0, 2 * (log_w - corners[0])) - np.logaddexp(0, 2 * (log_w - corners[1]))) / 2

    def excess(corners: Array) -> float:
        left = log_size - shape(corners)
        return float(np.max(left) - np.mean(left))

    ends = np.quantile(log_w, levels.CORNER_QUANTILES)
    starts = [(a, b) for a in ends for b in ends]
    best = min(
        (minimize(excess, start, method="Nelder-Mead") for start in starts), key=lambda found: float(found.fun)
    ).x
    lift = float(np.exp(np.max(log_size - shape(best)))) * (1 + 1e-12)
    zero, pole = np.exp(best)
    return TransferFunction.rational([lift / zero, lift], [1 / pole, 1.0])
