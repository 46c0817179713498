"""Several loops: Luyben's BLT, and loops tuned one after the other with those before closed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from trueplant.arrays import Array, ComplexArray
from trueplant.errors import LoopError
from trueplant.loop import PID, Controller, unstable_poles
from trueplant.lti import TransferMatrix
from trueplant.tune import levels
from trueplant.tune.integral import Limits, max_ki
from trueplant.tune.response import Plant, axis, frequencies, ultimate
from trueplant.tune.rules import ziegler_nichols


@dataclass(frozen=True)
class BLT:
    """Result of the biggest-log-modulus rule."""

    controller: Controller
    detuning: float
    """F: Ziegler-Nichols gains are divided by it, integral times multiplied."""
    log_modulus: float
    """Largest closed-loop log modulus reached, dB."""


def blt(plant: TransferMatrix) -> BLT:
    """PI controllers on the diagonal by Luyben's rule (Ind. Eng. Chem. Process Des. Dev. 25, 1986, 654-660).

    Ziegler-Nichols settings of each diagonal element are detuned by one common factor F, so that the log modulus
    20 log10 |W/(1 + W)| of W = det(I + G Q) - 1 peaks at 2 dB a loop. Exact with dead time.

    Raises LoopError if the plant is not square, a diagonal element has no ultimate gain, or no factor up to 200 gives
    a stable system of that modulus (as with a pairing of negative Niederlinski index).
    """
    n = _square(plant)
    first = []
    for i in range(n):
        try:
            first.append(ziegler_nichols(*ultimate(plant[i, i])))
        except LoopError as error:
            raise LoopError(f"loop {i + 1}: {error}") from error
    w = _grid(plant)
    response = plant(axis(w))

    def controller(factor: float) -> Controller:
        return Controller.diagonal([PID(Kc=(p.Kc or 0.0) / factor, Ti=(p.Ti or 0.0) * factor) for p in first])

    def modulus(factor: float) -> float:
        difference = np.linalg.det(np.eye(n) + response @ controller(factor)(axis(w)))
        return float(np.max(20 * np.log10(np.abs((difference - 1) / difference))))

    from scipy.optimize import brentq

    goal = 2.0 * n
    factors = np.geomspace(*levels.DETUNING, levels.DETUNING_POINTS)
    # from the slow side: beyond the limit of stability the modulus falls again
    excess = np.array([modulus(float(f)) for f in factors]) - goal
    over = np.flatnonzero(excess > 0)
    if over.size == 0 or over[-1] == factors.size - 1:
        raise LoopError("no common detuning gives this plant the log modulus of the BLT rule: check the pairing")
    factor = float(brentq(lambda f: modulus(f) - goal, factors[over[-1]], factors[over[-1] + 1], xtol=1e-8))
    found = controller(factor)
    if unstable_poles(plant, found):
        raise LoopError("the BLT rule leaves this plant unstable: check the pairing (Niederlinski index) and the signs")
    return BLT(found, factor, modulus(factor))


def sequential(
    plant: TransferMatrix, limits: Limits | float = levels.PEAK, kind: str = "PI", order: Sequence[int] | None = None
) -> Controller:
    """Controllers on the diagonal, tuned one after the other, each with those before it closed.

    Each loop gets the largest integral gain that keeps its own S and T within the limits on the plant as that loop
    finds it (Hovd and Skogestad, Automatica 30, 1994, 1601-1607, on sequential design). Later loops change the
    earlier ones again: check the margins of all. order: indices of the loops, by default the fastest first and those
    last that have a limit only through the others.

    Raises LoopError if the plant is not square, a loop changes the sign of its gain when those before are closed,
    or `max_ki` has no answer.
    """
    n = _square(plant)
    turn = list(order) if order is not None else sorted(range(n), key=lambda i: _period(plant, i))
    if sorted(turn) != list(range(n)):
        raise LoopError(f"order must hold each of the loops 0 to {n - 1} once, not {turn}")
    w = _grid(plant)
    done: dict[int, PID] = {}
    for k in turn:
        seen = _with_closed(plant, done, k)
        own = float(np.sign(plant[k, k].dc_gain))
        try:
            tuned = max_ki(seen, limits, kind, w=w)
        except LoopError as error:
            raise LoopError(f"loop {k + 1}: {error}") from error
        if tuned.sign != own:
            raise LoopError(
                f"loop {k + 1} changes the sign of its gain when the loops before it are closed: pair differently, or "
                "change the order"
            )
        done[k] = tuned
    found = Controller.diagonal([done[k] for k in range(n)])
    if unstable_poles(plant, found):
        raise LoopError("the loops tuned one after the other are unstable together: change the order or the pairing")
    return found


SEVERAL: dict[str, Callable[[TransferMatrix, Limits, str], Controller]] = {
    "blt": lambda plant, limits, kind: blt(plant).controller,
    "sequential": sequential,
}
"""The rules for several loops by name: from a square plant, pairs on its diagonal, limits and "PI" or "PID"."""


def _period(plant: TransferMatrix, i: int) -> float:
    try:
        return ultimate(plant[i, i])[1]
    except LoopError:
        return np.inf


def _with_closed(plant: TransferMatrix, done: dict[int, PID], k: int) -> Plant:
    """Element (k, k) as it is with the loops in `done` closed."""
    others = sorted(done)

    def seen(s: ComplexArray) -> ComplexArray:
        whole = plant(s)
        if not others:
            return np.asarray(whole[:, k, k])
        inner = whole[:, others][:, :, others]
        laws = np.stack([done[i].feedback(s) for i in others], axis=1)
        # (Q^-1 + G)^-1 stays finite where integral action does not
        inverse = np.zeros_like(inner)
        inverse[:, range(len(others)), range(len(others))] = 1 / laws
        through = np.linalg.solve(inverse + inner, whole[:, others, k][:, :, None])[:, :, 0]
        return np.asarray(whole[:, k, k] - np.sum(whole[:, k][:, others] * through, axis=1))

    return seen


def _square(plant: TransferMatrix) -> int:
    rows, columns = plant.shape
    if rows != columns:
        raise LoopError(f"one controller a loop needs as many inputs as outputs, not {columns} and {rows}")
    return rows


def _grid(plant: TransferMatrix) -> Array:
    return frequencies([element for row in plant.elements for element in row])
