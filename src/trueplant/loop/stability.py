"""Number of unstable closed-loop poles with exact dead time, by the argument principle.

det(I + G Q) is followed along Re s = -sigma, with a sigma that is tiny against all rates of the loop: no
indentations are needed, and integrators count as poles to the right of the line. The steps along the line are halved
until I + G Q changes little over each. Open-loop poles are counted in G and in Q separately with the
multiplicity that their realisation needs, so that a cancellation of an unstable pole does not hide it.
(Skogestad and Postlethwaite 2005, theorem 4.9.)
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from trueplant.arrays import Array, ComplexArray
from trueplant.errors import IllPosedLoop, LoopError, UnstableLoop
from trueplant.loop import levels
from trueplant.loop.controller import Controller
from trueplant.loop.kernel import Terms, terms_of
from trueplant.loop.pid import PID, Entry, hold
from trueplant.lti.transfer import TransferMatrix

Function = Callable[[ComplexArray], ComplexArray]


@dataclass(frozen=True)
class _Rates:
    """All rates in the loop, in rad per time unit."""

    slowest: float
    fastest: float
    dead_time: float
    poles: ComplexArray


def unstable_poles(plant: TransferMatrix, controller: Controller) -> int:
    """Number of closed-loop poles in the closed right half-plane (outside the unit circle for a sampled loop).

    Exact for continuous controllers and for controllers with one common scan. Controllers with different
    scans are taken by their frequency functions, which neglects aliasing. Raises IllPosedLoop, LoopError (improper
    loops, or when it cannot be decided) and UnstableLoop where dead time makes the count infinite.
    """
    h = controller.scan
    law = _continuous_part(controller) if h else controller
    rates = _rates(plant, law, h)
    sigma = levels.LEFT_OF_AXIS * rates.slowest
    if h:
        sigma = max(sigma, levels.LEFT_WHEN_SAMPLED / h)
    open_loop = _multiplicity(plant, _plant_poles(plant), rates, lambda p: p.real > -sigma)
    if h:
        outside = np.exp(-sigma * h)
        open_loop += _multiplicity(law, _law_poles(law), rates, lambda p: np.abs(1 - h * p) < 1 / outside)
        terms = terms_of(plant, h)
        scan = h

        def sampled(s: ComplexArray) -> ComplexArray:
            return _held_response(terms, plant.shape, np.exp(s * scan)) @ (controller(s) / hold(s, scan)[:, None, None])

        phase = _phase_along(sampled, sigma, np.pi / h, rates)
    else:
        open_loop += _multiplicity(controller, _law_poles(law), rates, lambda p: p.real > -sigma)
        phase = _continuous_phase(plant, controller, sigma, rates)
    count = open_loop - phase / np.pi
    if abs(count - round(count)) > levels.UNDECIDED:
        raise LoopError("whether the closed loop is stable cannot be decided: it is too close to its limit")
    return round(count)


def _continuous_part(controller: Controller) -> Controller:
    """The same laws in the variable that stands for s in a sampled one."""
    entries: dict[tuple[int, int], Entry] = {}
    for place, entry in controller.entries.items():
        entries[place] = replace(entry, sample_time=None)
    return replace(controller, entries=entries)


def _plant_poles(plant: TransferMatrix) -> ComplexArray:
    return np.concatenate([element.poles for row in plant.elements for element in row])


def _law_poles(controller: Controller) -> ComplexArray:
    found = [np.zeros(0, dtype=complex)]
    for entry in controller.entries.values():
        if isinstance(entry, PID):
            _, ki, kd, tf = entry.parallel
            found.append(np.array(([0.0] if ki else []) + ([-1 / tf] if kd and tf else []), dtype=complex))
        else:
            found.append(entry.tf.poles)
    return np.concatenate(found)


def _rates(plant: TransferMatrix, law: Controller, h: float | None) -> _Rates:
    poles = np.concatenate([_plant_poles(plant), _law_poles(law)])
    terms = [term for row in plant.elements for element in row for term in element.terms]
    zeros = []
    for entry in law.entries.values():
        if isinstance(entry, PID):
            kp, ki, kd, tf = entry.parallel
            zeros.append(np.roots([kp * tf + kd, kp + ki * tf, ki]))
        else:
            terms += entry.tf.terms
    zeros += [np.roots(term.num) for term in terms]
    dead_times = np.array([term.dead_time for term in terms if term.dead_time > 0])
    rates = np.abs(np.concatenate([poles, *zeros]))
    rates = np.concatenate([rates[rates > 0], 1 / dead_times, [1 / h] if h else []])
    if rates.size == 0:
        rates = np.ones(1)
    longest = float(dead_times.max(initial=0.0)) * plant.shape[0]
    return _Rates(float(rates.min()), float(rates.max()), longest, poles)


def _multiplicity(
    system: Function, poles: ComplexArray, rates: _Rates, unstable: Callable[[ComplexArray], NDArray[np.bool_]]
) -> int:
    """McMillan degree of the system's unstable poles, from its Laurent coefficients around each."""
    total = 0
    scale = max(rates.slowest, 1e-12)
    left = list(poles[unstable(poles)])
    while left:
        near = [p for p in left if abs(p - left[0]) < levels.SAME_POLE * max(abs(left[0]), scale)]
        left = [p for p in left if p not in near]
        centre = np.mean(near)
        distance = np.abs(rates.poles - centre)
        others = distance[distance > levels.OTHER_POLE * max(abs(centre), scale)]
        radius = levels.CIRCLE * float(np.min(others, initial=max(abs(centre), rates.slowest)))
        if rates.dead_time > 0:
            radius = min(radius, 1 / rates.dead_time)
        points = levels.CIRCLE_POINTS
        turn = np.exp(2j * np.pi * np.arange(points) / points)
        around = system(np.asarray(centre + radius * turn, dtype=np.complex128))
        order = min(len(near), levels.MOST_MULTIPLE)
        laurent = [np.tensordot(turn**m, around, (0, 0)) / points for m in range(1, 2 * order)]
        hankel = np.block([[laurent[a + b] for b in range(order)] for a in range(order)])
        singular = np.linalg.svd(hankel, compute_uv=False)
        total += int(np.sum(singular > levels.NO_POLE * np.max(np.abs(around))))
    return total


def _held_response(terms: Terms, shape: tuple[int, int], z: ComplexArray) -> ComplexArray:
    """Pulse response of the plant at z (n,) for a held input read after the output: (n, n_y, n_u)."""
    value = np.zeros((z.size, *shape), dtype=complex)
    for t in range(terms.i.size):
        n = terms.order[t]
        part = terms.d[t] * z ** -(terms.q[t] + 1.0) if terms.d[t] else np.zeros(z.size, complex)
        if n:
            drive = terms.b0[t, :n] + terms.b1[t, :n] / z[:, None]
            states = np.linalg.solve(z[:, None, None] * np.eye(n) - terms.A[t, :n, :n], drive[:, :, None])[:, :, 0]
            part = part + states @ terms.C[t, :n] * z ** -float(terms.q[t])
        value[:, terms.i[t], terms.j[t]] += part
    return value


def _continuous_phase(plant: TransferMatrix, controller: Controller, sigma: float, rates: _Rates) -> float:
    """Phase change of det(I + G Q) from 0 to infinite frequency on the line."""

    def loop(s: ComplexArray) -> ComplexArray:
        return plant(s) @ controller(s)

    far = loop(np.asarray(rates.fastest * np.array(levels.FAR), dtype=np.complex128))
    low, high = (np.max(np.abs(response)) for response in far)
    if not np.all(np.isfinite(far)) or high > levels.GROWING * low + levels.GROWING_FROM:
        raise LoopError("the loop's gain grows without limit at high frequency: add a filter to the derivative")
    direct = far[1].real
    eye = np.eye(plant.shape[0])
    if abs(np.linalg.det(eye + direct)) < levels.ILL_POSED * max(1.0, float(np.linalg.norm(direct))):
        raise IllPosedLoop(
            "I + G Q is singular at infinite frequency: the model passes its input on without lag, and the controller "
            "exactly undoes that. Add the lag or dead time that the plant must have"
        )
    rest = np.linalg.inv(eye + direct)

    def reduced(s: ComplexArray) -> ComplexArray:
        return np.asarray(rest @ (loop(s) - direct), dtype=np.complex128)

    # beyond the top all eigenvalues of the loop are below 1: det(I + L) goes to 1 without turning
    top, before = 10 * rates.fastest, np.inf
    while True:
        tail = reduced(_on_line(sigma, np.geomspace(top, 1e3 * top, 2000)))
        largest = float(np.max(np.abs(np.linalg.eigvals(tail))))
        levels_out = largest > levels.LEVELS_OUT * before
        if largest < levels.SMALL_LOOP or (levels_out and largest < levels.BELOW_ONE):
            break
        if levels_out:
            raise UnstableLoop(
                "the loop's gain stays at 1 or above at high frequency behind a dead time: add a lag, or lower the gain"
            )
        top, before = 10 * top, largest
    end = np.linalg.eigvals(reduced(_on_line(sigma, np.array([top]))))[0]
    return _phase_along(reduced, sigma, top, rates) - float(np.sum(np.angle(1 + end)))


def _on_line(sigma: float, w: Array) -> ComplexArray:
    return np.asarray(-sigma + 1j * w, dtype=np.complex128)


def _phase_along(loop: Function, sigma: float, top: float, rates: _Rates) -> float:
    """Phase change of det(I + L) from -sigma to -sigma + j top, followed with steps as small as needed.

    A step is small enough when all eigenvalues of (I + L) relative to the point before are near 1: the
    determinant alone can hide loops that turn together.
    """

    def difference(w: Array) -> ComplexArray:
        response = loop(_on_line(sigma, w))
        return np.asarray(np.eye(response.shape[-1]) + response, dtype=np.complex128)

    undecided = LoopError("whether the closed loop is stable cannot be decided: it is too close to its limit")
    resonances = rates.poles[np.abs(rates.poles.imag) > 0]
    near = np.abs(resonances.imag)[:, None] + np.abs(resonances.real + sigma)[:, None] * np.geomspace(1e-2, 1e2, 20)
    w = np.concatenate(
        [[0.0], np.geomspace(1e-2 * sigma, top, levels.FIRST_POINTS), near.ravel(), (2 * near[:, :1] - near).ravel()]
    )
    w = np.unique(w[(w >= 0) & (w <= top)])
    value = difference(w)
    while True:
        try:
            change = np.linalg.eigvals(np.linalg.solve(value[:-1], value[1:]))
        except np.linalg.LinAlgError as error:
            raise undecided from error
        size = np.max(np.abs(value - np.eye(value.shape[-1])), axis=(1, 2))
        turning = np.diff(w) * rates.dead_time > levels.DEAD_TIME_TURN
        near_one = np.all(np.abs(change - 1) < levels.LARGEST_CHANGE, axis=1)
        coarse = ~near_one | (turning & (size[1:] + size[:-1] > levels.QUIET_LOOP))
        if not np.any(coarse):
            return float(np.sum(np.angle(change)))
        left, right = w[:-1][coarse], w[1:][coarse]
        middle = np.where((left > 0) & (right > 2 * left), np.sqrt(left * right), (left + right) / 2)
        if w.size + middle.size > levels.MOST_POINTS or np.any((middle <= left) | (middle >= right)):
            raise undecided
        order = np.argsort(np.concatenate([w, middle]))
        value = np.concatenate([value, difference(middle)])[order]
        w = np.concatenate([w, middle])[order]
