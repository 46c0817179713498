"""Robust performance by D-K iteration: H-infinity design and scaling in turn, for errors at the inputs.

With D of the best upper bound of mu at each frequency, fitted by stable functions with stable inverses, the controller
of least peak of D N D^-1 is an H-infinity design; then D is found afresh for that controller. Each step lowers the same
bound but for what the fit leaves. The two together need not end at the least of all (Doyle 1985; Skogestad and
Postlethwaite 2005, section 8.12). The plant has Pade approximations in place of dead times; what comes out is judged on
the exact one. A weight's pole slower than a tenth of the lowest frequency, an integrator above all, is taken there for
the design, and the controller integrates in its place afterwards. Needs slycot, as all H-infinity design here.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from trueplant.arrays import Array, ComplexArray
from trueplant.errors import LoopError, UsageError
from trueplant.loop import Controller, Linear
from trueplant.lti import TransferFunction, TransferMatrix, simplified, tf
from trueplant.lti.bridge import from_control
from trueplant.lti.sampled import realise
from trueplant.robust import Full, MuResult, Robustness, diagonal, mu, robust_performance
from trueplant.tune import levels
from trueplant.tune.state_space import StateSpace, realised

Weight = TransferFunction | str


@dataclass(frozen=True, eq=False)
class Round:
    """One design and its analysis."""

    gamma: float
    """Peak of D N D^-1 with the fitted D of the round before, as slycot reports it."""
    mu: float
    """Peak of the upper bound of mu over the frequencies given, with the design of this round."""
    states: int
    """Of the controller."""


@dataclass(frozen=True, eq=False)
class MuDesigned:
    """A controller u = Q (r - y) by D-K iteration, and how the iteration went."""

    controller: Controller
    """As transfer functions, of the fewest states that keep mu (levels.REDUCED_MU)."""
    robustness: Robustness
    """Of that controller on the exact plant, over all frequencies."""
    rounds: tuple[Round, ...]

    def __repr__(self) -> str:
        peaks = ", ".join(f"{each.mu:.4g}" for each in self.rounds)
        return f"mu {peaks}; reduced and on the exact plant {self.robustness.RP}"


@dataclass(frozen=True, eq=False)
class Corners:
    """gain (s/z + 1).../(s/p + 1)... with zeros and poles -z and -p on the left, real and as many of both."""

    gain: float
    zeros: Array
    poles: Array

    def response(self, s: ComplexArray) -> ComplexArray:
        ratio = (s[:, None] / self.zeros + 1) / (s[:, None] / self.poles + 1)
        return np.asarray(self.gain * np.prod(ratio, axis=1), dtype=np.complex128)

    def parts(self, inverse: bool = False) -> list[StateSpace]:
        """One state each, to be taken in series."""
        pairs = zip(self.poles, self.zeros, strict=True) if inverse else zip(self.zeros, self.poles, strict=True)
        gain = (1 / self.gain if inverse else self.gain) ** (1 / max(self.zeros.size, 1))
        # gain (s/z + 1)/(s/p + 1) = gain p/z (1 + (z - p)/(s + p))
        return [
            StateSpace(*(np.array([[x]]) for x in (-p, 1.0, gain * p / z * (z - p), gain * p / z))) for z, p in pairs
        ]


def fit_size(w: Array, size: Array, weight: Array, order: int) -> Corners:
    """Corners whose response has the given size (n_s,) at w (n_s,), by weighted least squares of its logarithm."""
    from scipy.optimize import least_squares

    low, high = np.log(w[0]) - 1.0, np.log(w[-1]) + 1.0
    target, square = np.log(size), w[:, None] ** 2

    def predicted(x: Array) -> Array:
        z, p = np.exp(2 * x[1 : order + 1]), np.exp(2 * x[order + 1 :])
        return np.asarray(x[0] + (np.log1p(square / z) - np.log1p(square / p)).sum(axis=1) / 2)

    lower, upper = np.array([-np.inf] + [low] * 2 * order), np.array([np.inf] + [high] * 2 * order)
    best: Any = None
    for shift in levels.FIT_SHIFTS:
        places = low + (high - low) * (np.arange(1, order + 1) / (order + 1))
        start = np.concatenate(
            [[target.mean()], np.clip(places + shift, low, high), np.clip(places - shift, low, high)]
        )
        found = least_squares(lambda x: weight * (predicted(x) - target), start, bounds=(lower, upper))
        if best is None or found.cost < best.cost:
            best = found
    x = best.x
    return Corners(float(np.exp(x[0])), np.exp(x[1 : order + 1]), np.exp(x[order + 1 :]))


def dk_iteration(
    plant: TransferMatrix,
    uncertainty: Weight,
    performance: Weight,
    frequencies: ArrayLike,
    rounds: int = levels.DK_ROUNDS,
    order: int = levels.D_ORDER,
    pade_order: int = levels.PADE_ORDER,
) -> MuDesigned:
    """The controller of least mu of robust performance that D-K iteration finds.

    uncertainty: weight of an independent complex error at each input, not strictly proper; performance: weight of the
    error of each output. frequencies (n_s,): where D is found and fitted, rising, rad per time unit; order: of each
    fitted D. Raises UsageError where slycot is not
    installed or an argument does not fit, LoopError where no design is found.
    """
    try:
        import slycot  # noqa: F401
    except ImportError as error:
        raise UsageError(
            "D-K iteration needs slycot, which is not installed: pip install trueplant[hinf] (its licence is the GPL)"
        ) from error
    w = np.asarray(frequencies, dtype=float)
    if w.ndim != 1 or w.size < 2 * order + 1 or not np.all(np.isfinite(w)) or w[0] <= 0 or np.any(np.diff(w) <= 0):
        raise UsageError(f"D-K iteration needs at least {2 * order + 1} rising frequencies above 0")
    if rounds < 1 or order < 1:
        raise UsageError(f"D-K iteration needs at least one round and one corner of D, not {rounds} and {order}")
    n_y, n_u = plant.shape
    corner = levels.SLOWEST_WEIGHT * w[0]
    erring, asked = _moved(uncertainty, "uncertainty", corner), _moved(performance, "performance", corner)
    P = _generalised(realised(plant, pade_order), _realised(erring), _realised(asked))
    blocks = (*diagonal(n_u), Full(n_y))
    open_loop = _response(P, 1j * w)

    def analysed(law: StateSpace) -> MuResult:
        return mu(_closed(open_loop, _response(law, 1j * w), n_y, n_u), blocks)

    scalings = [Corners(1.0, np.ones(1), np.ones(1))] * n_u
    done: list[Round] = []
    best: tuple[float, StateSpace] | None = None
    for _ in range(rounds):
        laws, gamma = _synthesised(_scaled(P, scalings, n_y), n_y, n_u)
        found, law = min(((analysed(each), each) for each in laws), key=lambda pair: float(pair[0].upper.max()))
        peak = float(found.upper.max())
        done.append(Round(gamma, peak, len(law.A)))
        if best is None or peak < best[0]:
            best = peak, law
        scalings = _fitted(w, found, n_u, order)
    assert best is not None
    law = _shortened(best[1], lambda each: float(analysed(each).upper.max()) <= levels.REDUCED_MU * best[0])
    controller = _controller(law, 0.0 if asked == tf(performance) else corner)
    return MuDesigned(controller, robust_performance(plant, controller, uncertainty, performance), tuple(done))


def _fitted(w: Array, found: MuResult, n_u: int, order: int) -> list[Corners]:
    sizes = np.abs(np.diagonal(found.scaling[0], axis1=1, axis2=2))
    weight = found.upper / found.upper.max()
    return [fit_size(w, sizes[:, k] / sizes[:, -1], weight, order) for k in range(n_u)]


def _moved(weight: Weight, name: str, corner: float) -> TransferFunction:
    """Poles slower than the corner at the corner."""
    function = tf(weight)
    if len(function.terms) != 1 or function.terms[0].dead_time:
        raise UsageError(f"the {name} weight must be one fraction without dead time")
    poles = np.roots(function.terms[0].den)
    if np.any(poles.real > 0):
        raise UsageError(f"the {name} weight has an unstable pole: only its size matters, mirror the pole")
    if np.all(np.abs(poles) >= corner):
        return function
    den = function.terms[0].den[0] * np.poly(np.where(np.abs(poles) < corner, -corner, poles)).real
    return TransferFunction.rational(function.terms[0].num, den)


def _realised(function: TransferFunction) -> StateSpace:
    num, den = (np.asarray(p, dtype=float) for p in (function.terms[0].num, function.terms[0].den))
    padded = np.concatenate([np.zeros(den.size - num.size), num])[None, :] / den[0]
    a, b, c, d = realise(padded, den / den[0])
    return StateSpace(a, b.reshape(-1, 1), c.reshape(1, -1), np.atleast_2d(d))


def _generalised(G: StateSpace, uncertainty: StateSpace, performance: StateSpace) -> StateSpace:
    """From (error at u, d, u) to (wI u, wP y, -y), y = G (u + error) + d."""
    n_y, n_u = G.D.shape
    WI, WP = _diagonal([uncertainty] * n_u), _diagonal([performance] * n_y)
    n, i, p = (m.A.shape[0] for m in (G, WI, WP))
    o = np.zeros
    A = np.block([[G.A, o((n, i + p))], [o((i, n)), WI.A, o((i, p))], [WP.B @ G.C, o((p, i)), WP.A]])
    into = np.hstack([G.D, np.eye(n_y), G.D])
    B = np.vstack([np.hstack([G.B, o((n, n_y)), G.B]), np.hstack([o((i, n_u + n_y)), WI.B]), WP.B @ into])
    C = np.block([[o((n_u, n)), WI.C, o((n_u, p))], [WP.D @ G.C, o((n_y, i)), WP.C], [-G.C, o((n_y, i + p))]])
    D = np.vstack([np.hstack([o((n_u, n_u + n_y)), WI.D]), WP.D @ into, -into])
    return StateSpace(A, B, C, D)


def _scaled(P: StateSpace, scalings: list[Corners], n_y: int) -> StateSpace:
    """diag(D, 1) P diag(1/D, 1)."""
    n_u = len(scalings)
    total = P
    for part in range(scalings[0].zeros.size):
        before = _diagonal([d.parts(inverse=True)[part] for d in scalings], n_y + n_u)
        after = _diagonal([d.parts()[part] for d in scalings], 2 * n_y)
        total = _series(_series(before, total), after)
    return total


def _diagonal(systems: list[StateSpace], untouched: int = 0) -> StateSpace:
    from scipy.linalg import block_diag

    through = np.eye(untouched)
    A, B, C, D = (block_diag(*(getattr(each, name) for each in systems)) for name in "ABCD")
    if not untouched:
        return StateSpace(A, B, C, D)
    B, C = np.hstack([B, np.zeros((len(B), untouched))]), np.vstack([C, np.zeros((untouched, C.shape[1]))])
    return StateSpace(A, B, C, block_diag(D, through))


def _series(first: StateSpace, second: StateSpace) -> StateSpace:
    A = np.block([[first.A, np.zeros((len(first.A), len(second.A)))], [second.B @ first.C, second.A]])
    B = np.vstack([first.B, second.B @ first.D])
    return StateSpace(A, B, np.hstack([second.D @ first.C, second.C]), second.D @ first.D)


def _synthesised(P: StateSpace, n_y: int, n_u: int) -> tuple[list[StateSpace], float]:
    """Controllers that stabilise P, for the least peak and for somewhat larger ones, and the least peak.

    Right at the least peak the equations are singular and the controller may be spoilt by rounding.
    """
    import slycot

    P = _balanced(P, levels.NEGLIGIBLE_STATE)
    n, m, n_z = len(P.A), P.B.shape[1], P.C.shape[0]
    found: list[StateSpace] = []
    gamma = np.nan
    try:
        gamma, *law = slycot.sb10ad(n, m, n_z, n_u, n_y, levels.LARGE_PEAK, P.A, P.B, P.C, P.D)[:5]
        found.append(StateSpace(*law))
        for share in levels.ABOVE_LEAST_PEAK:
            law = slycot.sb10fd(n, m, n_z, n_u, n_y, share * gamma, P.A, P.B, P.C, P.D)[:4]
            found.append(StateSpace(*law))
    except (slycot.exceptions.SlycotError, ArithmeticError, ValueError) as error:
        if not found:
            raise LoopError(f"slycot found no H-infinity controller in the D-K iteration ({error})") from error
    inner = StateSpace(P.A, P.B[:, -n_u:], P.C[-n_y:], P.D[-n_y:, -n_u:])
    stable = [law for law in found if np.all(np.linalg.eigvals(_loop(inner, law)).real < 0)]
    if not stable:
        raise LoopError("slycot's H-infinity controllers do not stabilise the plant they were designed for")
    return stable, float(gamma)


def _loop(G: StateSpace, K: StateSpace) -> Array:
    """A of u = K y around y = G u."""
    back = np.linalg.inv(np.eye(len(G.D)) - G.D @ K.D)
    return np.block(
        [
            [G.A + G.B @ K.D @ back @ G.C, G.B @ (np.eye(len(K.D)) + K.D @ back @ G.D) @ K.C],
            [K.B @ back @ G.C, K.A + K.B @ back @ G.D @ K.C],
        ]
    )


def _response(system: StateSpace, s: ComplexArray) -> ComplexArray:
    inner = s[:, None, None] * np.eye(len(system.A)) - system.A
    return np.asarray(system.C @ np.linalg.solve(inner, np.tile(system.B + 0j, (len(s), 1, 1))) + system.D)


def _closed(P: ComplexArray, K: ComplexArray, n_y: int, n_u: int) -> ComplexArray:
    """N of P closed by u = K v."""
    back = np.linalg.solve(np.eye(n_y) - P[:, -n_y:, -n_u:] @ K, P[:, -n_y:, :-n_u])
    return np.asarray(P[:, :-n_y, :-n_u] + P[:, :-n_y, -n_u:] @ K @ back)


def _balanced(system: StateSpace, least: float = 0.0) -> StateSpace:
    """Balanced, strongest states first, without those of Hankel values below `least` times the largest.

    What is unstable is left as it is. (Square roots of both Gramians: Laub and others, IEEE Trans. Autom. Control 32,
    1987, 115-122.)
    """
    from scipy.linalg import solve_continuous_lyapunov

    if np.any(np.linalg.eigvals(system.A).real >= 0):
        return system
    roots = []
    for A, B in ((system.A, system.B), (system.A.T, system.C.T)):
        gramian = solve_continuous_lyapunov(A, -B @ B.T)
        u, s, _ = np.linalg.svd((gramian + gramian.T) / 2)
        roots.append(u * np.sqrt(s))
    u, hankel, vh = np.linalg.svd(roots[1].T @ roots[0])
    kept = int(np.sum(hankel > max(least, np.finfo(float).eps) * hankel[0]))
    to = roots[0] @ vh[:kept].T / np.sqrt(hankel[:kept])
    back = (u[:, :kept] / np.sqrt(hankel[:kept])).T @ roots[1].T
    return StateSpace(back @ system.A @ to, back @ system.B, system.C @ to, system.D)


def _shortened(law: StateSpace, good: Callable[[StateSpace], bool]) -> StateSpace:
    """The fewest states of the balanced law that are good enough."""
    whole = _balanced(law)
    for kept in range(1, len(whole.A)):
        part = StateSpace(whole.A[:kept, :kept], whole.B[:kept], whole.C[:, :kept], whole.D)
        if good(part):
            return part
    return law


def _controller(law: StateSpace, corner: float) -> Controller:
    """As transfer functions, times (s + corner)/s: the slow pole of the design becomes the integrator."""
    import control

    found = from_control(control.ss(law.A, law.B, law.C, law.D))
    assert isinstance(found, TransferMatrix)
    integral = TransferFunction.rational([1.0, corner], [1.0, 0.0]) if corner else TransferFunction.rational([1.0])
    n_u, n_y = law.D.shape
    places = [(i, j) for i in range(n_u) for j in range(n_y) if not found[i, j].is_zero]
    return Controller({(i, j): Linear(simplified(found[i, j] * integral)) for i, j in places}, n_u, n_y)
