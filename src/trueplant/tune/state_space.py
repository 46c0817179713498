"""LQG, H2 and H-infinity controllers as transfer functions: designed on a Pade plant, judged on the exact one.

All three work on the plant with an integrator and a zero, (s + w)/s, put before each input; they go to the controller
afterwards, so that it always integrates. Outputs are scaled by the plant's own gain at the bandwidth w, which makes all
weights 1 there. In these terms

    LQG         least E[y'y + u'u] under white noise of unit intensity at the plant's input and on its output
    H2          the same with w/(s + 0.1 w) on y: slow errors cost more
    H-infinity  least peak of [W1 S; u] from a disturbance at the output, W1 = (s/1.5 + w)/(s + 0.1 w), and a tenth of
                one at the input

(Skogestad and Postlethwaite 2005, chapter 9; Doyle, Glover, Khargonekar and Francis, IEEE Trans. Autom. Control 34,
1989, 831-847.) The bandwidth is the one thing left to choose.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from trueplant.arrays import Array
from trueplant.errors import LoopError
from trueplant.loop import Controller, Linear, unstable_poles
from trueplant.lti import TransferFunction, TransferMatrix, simplified, to_control
from trueplant.lti.bridge import from_control
from trueplant.lti.sampled import realise
from trueplant.robust import margins
from trueplant.tune import levels

Bandwidth = float | Sequence[float]


class MissingSolver(LoopError):
    """A design needs a library that is not installed: another bandwidth would not help."""


@dataclass(frozen=True, eq=False)
class StateSpace:
    """x' = A x + B u, y = C x + D u."""

    A: Array
    B: Array
    C: Array
    D: Array


@dataclass(frozen=True, eq=False)
class Designed:
    """A controller of transfer functions, u = Q (r - y)."""

    controller: Controller
    bandwidth: float
    """That it was designed for (the first, of several), rad per time unit."""
    cost: float
    """What the method makes least, in its scaled terms: the square of a norm (LQG, H2), the peak (H-infinity)."""
    pade_order: int


def realised(plant: TransferMatrix, pade_order: int) -> StateSpace:
    """A state-space form of the plant, dead times by Pade approximations of the order given."""
    rational = to_control(plant, pade_order)
    n_y, n_u = plant.shape
    blocks = []
    d = np.zeros((n_y, n_u))
    for i in range(n_y):
        for j in range(n_u):
            num, den = (np.atleast_1d(np.asarray(p[i][j], dtype=float)) for p in (rational.num, rational.den))
            padded = np.concatenate([np.zeros(den.size - num.size), num])[None, :] / den[0]
            a, b, c, direct = realise(padded, den / den[0])
            d[i, j] = direct[0]
            blocks.append((i, j, a, b, c[0]))
    size = sum(a.shape[0] for _, _, a, _, _ in blocks)
    A, B, C = np.zeros((size, size)), np.zeros((size, n_u)), np.zeros((n_y, size))
    at = 0
    for i, j, a, b, c in blocks:
        part = slice(at, at + a.shape[0])
        A[part, part], B[part, j], C[i, part] = a, b, c
        at = part.stop
    return StateSpace(A, B, C, d)


def lqg(plant: TransferMatrix, bandwidth: Bandwidth, pade_order: int = levels.PADE_ORDER) -> Designed:
    """Linear quadratic Gaussian control with integral action. See the head of this module for its weights.

    bandwidth: one for all loops, or one for each, pairs on the diagonal. The plant must be square, with gain at rest.
    Raises LoopError where the Riccati equations have no solution, or for wrong arguments.
    """
    return _designed(plant, bandwidth, pade_order, _lqg)


def h2(plant: TransferMatrix, bandwidth: Bandwidth, pade_order: int = levels.PADE_ORDER) -> Designed:
    """H2-optimal control, slow errors weighted; arguments as in `lqg`."""
    return _designed(plant, bandwidth, pade_order, _h2)


def h_infinity(plant: TransferMatrix, bandwidth: Bandwidth, pade_order: int = levels.PADE_ORDER) -> Designed:
    """H-infinity control by python-control, which needs slycot for it; arguments as in `lqg`.

    Raises LoopError where slycot is not installed.
    """
    return _designed(plant, bandwidth, pade_order, _h_infinity)


DESIGNS: dict[str, Callable[[TransferMatrix, Bandwidth, int], Designed]] = {
    "lqg": lqg,
    "h2": h2,
    "h-infinity": h_infinity,
}
"""By name."""


def fastest(
    plant: TransferMatrix,
    method: str,
    crossovers: Sequence[float],
    limit: float = levels.PEAK,
    scans: Sequence[float | None] | None = None,
    pade_order: int = levels.PADE_ORDER,
) -> Designed:
    """The design of the largest bandwidth that keeps Ms and the crossovers on the exact plant.

    crossovers: of each loop, pairs on the diagonal, rad per time unit; scans: of the controller that writes each input,
    None for a continuous one. Raises LoopError if there is no such design.
    """
    why = "no bandwidth was found that keeps the limits"
    for factor in levels.BANDWIDTHS:
        try:
            found = DESIGNS[method](plant, [float(factor) * w for w in crossovers], pade_order)
            if scans is not None:
                found = replace(found, controller=_scanned(found.controller, scans))
            if unstable_poles(plant, found.controller):
                continue
            reached = [margins(plant, found.controller, i) for i in range(plant.shape[1])]
        except MissingSolver:
            raise
        except LoopError as error:
            why = str(error)
            continue
        slow = all(not m.phase_margin_frequency > w * (1 + 1e-6) for m, w in zip(reached, crossovers, strict=True))
        if slow and all(m.Ms <= limit for m in reached):
            return found
    raise LoopError(f"{method} with a Pade plant of order {pade_order}: {why}")


def _scanned(controller: Controller, scans: Sequence[float | None]) -> Controller:
    entries = {place: replace(entry, sample_time=scans[place[0]]) for place, entry in controller.entries.items()}
    return replace(controller, entries=entries)


def _designed(
    plant: TransferMatrix, bandwidth: Bandwidth, pade_order: int, synthesis: Callable[[StateSpace, Array], Any]
) -> Designed:
    n_y, n_u = plant.shape
    if n_y != n_u:
        raise LoopError(f"these designs need as many inputs as outputs, not {n_u} and {n_y}")
    w = np.broadcast_to(np.asarray(bandwidth, dtype=float), (n_y,))
    if not np.all(np.isfinite(w) & (w > 0)):
        raise LoopError("the bandwidth must be above 0")
    gains = plant.dc_gain
    if not np.all(np.isfinite(gains)) or np.linalg.cond(gains) > levels.SINGULAR_GAINS:
        raise LoopError("these designs need a plant with finite, regular gains at rest")
    # time in units of the slowest bandwidth, outputs in units of the gain at it
    unit = float(1 / w.min())
    scale = np.abs(np.array([plant[i, i](np.array([1j * w[i]]))[0] for i in range(n_y)]))
    if np.any(scale == 0):
        raise LoopError("an element on the diagonal has no gain at the bandwidth: pair differently")
    own = realised(plant, pade_order)
    outputs = 1 / scale[:, None]
    scaled = StateSpace(own.A * unit, own.B * unit, own.C * outputs, own.D * outputs)
    law, cost = synthesis(_with_integrators(scaled, w * unit), w * unit)
    entries = {}
    found = from_control(_python_control(_reduced(law)))
    for i in range(n_u):
        integral = TransferFunction.rational([1.0, w[i] * unit], [1.0, 0.0])
        for j in range(n_y):
            element = found[i, j]
            if not element.is_zero:
                # the synthesis answers y, the law r - y
                q = _stretched(simplified(element * integral), unit) * (-1.0 / scale[j])
                entries[i, j] = Linear(q)
    return Designed(Controller(entries, n_u, n_y), float(w[0]), cost, pade_order)


def _with_integrators(plant: StateSpace, w: Array) -> StateSpace:
    """The plant behind (s + w)/s at each input."""
    n, m = plant.B.shape
    A = np.block([[plant.A, plant.B * w], [np.zeros((m, n + m))]])
    B = np.vstack([plant.B, np.eye(m)])
    return StateSpace(A, B, np.hstack([plant.C, plant.D * w]), plant.D)


def _stretched(g: TransferFunction, unit: float) -> TransferFunction:
    """g(s unit)."""
    total = TransferFunction()
    for term in g.terms:
        num, den = (np.array(p) * unit ** np.arange(len(p) - 1, -1, -1) for p in (term.num, term.den))
        total = total + TransferFunction.rational(num, den)
    return total


def _riccati(A: Array, B: Array, Q: Array, R: Array, S: Array) -> Array:
    from scipy.linalg import solve_continuous_are

    try:
        return np.asarray(solve_continuous_are(A, B, Q, R, s=S), dtype=np.float64)
    except (np.linalg.LinAlgError, ValueError) as error:
        raise LoopError(f"the Riccati equation of this plant has no solution ({error})") from error


def _optimal(A: Array, B1: Array, B2: Array, C1: Array, C2: Array, D12: Array, D21: Array, D22: Array) -> Any:
    """The controller from y to u of least H2 norm from w to z, and the square of that norm (Doyle et al. 1989)."""
    R, V = D12.T @ D12, D21 @ D21.T
    X = _riccati(A, B2, C1.T @ C1, R, C1.T @ D12)
    Y = _riccati(A.T, C2.T, B1 @ B1.T, V, B1 @ D21.T)
    F = np.asarray(-np.linalg.solve(R, B2.T @ X + D12.T @ C1), dtype=np.float64)
    L = np.asarray(-np.linalg.solve(V.T, (Y @ C2.T + B1 @ D21.T).T).T, dtype=np.float64)
    law = StateSpace(A + B2 @ F + L @ C2 + L @ D22 @ F, -L, F, np.zeros((F.shape[0], L.shape[1])))
    cost = float(np.trace(B1.T @ X @ B1) + np.trace(R @ F @ Y @ F.T))
    return law, cost


def _lqg(plant: StateSpace, w: Array) -> Any:
    n, m = plant.A.shape[0], w.size
    nothing, one = np.zeros((m, m)), np.eye(m)
    B1 = np.hstack([plant.B, np.zeros((n, m))])
    C1 = np.vstack([plant.C, np.zeros((m, n))])
    D12, D21 = np.vstack([nothing, one]), np.hstack([nothing, one])
    return _optimal(plant.A, B1, plant.B, C1, plant.C, D12, D21, plant.D)


def _weighted(plant: StateSpace, corner: Array, gain: Array) -> StateSpace:
    """The plant with the states of gain/(s + corner) on each output behind its own."""
    n, m = plant.B.shape
    A = np.block([[plant.A, np.zeros((n, m))], [plant.C * gain[:, None], -np.diag(corner)]])
    B = np.vstack([plant.B, plant.D * gain[:, None]])
    return StateSpace(A, B, np.hstack([plant.C, np.zeros((m, m))]), plant.D)


def _h2(plant: StateSpace, w: Array) -> Any:
    n, m = plant.A.shape[0], w.size
    whole = _weighted(plant, levels.WEIGHT_CORNER * w, w)
    nothing, one = np.zeros((m, m)), np.eye(m)
    B1 = np.hstack([whole.B, np.zeros((n + m, m))])
    C1 = np.vstack([np.hstack([np.zeros((m, n)), one]), np.zeros((m, n + m))])
    D12, D21 = np.vstack([nothing, one]), np.hstack([nothing, one])
    return _optimal(whole.A, B1, whole.B, C1, whole.C, D12, D21, whole.D)


def _h_infinity(plant: StateSpace, w: Array) -> Any:
    try:
        import slycot  # noqa: F401
    except ImportError as error:
        raise MissingSolver(
            "H-infinity design needs slycot, which is not installed: pip install trueplant[hinf] (its licence is the "
            "GPL), or use lqg or h2"
        ) from error
    import control

    n, m = plant.A.shape[0], w.size
    # (s/M + w)/(s + floor w) = 1/M + (w - floor w/M)/(s + floor w), from a disturbance at the output as well
    gain = w * (1 - levels.WEIGHT_CORNER / levels.WEIGHT_PEAK)
    whole = _weighted(plant, levels.WEIGHT_CORNER * w, gain)
    nothing, one = np.zeros((m, m)), np.eye(m)
    at_weight = np.vstack([np.zeros((n, m)), np.diag(gain)])
    load, most = levels.LOAD_WEIGHT, levels.WEIGHT_PEAK
    B = np.hstack([load * whole.B, at_weight, whole.B])
    C = np.vstack([np.hstack([plant.C / most, one]), np.zeros((m, n + m)), whole.C])
    D = np.block([[load * plant.D / most, one / most, plant.D / most], [nothing, nothing, one],
                  [load * plant.D, one, plant.D]])  # fmt: skip
    try:
        law, _, gamma, _ = control.hinfsyn(control.ss(whole.A, B, C, D), m, m)
    except (control.ControlArgument, control.ControlSlycot, ArithmeticError, ValueError) as error:
        raise LoopError(f"slycot found no H-infinity controller for this plant ({error})") from error
    return StateSpace(*(np.asarray(p, dtype=float) for p in (law.A, law.B, law.C, law.D))), float(gamma)


def _reduced(law: StateSpace) -> StateSpace:
    """Balanced truncation of a stable controller; an unstable one is left as it is."""
    if np.any(np.linalg.eigvals(law.A).real >= 0):
        return law
    from scipy.linalg import solve_continuous_lyapunov

    reach = solve_continuous_lyapunov(law.A, -law.B @ law.B.T)
    seen = solve_continuous_lyapunov(law.A.T, -law.C.T @ law.C)
    u, s, _ = np.linalg.svd((reach + reach.T) / 2)
    root = u * np.sqrt(s)
    v, hankel, _ = np.linalg.svd(root.T @ seen @ root)
    hankel = np.sqrt(hankel)
    kept = int(min(np.sum(hankel > levels.HANKEL_KEPT * hankel[0]), levels.MOST_STATES))
    to = root @ v[:, :kept] / np.sqrt(hankel[:kept])
    back = (v[:, :kept] * np.sqrt(hankel[:kept])).T @ np.linalg.pinv(root)
    return StateSpace(back @ law.A @ to, back @ law.B, law.C @ to, law.D)


def _python_control(law: StateSpace) -> Any:
    import control

    return control.ss(law.A, law.B, law.C, law.D)
