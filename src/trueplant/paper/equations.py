"""Equations (1)-(20) and (A.7), each side computed by itself on the mill's loop with random signals."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.linalg import inv, solve

from trueplant.arrays import ComplexArray
from trueplant.errors import Refused
from trueplant.mismatch import closed_form
from trueplant.paper import levels
from trueplant.paper.entry import Entry
from trueplant.plants import mill

SEED, POINTS = 0, 9


def equations() -> list[Entry]:
    """(1)-(20) and Appendix A, each as the largest relative residual over the frequencies."""
    found = []
    for number, what, left, right in _sides():
        residual = _residual(left, right)
        note = f"largest difference of the two sides relative to the larger; tolerance: {levels.EQUATIONS:g}"
        extra = _REMARKS.get(number, "")
        found.append(
            Entry(
                f"eq{number}",
                what,
                "an identity",
                residual,
                residual < levels.EQUATIONS,
                f"{note}. {extra}".rstrip(". "),
            )
        )
    return [*found, *_appendix()]


_REMARKS = {
    "1": "A definition, kept for completeness",
    "8": "The paper asks for QG strictly proper here; that is enough but not needed: det(I + QG) must not vanish",
    "18": "Here v = 0",
    "20": "Here v = 0",
}


def _points() -> ComplexArray:
    return np.asarray(1j * np.geomspace(0.01, 3.0, POINTS), dtype=np.complex128)


def _loop(R: ComplexArray, V: ComplexArray, G: ComplexArray, Q: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
    """y and u of the loop, from both of its equations at once and none of the paper's algebra."""
    eye = np.broadcast_to(np.eye(2), G.shape)
    both = solve(np.block([[eye, -G], [Q, eye]]), np.concatenate([V, Q @ R], axis=1))
    return both[:, :2], both[:, 2:]


def _sides() -> Iterator[tuple[str, str, Any, Any]]:
    """Number, what it says, left and right side of each equation."""
    rng = np.random.default_rng(SEED)

    def signals() -> ComplexArray:
        return np.asarray(rng.standard_normal((POINTS, 2, 2)) + 1j * rng.standard_normal((POINTS, 2, 2)))

    case = mill("printed")
    assert case.plant is not None
    assert case.controller is not None
    s = _points()
    G, Ghat, Q = case.plant(s), case.model(s), case.controller(s)
    eye = np.broadcast_to(np.eye(2, dtype=complex), G.shape)
    r, v = signals(), 0.3 * signals()
    y, u = _loop(r, v, G, Q)
    yhat, delta = Ghat @ u, G - Ghat
    e = y - yhat
    yield "1", "e = y - yhat", e + yhat, y
    yield "2", "e = G u + v - Ghat u", e, G @ u + v - Ghat @ u
    yield "3", "e = Delta u + v", e, delta @ u + v
    yield "4", "u = Q (r - y)", u, Q @ (r - y)
    yield "5", "u = Q (r - [G u + v])", u, Q @ (r - (G @ u + v))
    yield "6", "u = Q r - Q G u - Q v", u, Q @ r - Q @ G @ u - Q @ v
    yield "7", "(I + Q G) u = Q r - Q v", (eye + Q @ G) @ u, Q @ r - Q @ v
    yield "8", "u = (I + Q G)^-1 Q (r - v)", u, inv(eye + Q @ G) @ Q @ (r - v)
    yield "9", "u = Q (I + G Q)^-1 (r - v)", u, Q @ inv(eye + G @ Q) @ (r - v)
    yield "10", "e = Delta Q (I + G Q)^-1 (r - v) + v", e, delta @ Q @ inv(eye + G @ Q) @ (r - v) + v
    inner = inv(eye + (delta + Ghat) @ Q)
    yield "11", "e = Delta Q (I + {Delta + Ghat} Q)^-1 (r - v) + v", e, delta @ Q @ inner @ (r - v) + v
    inner = inv(eye + delta @ Q + Ghat @ Q)
    yield "12", "e = Delta Q (I + Delta Q + Ghat Q)^-1 (r - v) + v", e, delta @ Q @ inner @ (r - v) + v
    X = (e - v) @ inv(r - v)
    DQ = delta @ Q
    yield "13", "(e - v)(r - v)^-1 = Delta Q (I + Delta Q + Ghat Q)^-1", X, DQ @ inner
    yield "14", "(e - v)(r - v)^-1 (I + Delta Q + Ghat Q) = Delta Q", X @ (eye + DQ + Ghat @ Q), DQ
    yield (
        "15",
        "(e - v)(r - v)^-1 (I + Ghat Q) = Delta Q - (e - v)(r - v)^-1 Delta Q",
        X @ (eye + Ghat @ Q),
        DQ - X @ DQ,
    )
    yield "16", "(e - v)(r - v)^-1 (I + Ghat Q) = [I - (e - v)(r - v)^-1] Delta Q", X @ (eye + Ghat @ Q), (eye - X) @ DQ
    literal = inv(eye - X) @ X @ (eye + Ghat @ Q) @ inv(Q)
    ours = closed_form(r, e, Ghat, Q, v)
    yield "17", "Delta from e, r, v, Ghat and Q", _both(literal, ours.delta), _both(delta, delta)

    y, u = _loop(r, np.zeros_like(r), G, Q)
    e = y - Ghat @ u
    X_0 = e @ inv(r)
    literal_0 = inv(eye - X_0) @ X_0 @ (eye + Ghat @ Q) @ inv(Q)
    ours_0 = closed_form(r, e, Ghat, Q)
    yield "18", "Delta from e, r, Ghat and Q", _both(literal_0, ours_0.delta), _both(delta, delta)
    yield "19", "G from e, r, v, Ghat and Q", _both(literal + Ghat, ours.plant), _both(G, G)
    yield "20", "G from e, r, Ghat and Q", _both(literal_0 + Ghat, ours_0.plant), _both(G, G)


def _both(a: ComplexArray, b: ComplexArray) -> ComplexArray:
    """The formula as printed, and as this program writes it: neither may be off."""
    return np.concatenate([a, b], axis=2)


def _residual(left: ComplexArray, right: ComplexArray) -> float:
    size = np.maximum(np.abs(left), np.abs(right)).max(axis=(1, 2))
    return float(np.max(np.abs(left - right).max(axis=(1, 2)) / size))


def _appendix() -> Iterator[Entry]:
    """Appendix A: one set-point at a time gives square signals; one experiment with both moving does not."""
    case = mill("printed")
    assert case.plant is not None
    assert case.controller is not None
    s = _points()
    G, Q = case.plant(s), case.controller(s)
    U = np.zeros_like(G)
    U[:, 0, 0], U[:, 1, 1] = 1 / s, -0.5 / s
    Y = np.stack([(G @ U[:, :, k, None])[:, :, 0] for k in range(2)], axis=2)
    residual = _residual(Y @ inv(U), G)
    yield Entry(
        "eqA7",
        "G = Y U^-1, one column an experiment in which one input moves",
        "an identity",
        residual,
        residual < levels.EQUATIONS,
        f"largest relative difference at {POINTS} frequencies; tolerance: {levels.EQUATIONS:g}",
    )
    together = np.stack([1 / s, 0.5 / s], axis=1)[:, :, None]
    R = np.concatenate([together, 2 * together], axis=2)
    y, u = _loop(R, np.zeros_like(R), G, Q)
    try:
        closed_form(R, y - case.model(s) @ u, case.model(s), Q)
        refused = False
    except Refused:
        refused = True
    yield Entry(
        "appendixA.rank",
        "(18) refuses experiments in which all set-points move in proportion",
        "one set-point is to move at a time",
        refused,
        refused,
        "the excitation matrix R(s) is then of rank 1. Any experiments with R(s) well conditioned will do, "
        "which is less than Appendix A asks for",
    )
