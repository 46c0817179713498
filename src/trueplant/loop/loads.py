"""What acts on a loop from outside, in a line each: steps, ramps, random walks, coloured noise, and models of them.

    simulate(plant, law, r, h, input_disturbance=Step(50.0, (0.2, 0.0)), v=[Ramp(10.0, 90.0, 1.5), Coloured(0.1, 5.0)])

A size is a number for all channels, or one a channel. Steps and ramps are known; the others are drawn, at the instants
of the record, and hold from one to the next.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np
from numpy.typing import ArrayLike

from trueplant.arrays import Array
from trueplant.errors import LoopError
from trueplant.loop.signals import Seed, ar1, arma, channels, drift, signal_of, step_disturbance
from trueplant.lti.sampled import sampled_response
from trueplant.lti.transfer import TransferMatrix

Sizes = float | tuple[float, ...]
"""One number for all channels, or one each."""


@dataclass(frozen=True)
class Grid:
    """The instants of a simulation, and of its record: every `every`-th of them."""

    steps: int
    h: float
    every: int = 1

    @property
    def record(self) -> Grid:
        """The instants of the record, with one beyond the end of the simulation."""
        return Grid((self.steps - 1) // self.every + 2, self.h * self.every)

    def between(self, values: Array, hold: Sequence[str]) -> Array:
        """(steps, n) from values (m, n) at the instants of the record, between which each runs as `hold` says."""
        at, known = np.arange(self.steps), self.every * np.arange(len(values))
        out = np.empty((self.steps, len(hold)))
        for j, how in enumerate(hold):
            out[:, j] = np.interp(at, known, values[:, j]) if how == "linear" else values[at // self.every, j]
        return out


class Load(ABC):
    """A signal from outside the loop."""

    straight = False
    """Does it run in straight lines between the instants, or hold?"""

    @abstractmethod
    def sampled(self, grid: Grid, n: int, rng: np.random.Generator) -> Array:
        """(steps, n) at the instants. Raises LoopError for what cannot be."""


@dataclass(frozen=True)
class Step(Load):
    """0, and `size` from the first instant at or after `time`."""

    time: float
    size: Sizes

    def __post_init__(self) -> None:
        if np.isnan(self.time):
            raise LoopError("the time of a step must be a number")

    def sampled(self, grid: Grid, n: int, rng: np.random.Generator) -> Array:
        return step_disturbance(grid.steps, grid.h, self.time, channels(self.size, n, "size"))


@dataclass(frozen=True)
class Ramp(Load):
    """0 until the time `start`, in a straight line to `size` at the time `end`, and there from then on."""

    start: float
    end: float
    size: Sizes
    straight = True

    def __post_init__(self) -> None:
        if not self.start < self.end:
            raise LoopError(f"a ramp must end after it starts, not run from {self.start:g} to {self.end:g}")

    def sampled(self, grid: Grid, n: int, rng: np.random.Generator) -> Array:
        done = np.interp(grid.h * np.arange(grid.steps), [self.start, self.end], [0.0, 1.0])
        return np.asarray(done[:, None] * channels(self.size, n, "size"))


class _Drawn(Load):
    """A random load: the same seed gives the same load, whatever else acts on the loop."""

    seed: int | None

    def sampled(self, grid: Grid, n: int, rng: np.random.Generator) -> Array:
        own = rng if self.seed is None else np.random.default_rng(self.seed)
        return grid.between(self.drawn(grid.record, n, own), ("zoh",) * n)

    @abstractmethod
    def drawn(self, grid: Grid, n: int, seed: Seed) -> Array:
        """(steps, n) at the instants of the record."""


@dataclass(frozen=True)
class RandomWalk(_Drawn):
    """From 0; its standard deviation after the time t is ``rate sqrt(t)``.

    correlation: of the channels, a number for all pairs or a matrix. seed: None takes the simulation's.
    """

    rate: Sizes
    correlation: float | tuple[tuple[float, ...], ...] = 0.0
    seed: int | None = None

    def drawn(self, grid: Grid, n: int, seed: Seed) -> Array:
        return drift(grid.steps, grid.h, channels(self.rate, n, "rate"), seed, self.correlation)


@dataclass(frozen=True)
class Coloured(_Drawn):
    """Stationary noise of the standard deviation `std`: white, of first order, or any ``C(q)/A(q) e``.

    time_constant: correlation exp(-t/time_constant). c and a instead: the polynomials in powers of q^-1, one power a
    sample of the record, a beginning with 1. correlation and seed as of `RandomWalk`.
    """

    std: Sizes
    time_constant: float | None = None
    c: tuple[float, ...] = (1.0,)
    a: tuple[float, ...] = (1.0,)
    correlation: float | tuple[tuple[float, ...], ...] = 0.0
    seed: int | None = None

    def __post_init__(self) -> None:
        if self.time_constant is not None and (self.c, self.a) != ((1.0,), (1.0,)):
            raise LoopError("the colour of a noise is given by time_constant or by c and a, not by both")

    def drawn(self, grid: Grid, n: int, seed: Seed) -> Array:
        size = channels(self.std, n, "std")
        if self.time_constant is not None:
            return ar1(grid.steps, grid.h, self.time_constant, size, seed, self.correlation)
        return arma(grid.steps, self.c, self.a, size, seed, self.correlation)


@dataclass(frozen=True)
class Filtered(Load):
    """A load that reaches the channels through a model of its own (n, m); m is the number of its channels.

    Exact at the instants, and taken to run in straight lines between them.
    """

    model: TransferMatrix
    load: Load
    straight = True

    def sampled(self, grid: Grid, n: int, rng: np.random.Generator) -> Array:
        if self.model.shape[0] != n:
            raise LoopError(f"the model of a load has {self.model.shape[0]} outputs and must have {n}")
        driving = self.load.sampled(grid, self.model.shape[1], rng)
        return from_rest(self.model, driving, grid.h, "linear" if self.load.straight else "zoh")


Loads = ArrayLike | Load | Sequence[Load]
"""What acts at one place: the signal (N, n) or one value a channel, held between the instants, or loads that add up."""


def from_rest(system: TransferMatrix, u: Array, h: float, hold: str | tuple[str, ...]) -> Array:
    """(N, n_y) what inputs u (N, n_u) make that are 0 before the first instant and jump to their first values there.

    By itself a straight line would come to its first value from 0, one step before.
    """
    first = np.broadcast_to(u[:1], u.shape)
    return sampled_response(system, u - first, h, hold) + sampled_response(system, first, h)


@dataclass(frozen=True, eq=False)
class Outside:
    """What acts on a loop at each place: (N, n) held from one instant to the next, and (N, n) running straight."""

    output: tuple[Array, Array]
    input: tuple[Array, Array]
    d: Array
    """(N, n_d) measured disturbances."""
    hold: tuple[str, ...]
    """"zoh" or "linear" for each of these: how it runs between the instants."""


def outside_of(
    given: tuple[Loads | None, Loads | None, Loads | None],
    sizes: tuple[int, int, int],
    hold: str | Sequence[str],
    grid: Grid,
    seed: int,
) -> Outside:
    """What was given at the output, at the input and as measured disturbances, of so many channels each."""
    n_d = sizes[2]
    holds = (hold,) * n_d if isinstance(hold, str) else tuple(hold)
    if len(holds) != n_d or not set(holds) <= {"zoh", "linear"}:
        raise LoopError(f'd_hold must be "zoh" or "linear", one for all measured disturbances or {n_d}, not {hold!r}')
    # streams 0 and 1 are those of noise and spikes; one a place, so that loads at one leave those at others as they are
    output = _acting(given[0], grid, sizes[0], "v", (seed, 2))
    behind = _acting(given[1], grid, sizes[1], "input_disturbance", (seed, 3))
    recorded = bool(_loads_of(given[2]))
    d = sum(_acting(given[2], grid.record if recorded else grid, n_d, "d", (seed, 4)), np.zeros(n_d))
    return Outside(output, behind, grid.between(d, holds) if recorded else d, holds)


def _loads_of(given: Loads | None) -> tuple[Load, ...]:
    """The loads that were given; none where it was a signal, or nothing."""
    if isinstance(given, Load):
        return (given,)
    found = tuple(one for one in given if isinstance(one, Load)) if isinstance(given, (list, tuple)) else ()
    if found and len(found) < len(cast("Sequence[object]", given)):
        raise LoopError("what acts at one place is a signal or a list of loads, not a list of both")
    return found


def _acting(given: Loads | None, grid: Grid, n: int, name: str, stream: tuple[int, int]) -> tuple[Array, Array]:
    """(steps, n) each: the sum of what holds between the instants, and of what runs straight."""
    held, straight = np.zeros((grid.steps, n)), np.zeros((grid.steps, n))
    loads = _loads_of(given)
    if not loads and not (isinstance(given, (list, tuple)) and not given):
        return signal_of(cast("ArrayLike | None", given), held.shape, name), straight
    for k, load in enumerate(loads):
        own = np.random.default_rng(np.random.SeedSequence(stream[0], spawn_key=(stream[1], k)))
        total = straight if load.straight else held
        total += load.sampled(grid, n, own)
    return held, straight
