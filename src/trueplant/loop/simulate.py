"""The closed loop in time, and what a declared controller would have written on recorded signals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from numbers import Integral

import numpy as np
from numpy.typing import ArrayLike

from trueplant.arrays import Array
from trueplant.errors import LoopError, UnstableLoop
from trueplant.loop.controller import Controller
from trueplant.loop.kernel import run_law, run_loop, terms_of
from trueplant.loop.law import filtered_setpoint, law_of, law_setpoints, rest
from trueplant.loop.loads import Grid, Loads, Outside, from_rest, outside_of
from trueplant.loop.pid import PID
from trueplant.loop.signals import signal_of
from trueplant.loop.valve import Valve, parameters_of
from trueplant.lti.sampled import sampled_response
from trueplant.lti.transfer import TransferMatrix


@dataclass(frozen=True, eq=False)
class Simulation:
    """A simulated record; time first. u is held from each instant to the next.

    r, y (measured), y_true, v: (N, n_y); u, w: (N, n_u); d: (N, n_d). y_true is without measurement noise, quantisation
    and spikes; v is all that acts on y besides the plant: output disturbances and Gd d. w is what was added to OP
    behind the valves, d the measured disturbances.
    """

    t: Array
    r: Array
    u: Array
    y: Array
    y_true: Array
    v: Array
    w: Array
    d: Array
    y_model: Array | None = None
    """(N, n_y) what the model makes of OP and d; None where no model was given."""

    @property
    def e(self) -> Array:
        """(N, n_y) y less y_model, the paper's residual. Raises LoopError where no model was given."""
        if self.y_model is None:
            raise LoopError("simulate was given no model to compare the plant with: add model = ...")
        return np.asarray(self.y - self.y_model)

    @property
    def h(self) -> float:
        """Sample time of the record."""
        return float(self.t[1] - self.t[0]) if self.t.size > 1 else 0.0


def _measurement(
    noise: ArrayLike | None, spikes: tuple[float, float] | None, shape: tuple[int, int], seed: int
) -> tuple[Array, Array]:
    """Measurement noise and spikes (N, n_y); each has its own stream of random numbers."""
    streams = np.random.default_rng(seed).spawn(2)
    noisy, outliers = signal_of(noise, shape, "noise"), np.zeros(shape)
    if noise is not None and np.ndim(noise) < 2:
        if np.any(noisy < 0):
            raise LoopError("a standard deviation of noise must not be below 0")
        noisy = noisy * streams[0].standard_normal(shape)
    if spikes is not None:
        probability, size = spikes
        hit = streams[1].random(shape) < probability
        outliers = np.where(hit, size * streams[1].standard_normal(shape), 0.0)
    return noisy, outliers


@dataclass(frozen=True, eq=False)
class _Surroundings:
    """All that acts on a loop besides its controller: first axis time, but for quantum, limits and operating point."""

    added: Array
    """(N, n_y) on PV, held from one instant to the next: disturbances and noise."""
    smooth: Array
    """(N, n_y) on PV, running on between the instants: what loads make of it by way of a model or of the plant."""
    spikes: Array
    """(N, n_y)"""
    quantum: Array
    """(n_y,) of each PV, 0 for none."""
    behind: Array
    """(N, n_u) added to OP behind the valves, held from one instant to the next."""
    limits: Array
    """(n_u, 2) of OP."""
    u0: Array
    """(n_u,) operating point."""
    y0: Array
    """(n_y,)"""
    valves: Array
    """(n_u, 4) backlash, stick and both ends of each valve."""


def _wide(limits: ArrayLike | None, controller: Controller | None, n_u: int) -> Array:
    if limits is None:
        return controller.limits if controller else np.tile([-np.inf, np.inf], (n_u, 1))
    bounds = np.broadcast_to(np.asarray(limits, dtype=float), (n_u, 2)).copy()
    if not np.all(bounds[:, 0] < bounds[:, 1]):
        raise LoopError("limits must be (low, high) for each input, with low below high")
    return bounds


def simulate(
    plant: TransferMatrix,
    controller: Controller | None,
    r: ArrayLike,
    h: float,
    *,
    u: ArrayLike | None = None,
    v: Loads | None = None,
    d: Loads | None = None,
    Gd: TransferMatrix | None = None,
    d_hold: str | Sequence[str] = "zoh",
    input_disturbance: Loads | None = None,
    model: TransferMatrix | None = None,
    noise: ArrayLike | None = None,
    quantisation: ArrayLike | None = None,
    spikes: tuple[float, float] | None = None,
    limits: ArrayLike | None = None,
    valves: Sequence[Valve] | None = None,
    u0: ArrayLike = 0.0,
    y0: ArrayLike = 0.0,
    record_every: int = 1,
    seed: int = 0,
) -> Simulation:
    """Run the loop from rest at the operating point (u0, y0) with set-points r (N, n_y) at steps of h.

    The plant is exact at the instants for the held OP, with dead times of any fraction of h. Sampled
    controllers run at their scan, a multiple of h: nothing is approximated. Continuous ones are run with an OP
    held over each step at its value in the middle of the step, of second order in h: choose h well below the
    plant's and the controller's times, and thin out with record_every. PV is read before OP is written: an element
    without a lag passes on what was written a sample, and its dead time, before.

    u (N, n_u): the OP without a controller. v (N, n_y): disturbances at the output; d (N, n_d) with Gd: measured
    ones, which run between the instants as d_hold says ("zoh" or "linear", one for all or one each);
    input_disturbance (N, n_u): added to OP behind the valves. Each of the three is a signal, held between instants, or
    loads (`trueplant.loop.loads`: Step, Ramp, RandomWalk, Coloured, Filtered), which add up; random ones, and all that
    d consists of, are known at the instants of the record. model (n_y, n_u) or (n_y, n_u + n_d): a model that gets the
    same OP and d, for `Simulation.y_model`.
    noise: standard deviations of white measurement noise, or the noise (N, n_y). quantisation: quantum of each
    PV. spikes: (probability, standard deviation) of single outliers. limits: (low, high) of each OP, instead
    of those that the controller declares. valves: one an input, between OP and plant, at rest on u0. The same seed
    gives the same record.

    Raises LoopError for signals and settings that do not fit, UnstableLoop if the loop runs away.
    """
    n_y, n_u = plant.shape
    setpoints = np.asarray(r, dtype=float)
    if setpoints.ndim != 2 or setpoints.shape[0] == 0:
        raise LoopError(f"r must have shape (N, {n_y}), not {setpoints.shape}")
    if not (np.isfinite(h) and h > 0):
        raise LoopError(f"the step h must be above 0, not {h:g}")
    for name, value, least in (("record_every", record_every, 1), ("seed", seed, 0)):
        if not isinstance(value, Integral) or value < least:
            raise LoopError(f"{name} must be a whole number from {least} on, not {value!r}")
    steps = setpoints.shape[0]
    setpoints = signal_of(setpoints, (steps, n_y), "r")
    start_u = np.broadcast_to(np.asarray(u0, dtype=float), (n_u,)).copy()
    start_y = np.broadcast_to(np.asarray(y0, dtype=float), (n_y,)).copy()
    noisy, outliers = _measurement(noise, spikes, (steps, n_y), seed)
    quantum = signal_of(quantisation, (1, n_y), "quantisation")[0]
    if np.any(quantum < 0):
        raise LoopError("a quantum must not be below 0")
    if (d is None) != (Gd is None):
        raise LoopError("a measured disturbance needs both d and Gd")
    grid, n_d = Grid(steps, h, record_every), 0 if Gd is None else Gd.shape[1]
    outside = outside_of((v, input_disturbance, d), (n_y, n_u, n_d), d_hold, grid, seed)
    (added, on_pv), (behind, straight) = outside.output, outside.input
    if Gd is not None:
        on_pv = on_pv + from_rest(Gd, outside.d, h, outside.hold)
    smooth = on_pv + from_rest(plant, straight, h, "linear") if np.any(straight) else on_pv
    bounds = _wide(limits, controller, n_u)
    fitted = tuple(valves) if valves is not None else (Valve(),) * n_u
    if len(fitted) != n_u:
        raise LoopError(f"valves must be {n_u}, one an input, not {len(fitted)}")
    play = parameters_of(fitted)
    around = _Surroundings(added + noisy, smooth, outliers, quantum, behind, bounds, start_u, start_y, play)
    if controller is None:
        if u is None:
            raise LoopError("without a controller the inputs u (N, n_u) must be given")
        op, measured, moved = _open(plant, signal_of(u, (steps, n_u), "u"), h, fitted, around)
    else:
        if u is not None:
            raise LoopError("give either a controller or the inputs u, not both")
        op, measured, moved = _closed(plant, controller, setpoints, h, around)
    if not (np.all(np.isfinite(measured)) and np.all(np.isfinite(op))):
        raise UnstableLoop("the simulated loop runs away to infinity: check gains, signs and action with check_loop")
    keep = slice(None, None, record_every)
    return Simulation(
        t=np.arange(steps, dtype=float)[keep] * h,
        r=setpoints[keep],
        u=op[keep],
        y=measured[keep],
        y_true=(start_y + moved + added)[keep],
        v=(added + on_pv)[keep],
        w=(behind + straight)[keep],
        d=outside.d[keep],
        y_model=None if model is None else (start_y + _of_model(model, op - start_u, outside, h))[keep],
    )


def _of_model(model: TransferMatrix, u: Array, outside: Outside, h: float) -> Array:
    """(N, n_y) what a model (n_y, n_u) or (n_y, n_u + n_d) makes of OP, and of the measured disturbances."""
    n_u, n_d = u.shape[1], outside.d.shape[1]
    if model.shape[1] not in (n_u, n_u + n_d):
        raise LoopError(f"the model has {model.shape[1]} inputs and must have {n_u}, or {n_u + n_d} with those of d")
    both, holds = np.hstack([u, outside.d]), ("zoh",) * n_u + outside.hold
    return from_rest(model, both[:, : model.shape[1]], h, holds[: model.shape[1]])


def _open(
    plant: TransferMatrix, u: Array, h: float, valves: Sequence[Valve], around: _Surroundings
) -> tuple[Array, Array, Array]:
    """OP within its limits, measured PV and continuous output from the operating point on, without a controller."""
    op = np.clip(u, around.limits[:, 0], around.limits[:, 1])
    at = np.column_stack([valve.positions(op[:, i], around.u0[i]) for i, valve in enumerate(valves)])
    moved = sampled_response(plant, at - around.u0 + around.behind, h) + around.smooth
    measured = around.y0 + moved + around.added
    rounded = np.round(measured / np.where(around.quantum > 0, around.quantum, 1.0)) * around.quantum
    return op, np.where(around.quantum > 0, rounded, measured) + around.spikes, moved


def _closed(
    plant: TransferMatrix, controller: Controller, r: Array, h: float, around: _Surroundings
) -> tuple[Array, Array, Array]:
    """OP, measured PV and continuous output from the operating point on."""
    if (controller.n_u, controller.n_y) != (plant.shape[1], plant.shape[0]):
        raise LoopError(
            f"the controller has {controller.n_u} inputs and {controller.n_y} outputs, the plant {plant.shape[1]} and "
            f"{plant.shape[0]}: they must agree"
        )
    if any(isinstance(e, PID) and e.pv_transform is not None for e in controller.entries.values()):
        raise LoopError("a controller with a pv_transform cannot be simulated: use controller.linearised(pv)")
    law = law_of(controller, h)
    r_mean, r_end = law_setpoints(controller, law, r, h, around.y0)
    at_rest = around.y0[law.j]
    x, integral = rest(law, at_rest, at_rest, around.u0, around.limits)
    given = (getattr(around, f.name) for f in fields(around))
    op, measured, moved = run_loop(terms_of(plant, h), law, r_mean, r_end, *given, x, integral)
    return op, measured, moved


def replay(
    controller: Controller,
    r: ArrayLike,
    y: ArrayLike,
    h: float,
    *,
    first: ArrayLike | None = None,
    bias: ArrayLike = 0.0,
    hold: str = "zoh",
    limits: ArrayLike | None = None,
) -> Array:
    """OP (N, n_u) that the declared controller writes on recorded set-points and PVs (N, n_y), step h.

    first: OP (n_u,) just before the record, which the controller takes over without a bump, at rest on the
    first set-point and PV. Without it all its memory is zero at the start and its integrals are at `bias`
    (n_u,). hold: how the recorded signals run between samples, "zoh" or "linear"; it matters for continuous
    controllers only, which are exact under "zoh" and of second order under "linear".
    """
    if hold not in ("zoh", "linear"):
        raise LoopError(f'hold must be "zoh" or "linear", not {hold!r}')
    pv = np.asarray(y, dtype=float)
    if pv.ndim != 2 or pv.shape[1] != controller.n_y or pv.shape[0] == 0:
        raise LoopError(f"y must have shape (N, {controller.n_y}), not {pv.shape}")
    pv = signal_of(pv, pv.shape, "y")
    sp = signal_of(np.asarray(r, dtype=float), pv.shape, "r")
    law = law_of(controller, h)
    bounds = _wide(limits, controller, controller.n_u)
    n_e = law.i.size
    r_mean, r_end, y_mean, y_end = np.empty((4, n_e, pv.shape[0]))
    for e, entry in enumerate(controller.entries.values()):
        transform = entry.pv_transform if isinstance(entry, PID) else None
        own_r, own_y = sp[:, law.j[e]], pv[:, law.j[e]]
        if transform is not None:
            own_r, own_y = np.asarray(transform(own_r)), np.asarray(transform(own_y))
            if not (np.all(np.isfinite(own_r)) and np.all(np.isfinite(own_y))):
                raise LoopError(f"pv_transform has no finite value for some set-point or PV of output {law.j[e] + 1}")
        own_r = filtered_setpoint(entry, own_r, h, 0.0 if first is None else own_r[0])
        for given, mean, end in ((own_r, r_mean, r_end), (own_y, y_mean, y_end)):
            end[e] = mean[e] = given
            if entry.sample_time is None:
                mean[e, 1:] = given[:-1] if hold == "zoh" else (given[:-1] + given[1:]) / 2
                if first is None:
                    mean[e, 0] = 0.0
    if first is None:
        x = np.zeros((n_e, law.A.shape[1]))
        start = np.broadcast_to(np.asarray(bias, dtype=float), (controller.n_u,))
        integral = np.zeros(n_e)
        for i in range(controller.n_u):
            writers = np.flatnonzero(law.i == i)
            if writers.size:
                integral[writers[np.argmax(law.ki[writers] != 0)]] = start[i]
    else:
        start = np.broadcast_to(np.asarray(first, dtype=float), (controller.n_u,)).copy()
        x, integral = rest(law, r_end[:, 0].copy(), y_end[:, 0].copy(), start, bounds)
    # no time has passed at the first sample of a continuous law
    integral -= np.where(law.sampled, 0.0, law.ki * (r_mean[:, 0] - y_mean[:, 0]))
    u: Array = run_law(law, r_mean, r_end, y_mean, y_end, bounds, x, integral)
    return u
