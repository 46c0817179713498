"""Frequencies at which a loop is looked at: its own rates, a grid, and the exact place of peaks and crossings.

Every function of frequency here is called with w (n,) in rad per time unit and returns n values.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from trueplant.arrays import Array, ComplexArray
from trueplant.loop import PID, Controller
from trueplant.lti import TransferFunction, TransferMatrix
from trueplant.robust import levels

RealFunction = Callable[[Array], Array]


@dataclass(frozen=True, eq=False)
class Rates:
    """Where things happen in a loop, in rad per time unit."""

    slowest: float
    fastest: float
    dead_time: float
    """Longest dead time around the loop."""
    resonances: Array
    """(n, 2) frequency and decay rate of lightly damped poles and zeros."""
    nyquist: float
    """pi/h of the fastest scan, infinite for a continuous controller."""

    def grid(self, per_decade: int = levels.PER_DECADE, above: float = levels.FASTEST) -> Array:
        """Logarithmic grid from far below the slowest to `above` times the fastest rate, denser at resonances."""
        low, high = levels.SLOWEST * self.slowest, min(above * self.fastest, self.nyquist)
        w = np.geomspace(low, high, 2 + int(per_decade * np.log10(high / low)))
        # never a resonance itself: without damping it is a pole
        offsets = self.resonances[:, 1:] * np.geomspace(*levels.AROUND_RESONANCE, 30)
        centre = self.resonances[:, :1]
        near = np.concatenate([centre + offsets, centre - offsets], axis=1).ravel()
        return np.unique(np.concatenate([w, near[(near > low) & (near < high)]]))


def _law(entry: PID) -> TransferFunction:
    kp, ki, kd, tf = entry.parallel
    value = TransferFunction.rational([kp * tf + kd, kp + ki * tf, ki], [tf, 1.0, 0.0])
    return value if ki else TransferFunction.rational([kp * tf + kd, kp], [tf, 1.0])


def rates_of(plant: TransferMatrix, controller: Controller, others: Iterable[TransferFunction] = ()) -> Rates:
    """Rates of all poles, zeros, dead times and scans of the loop, and of `others` such as weights."""
    entries = controller.entries.values()
    laws = [_law(entry) if isinstance(entry, PID) else entry.tf for entry in entries]
    functions = [element for row in plant.elements for element in row]
    terms = [term for function in (*functions, *laws, *others) for term in function.terms]
    roots = np.concatenate(
        [np.zeros(0, complex), *(np.roots(p).astype(complex) for t in terms for p in (t.num, t.den))]
    )
    dead_times = np.array([term.dead_time for term in terms if term.dead_time > 0])
    scans = np.array([entry.sample_time for entry in entries if entry.sample_time is not None], dtype=float)
    size = np.abs(roots)
    rates = np.concatenate([size[size > 0], 1 / dead_times, 1 / scans])
    if rates.size == 0:
        rates = np.ones(1)
    light = roots[np.abs(roots.real) < levels.LIGHT_DAMPING * roots.imag]
    damping = np.maximum(np.abs(light.real), levels.LEAST_DAMPING * light.imag)
    longest = float(dead_times.max(initial=0.0)) * plant.shape[0]
    nyquist = float(np.pi / scans.min()) if scans.size else np.inf
    return Rates(float(rates.min()), float(rates.max()), longest, np.column_stack([light.imag, damping]), nyquist)


def on_axis(w: Array, *systems: Callable[[ComplexArray], ComplexArray]) -> ComplexArray:
    """j w, a hair beside frequencies at which a system has an undamped pole."""
    s = np.asarray(1j * np.atleast_1d(w), dtype=np.complex128)
    infinite = np.zeros(s.shape, dtype=bool)
    for system in systems:
        with np.errstate(invalid="ignore"):
            infinite |= ~np.all(np.isfinite(system(s)), axis=(1, 2))
    return np.asarray(np.where(infinite, s * (1 + levels.BESIDE_POLE), s), dtype=np.complex128)


def follow(
    loop: Callable[[Array], ComplexArray],
    w: Array,
    dead_time: float,
    step: float = levels.TURN,
    floor: float = levels.FLOOR,
    most: int = levels.MOST_FOLLOWED,
) -> tuple[Array, ComplexArray]:
    """Halve the steps of the grid until L and 1 + L turn and grow little over each, where |L| is above the floor.

    A loop that turns on and on without dying out is followed from the lowest frequencies up to `most` points.
    """
    value = loop(w)
    while True:
        size = np.maximum(np.abs(value[1:]), np.abs(value[:-1]))
        with np.errstate(divide="ignore", invalid="ignore"):
            change = np.abs(np.log(value[1:] / value[:-1]))
            difference = np.abs(np.log((1 + value[1:]) / (1 + value[:-1])))
        coarse = (np.diff(w) * dead_time > step) | ~(np.maximum(change, difference) < step)
        places = np.flatnonzero(coarse & (size > floor) & (np.diff(w) > 1e-9 * w[1:]))
        if places.size == 0 or w.size >= most:
            return w, value
        if w.size + places.size > most:
            places = places[: 50 + places.size // 8]
        middle = (w[places] + w[places + 1]) / 2
        order = np.argsort(np.concatenate([w, middle]))
        value = np.concatenate([value, loop(middle)])[order]
        w = np.concatenate([w, middle])[order]


def peak(function: RealFunction, w: Array, value: Array, rivals: int = levels.RIVALS) -> tuple[float, float]:
    """Largest value of the function and its frequency, sharpened from its values on a grid to 1e-7 of the frequency.

    A peak at the lower end of the grid is reported at 0, one at the upper end at infinity.
    """
    inner = np.flatnonzero((value[1:-1] >= value[:-2]) & (value[1:-1] >= value[2:])) + 1
    tops = inner[np.argsort(value[inner])[::-1][:rivals]]
    best, place = (value[0], 0.0) if value[0] >= value[-1] else (value[-1], np.inf)
    if tops.size:
        low, high = w[tops - 1], w[tops + 1]
        steps = np.linspace(0, 1, 13)
        while np.max((high - low) / high) > levels.PEAK_PLACE:
            points = low[:, None] + (high - low)[:, None] * steps
            values = function(points.ravel()).reshape(points.shape)
            k = np.clip(np.argmax(values, axis=1), 1, steps.size - 2)
            rows = np.arange(tops.size)
            low, high = points[rows, k - 1], points[rows, k + 1]
        at = (low + high) / 2
        found = function(at)
        k = int(np.argmax(found))
        if found[k] > best * (1 + 1e-9):
            best, place = found[k], at[k]
    return float(best), float(place)


def crossings(function: RealFunction, w: Array, value: Array) -> Array:
    """Frequencies where the function passes through zero between neighbouring points of the grid, by bisection."""
    at = np.flatnonzero((value[:-1] < 0) != (value[1:] < 0))
    low, high = w[at], w[at + 1]
    negative = value[at] < 0
    for _ in range(45 if at.size else 0):
        middle = (low + high) / 2
        left = (function(middle) < 0) == negative
        low, high = np.where(left, middle, low), np.where(left, high, middle)
    return (low + high) / 2
