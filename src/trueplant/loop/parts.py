"""A law as parts that add up to its OP, each linear in one gain: what a record is asked for to check a declaration.

From one sample at which OP is known to the next, what a law adds does not depend on how it started: what its states
held at the first of a run of samples only adds their free response, whatever wind-up or hand put it there.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from trueplant.arrays import Array, ComplexArray
from trueplant.compiled import compiled
from trueplant.errors import LoopError
from trueplant.loop.controller import Controller
from trueplant.loop.law import StateSpace, backward, dynamics, filtered_setpoint, recursion, state_space
from trueplant.loop.pid import PID, Entry, Linear
from trueplant.lti.sampled import expm
from trueplant.lti.transfer import Term, TransferFunction

Recursion = tuple[Array, Array, Array, float]


class Sum(StrEnum):
    """How a law in s becomes one of samples."""

    BACKWARD = "backward"
    """s is (1 - z^-1)/h: the present error is in the integral."""
    TRAPEZOIDAL = "trapezoidal"
    """s is 2/h (1 - z^-1)/(1 + z^-1)."""
    FORWARD = "forward"
    """Exact for signals that are held until the next sample: the present error is not yet in the integral."""


class Kind(StrEnum):
    """What a part of a law is."""

    GAIN = "gain"
    """P; of a transfer function all but the integral."""
    INTEGRAL = "integral"
    DERIVATIVE = "derivative"


@dataclass(frozen=True, eq=False)
class Part:
    """One part of one entry on a record of N samples."""

    place: tuple[int, int]
    """(input, output)"""
    kind: Kind
    values: Array
    """(N,) what it adds to OP, from zero states, with the gain declared."""
    memory: Array
    """(steps, n) what its n states at a sample add to OP from that sample on."""
    poles: ComplexArray
    """(n,) of the recursion."""


def law_parts(
    controller: Controller, i: int, r: Array, y: Array, h: float, integral: Sum, rest: Sum, steps: int
) -> tuple[Part, ...]:
    """The parts that write OP i from set-points r and PVs y (N, n_y), finite, at each of its samples h.

    integral and rest: how the integrals and how all other dynamics are summed up. A scan that is declared and other
    than h does not count. Raises LoopError for what cannot be run in time and for a pv_transform without a value.
    """
    found = []
    for (row, j), entry in controller.entries.items():
        if row != i:
            continue
        own = replace(entry, sample_time=h)
        transform = entry.pv_transform if isinstance(entry, PID) else None
        sp, pv = r[:, j], y[:, j]
        if transform is not None:
            sp, pv = np.asarray(transform(sp)), np.asarray(transform(pv))
            if not (np.all(np.isfinite(sp)) and np.all(np.isfinite(pv))):
                raise LoopError(f"pv_transform has no finite value for some set-point or PV of output {j + 1}")
        sp = filtered_setpoint(own, sp, h, float(sp[0]))
        for kind, (a, b, c, d), weight in _recursions(own, (row, j), h, integral, rest):
            error = weight * (sp - sp[0]) - (pv - sp[0])
            found.append(
                Part(
                    (row, j),
                    kind,
                    recursion(a, b, c, d, error),
                    _memory(a, c, steps),
                    np.linalg.eigvals(a).astype(complex),
                )
            )
    return tuple(found)


def _recursions(
    entry: Entry, place: tuple[int, int], h: float, integral: Sum, rest: Sum
) -> Iterator[tuple[Kind, Recursion, float]]:
    """The parts of an entry that are not zero, as y[k] = c x + d e[k], x = a x + b e[k]; set-point weights."""
    if isinstance(entry, Linear):
        residue, remaining = _without_integral(entry.tf)
        if not remaining.is_zero:
            where = f"the controller from output {place[1] + 1} to input {place[0] + 1}"
            yield Kind.GAIN, _sampled(state_space(remaining, where), h, rest), 1.0
        if residue:
            yield Kind.INTEGRAL, _sampled(_integrator(residue), h, integral), 1.0
        return
    kp, ki, kd, tf = entry.parallel
    if kp:
        yield Kind.GAIN, (np.zeros((0, 0)), np.zeros(0), np.zeros(0), kp), entry.setpoint_weight
    if ki:
        yield Kind.INTEGRAL, _sampled(_integrator(ki), h, integral), 1.0
    if kd:
        difference = np.zeros((1, 1)), np.ones(1), np.array([-kd / h]), kd / h
        filtered = _sampled(dynamics(entry, place), h, rest) if tf else difference
        yield Kind.DERIVATIVE, filtered, 1.0 if entry.derivative_on == "error" else 0.0


def _integrator(gain: float) -> StateSpace:
    return StateSpace(np.zeros((1, 1)), np.ones(1), np.array([gain]), 0.0)


def _without_integral(system: TransferFunction) -> tuple[float, TransferFunction]:
    """The residue at s = 0 of the terms that integrate once and without delay, and what is left without it."""
    residue, left = 0.0, []
    for term in system.terms:
        if len(term.den) > 1 and term.den[-1] == 0 and term.den[-2] != 0 and not term.dead_time:
            own = term.num[-1] / term.den[-2]
            num = np.polysub(term.num, own * np.array(term.den[:-1]))[:-1]
            residue, term = residue + own, Term(tuple(num) or (0.0,), term.den[:-1])
        left.append(term)
    return residue, TransferFunction(tuple(left))


def _sampled(system: StateSpace, h: float, how: Sum) -> Recursion:
    if how is Sum.BACKWARD:
        return backward(system, h)
    n = system.b.size
    if how is Sum.TRAPEZOIDAL:
        m = np.linalg.inv(np.eye(n) - h / 2 * system.a)
        b = m @ system.b
        return m @ (np.eye(n) + h / 2 * system.a), b, h * (system.c @ m), float(system.d + h / 2 * (system.c @ b))
    joint = np.zeros((n + 1, n + 1))
    joint[:n, :n], joint[:n, n] = system.a * h, system.b * h
    exact = expm(joint)
    return np.ascontiguousarray(exact[:n, :n]), np.ascontiguousarray(exact[:n, n]), system.c, system.d


@compiled
def _memory(a: Array, c: Array, steps: int) -> Array:
    """(steps, n) rows c a^k: the free response to each state."""
    n = c.size
    out = np.empty((steps, n))
    row, new = c.copy(), np.zeros(n)
    for k in range(steps):
        out[k] = row
        for q in range(n):
            new[q] = 0.0
            for p in range(n):
                new[q] += row[p] * a[p, q]
        row, new = new, row
    return out
