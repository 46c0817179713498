"""Decentralised PI and PID controllers with the least mu of robust performance.

mu of robust performance is below 1 where every plant within the declared uncertainty has its weighted error below 1
(Skogestad and Postlethwaite 2005, section 8.10). Over gains and times of several loops it has many minima, so they are
looked for by differential evolution (Storn and Price, J. Global Optim. 11, 1997), which begins with the controllers
that are known, and sharpened by a descent (Nelder and Mead 1965). The least mu is often reached by sluggish settings as
well as by brisk ones: among those with nearly the least, the settings with the largest integral gains are taken. The
integrated error of a load step is one over the integral gain of its loop.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from trueplant.arrays import Array, ComplexArray
from trueplant.errors import LoopError
from trueplant.loop import PID, Controller
from trueplant.lti import TransferMatrix
from trueplant.robust import Full, Peak, robust_performance
from trueplant.robust.blocks import Structure
from trueplant.robust.generalised import channels, uncertainty_blocks
from trueplant.robust.upper import balanced, upper_bound
from trueplant.tune import levels
from trueplant.tune.drawn import common_grid, peaks
from trueplant.tune.response import axis
from trueplant.tune.together import LoopTask, bare_law, check_plant, with_entries


@dataclass(frozen=True)
class Weighting:
    """What robust performance is asked for, as `robust_performance` takes it."""

    uncertainty: Any
    """wI, of each input."""
    performance: Any
    """wP, of each output."""


@dataclass(frozen=True, eq=False)
class TunedForPerformance:
    """Settings with nearly the least mu."""

    controller: Controller
    mu: Peak
    """Of these settings, over all frequencies."""
    least: float
    """The least that was found, on the grid of the search."""


def tune_performance(
    plant: TransferMatrix,
    tasks: Sequence[LoopTask],
    today: Controller,
    weighting: Weighting,
    *,
    known: Sequence[Controller] = (),
    seed: int = 0,
) -> TunedForPerformance:
    """PI or ideal PID controllers for the tasks with nearly the least mu, no loop gain above 1 beyond its crossover.

    today: controllers of all loops; those that no task names are kept. known: other controllers to begin with. The same
    seed gives the same settings. The plant must be stable but for integrators.

    Raises LoopError where no settings are stable and within the crossovers, and UsageError for weights that do not fit.
    """
    check_plant(plant, tasks)
    search = _Search.of(plant, tasks, today, weighting)
    starts = [at for law in (today, *known) if (at := search.place(law)) is not None]
    low, high = search.box(starts)
    population = _population(starts, low, high, seed)
    found = _evolved(search.rough, population, low, high, seed)
    found = _descended(search.exact, found)
    least = search.exact(found)
    if not np.isfinite(least) or least >= levels.NOT_ALLOWED:
        raise LoopError("no settings were found that are stable and keep the loops within their crossovers")
    limit = least * levels.NEAR_LEAST_MU

    def slowness(x: Array) -> float:
        """Log of the product of the integrated errors, where mu is near its least."""
        excess = max(search.exact(x) / limit - 1, 0.0)
        return float(np.sum(x[:, 1] - x[:, 0])) + levels.MU_PENALTY * excess

    found = _descended(slowness, found)
    controller = search.controller(found)
    peak = robust_performance(plant, controller, weighting.uncertainty, weighting.performance).RP
    if not np.isfinite(peak.upper):
        raise LoopError("robust performance is out of reach: wP asks for more at rest than integral action gives")
    return TunedForPerformance(controller, peak, least)


@dataclass(frozen=True, eq=False)
class _Search:
    """mu of candidates (n_tasks, 2 or 3): the logarithms of |Kc|, Ti and, for PIDs, Td."""

    tasks: Sequence[LoopTask]
    today: Controller
    bare: tuple[PID, ...]
    signs: Array
    w: Array
    """Of the count of unstable poles."""
    response: ComplexArray
    """(2, n_w, n_y, n_u) the plant, and with the dead times that could be hidden as well: both have to be stable."""
    points: Array
    """Of mu."""
    G: ComplexArray
    w_error: ComplexArray
    w_performance: ComplexArray
    blocks: Structure

    @classmethod
    def of(cls, plant: TransferMatrix, tasks: Sequence[LoopTask], today: Controller, weighting: Weighting) -> _Search:
        n_y, n_u = plant.shape
        w = common_grid(plant, today, max(task.crossover for task in tasks))
        points = np.geomspace(w[0], w[-1], levels.MU_POINTS_PER_DECADE * int(np.ceil(np.log10(w[-1] / w[0]))))
        s = axis(points)
        own = channels(weighting.uncertainty, n_u, "the uncertainty")
        asked = channels(weighting.performance, n_y, "the performance")
        response = plant(axis(w))
        later = np.ones((w.size, 1, n_u), dtype=np.complex128)
        for task in tasks:
            later[:, 0, task.input] *= np.exp(-axis(w) * task.unseen)
        direct = [response[0, task.output, task.input] for task in tasks]
        # an integrator begins at -90 degrees
        signs = np.array([np.sign(g.real) if abs(g.real) >= abs(g.imag) else -np.sign(g.imag) for g in direct])
        return cls(
            tasks,
            today,
            tuple(bare_law(task) for task in tasks),
            signs,
            w,
            np.stack([response, response * later]),
            points,
            plant(s),
            np.stack([np.broadcast_to(f(s), s.shape) for f in own], axis=1)[:, :, None],
            np.stack([np.broadcast_to(f(s), s.shape) for f in asked], axis=1)[:, :, None],
            Structure.of((*uncertainty_blocks(plant.shape, "input"), Full(n_y)), (n_u + n_y, n_u + n_y)),
        )

    @property
    def width(self) -> int:
        """Columns of a candidate."""
        return 3 if any(task.kind == "PID" for task in self.tasks) else 2

    def place(self, controller: Controller) -> Array | None:
        """The candidate of these controllers; None where they are no PIs and PIDs with the right sign."""
        rows = []
        for task, sign in zip(self.tasks, self.signs, strict=True):
            law = controller.entries.get((task.input, task.output))
            if not isinstance(law, PID) or law.pv_transform is not None:
                return None
            kp, ki, kd, _ = law.parallel
            if not (kp * sign > 0 and ki * sign > 0):
                return None
            times = [abs(kp), kp / ki, max(kd / kp, levels.LEAST_TD * kp / ki)]
            rows.append(np.log(times[: self.width]))
        return np.array(rows)

    def box(self, starts: Sequence[Array]) -> tuple[Array, Array]:
        """The range of the search, (n_tasks, width) each, round the starts or round the crossovers without any."""
        if not starts:
            middle = []
            for task in self.tasks:
                size = abs(np.interp(task.crossover, self.w, np.abs(self.response[0, :, task.output, task.input])))
                middle.append([-np.log(2 * size), -np.log(task.crossover), -np.log(10 * task.crossover)][: self.width])
            starts = [np.array(middle)]
        all_starts = np.array(starts)
        around = np.log(levels.AROUND_STARTS)
        return all_starts.min(axis=0) - around, all_starts.max(axis=0) + around

    def controller(self, x: Array) -> Controller:
        laws = {}
        for task, bare, sign, row in zip(self.tasks, self.bare, self.signs, x, strict=True):
            td = float(np.exp(row[2])) if task.kind == "PID" else 0.0
            laws[task] = replace(bare, Kc=float(sign * np.exp(row[0])), Ti=float(np.exp(row[1])), Td=td)
        return with_entries(self.today, laws)

    def rough(self, x: Array) -> float:
        """A bound that balancing gives: never below mu's own, some per cent above it at most."""
        return self._value(x, exact=False)

    def exact(self, x: Array) -> float:
        """The largest upper bound of mu on the grid; more than `NOT_ALLOWED` where the loops are not allowed."""
        return self._value(x, exact=True)

    def _value(self, x: Array, exact: bool) -> float:
        controller = self.controller(x)
        law = controller(axis(self.w))
        beyond = 0.0
        for task in self.tasks:
            fast = self.w >= task.crossover
            gain = np.abs(self.response[0, fast, task.output, task.input] * law[fast, task.input, task.output])
            beyond = max(beyond, float(np.log(np.max(gain, initial=1e-300))))
        if beyond > levels.ROUNDING:
            return levels.NOT_ALLOWED * (1 + beyond)
        if not peaks(self.response, law, self.w).stable.all():
            # gains that are too high are the usual reason: the way back is down
            return levels.NOT_ALLOWED * (2 + float(np.sum(np.maximum(x[:, 0], levels.LOWEST_LOG_GAIN))) / 100)
        N = self._generalised(controller(axis(self.points)))
        if exact:
            return float(np.max(upper_bound(N, self.blocks).bound))
        rows, columns = self.blocks.members()
        scaling = balanced(N, self.blocks)
        scaled = np.exp(scaling @ rows.T)[:, :, None] * N / np.exp(scaling @ columns.T)[:, None, :]
        return float(np.max(np.linalg.norm(scaled, ord=2, axis=(1, 2))))

    def _generalised(self, Q: ComplexArray) -> ComplexArray:
        """N as `generalised_plant` has it for uncertainty at the input, of what was computed once."""
        S = np.linalg.inv(np.eye(self.G.shape[1]) + self.G @ Q)
        QS = Q @ S
        upper = -self.w_error * np.concatenate([QS @ self.G, QS], axis=2)
        lower = self.w_performance * np.concatenate([S @ self.G, S], axis=2)
        return np.asarray(np.concatenate([upper, lower], axis=1), dtype=np.complex128)


def _population(starts: Sequence[Array], low: Array, high: Array, seed: int) -> Array:
    """(n, n_tasks, width): the starts, and others spread evenly over the box."""
    from scipy.stats import qmc

    count = levels.MU_POPULATION
    spread = qmc.scale(qmc.Sobol(low.size, seed=seed).random(count), low.ravel(), high.ravel())
    spread = spread.reshape(count, *low.shape)
    return np.asarray(np.concatenate([np.array(starts).reshape(-1, *low.shape), spread])[:count])


def _evolved(function: Any, population: Array, low: Array, high: Array, seed: int) -> Array:
    from scipy.optimize import differential_evolution

    found = differential_evolution(
        lambda x: function(x.reshape(low.shape)),
        list(zip(low.ravel(), high.ravel(), strict=True)),
        init=population.reshape(len(population), -1),
        maxiter=levels.MU_GENERATIONS,
        tol=levels.MU_SPREAD,
        seed=seed,
        polish=False,
    )
    return np.asarray(found.x, dtype=float).reshape(low.shape)


def _descended(function: Any, start: Array) -> Array:
    from scipy.optimize import minimize

    best = start.ravel()
    for size in levels.MU_SIMPLEX:
        corners = np.vstack([best, best + size * np.eye(start.size)])
        options = {"initial_simplex": corners, "xatol": 1e-3, "fatol": 1e-5, "maxfev": levels.MU_DESCENT}
        found = minimize(lambda x: function(x.reshape(start.shape)), best, method="Nelder-Mead", options=options)
        best = np.asarray(found.x, dtype=float)
    return best.reshape(start.shape)
