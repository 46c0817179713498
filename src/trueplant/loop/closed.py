"""Closed-loop frequency functions by batched solves, and whether the declared loop can exist at all."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from trueplant.arrays import ComplexArray
from trueplant.errors import IllPosedLoop, LoopError, SignConflict, UnstableLoop
from trueplant.loop.controller import Controller
from trueplant.loop.stability import unstable_poles
from trueplant.lti.transfer import TransferFunction, TransferMatrix

Response = Callable[[ArrayLike], ComplexArray] | ComplexArray
"""A system that can be called with s (n_s,), or its response, rows first: (n_s, rows, columns)."""


@dataclass(frozen=True, eq=False)
class LoopFunctions:
    """Responses of the loop y = G u + v, u = Q (F r - y) at common points s, n_s first."""

    S: ComplexArray
    """(I + G Q)^-1 (n_s, n_y, n_y): from v to y."""
    T: ComplexArray
    """G Q S (n_s, n_y, n_y): from F r to y."""
    QS: ComplexArray
    """Q S (n_s, n_u, n_y): from F r to u."""
    SG: ComplexArray
    """S G (n_s, n_y, n_u): from a disturbance at the plant's input to y."""


def _at(system: Response, s: ArrayLike | None) -> ComplexArray:
    if not callable(system):
        return np.asarray(system, dtype=np.complex128)
    if s is None:
        raise LoopError("give the points s (n_s,) together with systems that are to be evaluated there")
    return system(s)


def _solve(left: ComplexArray, right: ComplexArray) -> ComplexArray:
    try:
        return np.asarray(np.linalg.solve(left, right), dtype=np.complex128)
    except np.linalg.LinAlgError as error:
        raise IllPosedLoop("I + G Q is singular at one of the points s: the loop has a pole there") from error


def sensitivity(G: Response, Q: Response, s: ArrayLike | None = None) -> ComplexArray:
    """S = (I + G Q)^-1 (n_s, n_y, n_y). G (n_s, n_y, n_u), Q (n_s, n_u, n_y), or callables and s."""
    loop = _at(G, s) @ _at(Q, s)
    eye = np.broadcast_to(np.eye(loop.shape[-1], dtype=complex), loop.shape)
    return _solve(eye + loop, eye)


def complementary(G: Response, Q: Response, s: ArrayLike | None = None) -> ComplexArray:
    """T = (I + G Q)^-1 G Q (n_s, n_y, n_y), accurate also where it is small."""
    loop = _at(G, s) @ _at(Q, s)
    return _solve(np.eye(loop.shape[-1]) + loop, loop)


def loop_functions(G: Response, Q: Response, s: ArrayLike | None = None) -> LoopFunctions:
    """S, T, Q S and S G on the same points s."""
    plant, law = _at(G, s), _at(Q, s)
    loop = plant @ law
    n_y = loop.shape[-1]
    eye = np.broadcast_to(np.eye(n_y, dtype=complex), loop.shape)
    all_at_once = _solve(eye + loop, np.concatenate([eye, loop, plant], axis=-1))
    S, T, SG = (all_at_once[..., a] for a in (slice(n_y), slice(n_y, 2 * n_y), slice(2 * n_y, None)))
    return LoopFunctions(S=S, T=T, QS=law @ S, SG=SG)


def _sign(element: TransferFunction) -> float:
    """Sign of the DC gain, or of the first slope where that is zero (0 if it cannot be told)."""
    gain = element.dc_gain
    if gain == 0 and not element.is_zero:
        first = min(element.terms, key=lambda term: term.dead_time)
        gain = first.num[0]
    return float(np.sign(gain)) if not np.isnan(gain) else 0.0


def check_loop(plant: TransferMatrix, controller: Controller) -> None:
    """Refuse a loop that cannot be what it is declared to be.

    Raises SignConflict if a decentralised controller's action fights the sign of the gain of its own
    element (in a plant with several loops only if the loop is also unstable: a pairing on a negative relative
    gain can be meant), IllPosedLoop if det(I + G Q) vanishes at infinite frequency, UnstableLoop if the closed
    loop is unstable, and LoopError if shapes do not fit.
    """
    if (controller.n_u, controller.n_y) != (plant.shape[1], plant.shape[0]):
        raise LoopError(
            f"the controller has {controller.n_u} inputs and {controller.n_y} outputs, the plant {plant.shape[1]} and "
            f"{plant.shape[0]}: they must agree"
        )
    wrong = []
    if controller.is_decentralised:
        for (i, j), entry in controller.entries.items():
            gain = _sign(plant[j, i])
            if entry.sign * gain < 0:
                wrong.append((i, j, entry.sign, gain))
    poles = unstable_poles(plant, controller)
    if wrong and (poles or plant.shape == (1, 1)):
        i, j, own, gain = wrong[0]
        words = {1.0: "positive", -1.0: "negative"}
        cure = 'set action = "direct"' if own > 0 else 'remove action = "direct" or set it to "reverse"'
        raise SignConflict(
            f"loop from output {j + 1} to input {i + 1}: the controller's gain is {words[own]} (in u = Q (r - y)) but "
            f"the model's gain is {words[gain]}, so the loop feeds back positively; their signs must be equal: "
            f"{cure}, or change the sign of the controller's gain or of the model's",
            place=(i, j),
        )
    if poles:
        raise UnstableLoop(
            f"the closed loop of this model and controller is unstable ({poles} pole{'s' if poles > 1 else ''} in the "
            f"right half-plane): check gains, times, dead times, their units and the action of each controller"
        )
