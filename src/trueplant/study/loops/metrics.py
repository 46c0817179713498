"""What a set of controllers does to the loops: on model and plant, under noise and the record's own disturbance."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trueplant.arrays import Array, ComplexArray
from trueplant.errors import LoopError
from trueplant.identify import OutputEstimate, pieces_of
from trueplant.loop import Controller, Linear, simulate
from trueplant.lti import DrawnPlants, TransferMatrix
from trueplant.result import (
    DrawnShares,
    LoopMetrics,
    MsQuantiles,
    MuPeak,
    NoiseMetrics,
    ReplayMetrics,
    StepResponseMetrics,
)
from trueplant.robust import Full, generalised_plant, mu, robust_performance
from trueplant.robust.generalised import uncertainty_blocks
from trueplant.study import levels
from trueplant.study.plant.fit import simulate_row
from trueplant.study.plant.identified import Identified
from trueplant.study.study import Place, Study
from trueplant.tune import StepMetrics, loop_metrics, step_response
from trueplant.tune.drawn import Peaks, peaks


@dataclass(frozen=True, eq=False)
class Disturbance:
    """What acted on the PVs of one stretch of a record besides OP: v = y - G u, and the set-points' moves."""

    experiment: str
    h: float
    r: Array
    """(N, n_y), 0 at the start."""
    v: Array
    """(N, n_y), measurement noise and measured disturbances in it."""
    error: Array
    """(N, n_y) r - y as recorded."""


def recovered(study: Study, found: Identified, plant: TransferMatrix) -> Disturbance | None:
    """From the longest usable stretch of the experiment whose controller stands for today's; None without one.

    plant: (n_y, n_u), without measured disturbances.
    """
    k = study.loop_experiment
    segments = () if k is None else found.of_experiment(k)
    if k is None or not segments:
        return None
    segment = max(segments, key=len)
    if not np.isfinite(segment.r).all():
        return None
    left = []
    for i in range(plant.shape[0]):
        pieces = pieces_of([segment], i)
        if len(pieces) != 1 or pieces[0].y.size != len(segment):
            return None
        value = pieces[0].y - simulate_row(plant, i, pieces[0])
        ok = np.isfinite(value) & pieces[0].valid
        left.append(np.interp(segment.t, segment.t[ok], value[ok]) if ok.any() else np.zeros(len(segment)))
    v, error = np.column_stack(left), segment.r - segment.y
    for i, row in enumerate(plant.elements):
        if any(np.any(element.poles == 0) for element in row):
            # the level that an integrator begins with is no disturbance
            v[:, i] -= v[0, i] + (error[0, i] if np.isfinite(error[0, i]) else 0.0)
    return Disturbance(study.project.experiments[k].name, segment.h, segment.r - segment.r[0], v, error)


@dataclass(frozen=True, eq=False)
class Surroundings:
    """What all controllers are judged under."""

    noise: Array
    """(n_y,) standard deviation of the noise on each PV."""
    disturbance: Disturbance | None
    weights: tuple[Any, Any] | None
    """wI and wP, where both are declared."""
    step: float
    """Simulation step for continuous controllers."""


def loop_metrics_of(
    plant: TransferMatrix, controller: Controller, place: Place, around: Surroundings, mu: MuPeak | None
) -> LoopMetrics:
    """Metrics of the loop at (input, output), the others closed; `docs/result.md` says what they are."""
    i, j = place
    try:
        found = loop_metrics(plant, controller, output=j, input=i)
    except LoopError as error:
        return LoopMetrics(False, str(error), mu=mu)
    m = found.margins
    return LoopMetrics(
        stable=True,
        Ms=_finite(m.Ms),
        Mt=_finite(m.Mt),
        gain_margin=_finite(m.gain_margin),
        phase_margin=_finite(m.phase_margin),
        delay_margin=_finite(m.delay_margin),
        crossover=_finite(m.phase_margin_frequency),
        setpoint=replace(_step(found.setpoint), overshoot=found.setpoint.peak),
        load=replace(_step(found.load), peak=found.load.peak),
        noise=_noise(plant, controller, i, j, around),
        replay=_replay(plant, controller, i, j, around),
        mu=mu,
    )


def _step(step: StepMetrics) -> StepResponseMetrics:
    return StepResponseMetrics(step.iae, step.itae, step.ise, step.total_variation, step.settling)


def mu_peak(plant: TransferMatrix, controller: Controller, around: Surroundings) -> MuPeak | None:
    """mu of robust performance under the declared weights."""
    if around.weights is None:
        return None
    found = robust_performance(plant, controller, *around.weights).RP
    return MuPeak(found.lower, found.upper, found.frequency)


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def simulation_step(controller: Controller, wanted: float) -> float:
    """No longer than wanted, and a whole part of the scan."""
    scans = [entry.sample_time for entry in controller.entries.values() if entry.sample_time is not None]
    return wanted if not scans else min(scans) / math.ceil(min(scans) / wanted * (1 - 1e-9))


def _noise(plant: TransferMatrix, controller: Controller, i: int, j: int, around: Surroundings) -> NoiseMetrics | None:
    """What white noise on all PVs, one value a scan (or a sample of the record), makes of OP."""
    h = simulation_step(controller, around.step)
    still = np.zeros((levels.NOISE_STEPS, plant.shape[0]))
    wide = np.tile([-np.inf, np.inf], (plant.shape[1], 1))
    try:
        done = simulate(plant, controller, still, h, noise=around.noise, limits=wide, seed=1)
    except LoopError:
        return None
    late = done.u[levels.NOISE_STEPS // 5 :, i]
    return NoiseMetrics(float(around.noise[j]), *_moves(late, h))


def _moves(u: Array, h: float) -> tuple[float, float]:
    """Standard deviation of OP, and its total variation per time unit."""
    return float(np.std(u)), float(np.sum(np.abs(np.diff(u))) / (h * (u.size - 1)))


def replayed(plant: TransferMatrix, controller: Controller, around: Surroundings) -> tuple[Array, Array, Array] | None:
    """t (n,), r - y (n, n_y) and OP (n, n_u), from its start, had this controller met the record's disturbance."""
    seen = around.disturbance
    if seen is None:
        return None
    h = simulation_step(controller, min(seen.h, around.step))
    end = seen.h * (len(seen.v) - 1)
    if end / h > levels.REPLAY_STEPS:
        return None
    t = h * np.arange(int(end / h + 1e-9) + 1)
    recorded = seen.h * np.arange(len(seen.v))
    v = np.column_stack([np.interp(t, recorded, column) for column in seen.v.T])
    r = seen.r[np.minimum((t / seen.h + 1e-9).astype(int), len(seen.r) - 1)]
    wide = np.tile([-np.inf, np.inf], (plant.shape[1], 1))
    try:
        done = simulate(plant, controller, r, h, v=v, limits=wide)
    except LoopError:
        return None
    return done.t, done.r - done.y_true, done.u


def _replay(
    plant: TransferMatrix, controller: Controller, i: int, j: int, around: Surroundings
) -> ReplayMetrics | None:
    found = replayed(plant, controller, around)
    if found is None or around.disturbance is None:
        return None
    t, error, u = found
    seen = around.disturbance
    # at the instants of the record, as it is drawn: between them there is less of the disturbance's own noise
    recorded = np.interp(seen.h * np.arange(len(seen.v)), t, error[:, j])
    return ReplayMetrics(
        seen.experiment,
        float(t[-1]),
        float(np.trapezoid(np.abs(error[:, j]), t)),
        float(np.sqrt(np.mean(recorded**2))),
        *_moves(u[:, i], float(t[1])),
    )


# -- over the drawn plants ------------------------------------------------------------------------------------------


def drawn_peaks(response: ComplexArray, controller: Controller, w: Array) -> Peaks | None:
    """Of all loops on all drawn plants; None for a controller that is unstable by itself."""
    laws = [entry.tf for entry in controller.entries.values() if isinstance(entry, Linear)]
    if any(np.any(law.poles.real > 1e-9) for law in laws):
        return None
    return peaks(response, controller(1j * w), w)


def drawn_shares(
    found: Peaks | None, loop: int, loops: Sequence[int], limit: float, seed: int, mu_share: float | None
) -> DrawnShares | None:
    """Shares and quantiles for one loop; `loops` are the inputs of all."""
    if found is None:
        return None
    within = found.within(limit)
    ms = np.where(found.stable, found.Ms[:, loop], np.inf)
    quantiles = np.quantile(ms, [0.05, 0.5, 0.95], method="higher")
    return DrawnShares(
        count=int(found.stable.size),
        seed=seed,
        share=float(np.mean(within[:, loop])),
        share_all=float(np.mean(within[:, list(loops)].all(axis=1))),
        stable=found.share_stable,
        Ms=MsQuantiles(*(_finite(float(q)) for q in quantiles)),
        mu_share=mu_share,
    )


def share_below_mu(
    drawn: DrawnPlants, controller: Controller, stable: NDArray[np.bool_], w: Array, limit: float, around: Surroundings
) -> float | None:
    """Share of the first drawn plants that are stable with mu of robust performance at or below the limit."""
    if around.weights is None:
        return None
    count, n_u = min(levels.MU_DRAWS, drawn.count), controller.n_u
    points = np.geomspace(w[0], w[-1], levels.MU_POINTS)
    plants = [drawn.plant(k) for k in range(count)]
    cut = [plant.columns(0, n_u) for plant in plants]
    N = np.concatenate([generalised_plant(plant, controller, *around.weights, 1j * points) for plant in cut])
    blocks = (*uncertainty_blocks(cut[0].shape, "input"), Full(cut[0].shape[0]))
    highest = mu(N, blocks).upper.reshape(count, -1).max(axis=1)
    return float(np.mean(stable[:count] & (highest <= limit)))


def band(
    plants: Sequence[TransferMatrix],
    controller: Controller,
    place: tuple[int, int],
    step: Any,
    t: Array,
    h: float,
    tails: tuple[float, float],
) -> tuple[Array, Array]:
    """PV and OP (n_t, 3) after a unit step: low, on the first plant, high; low and high over the others."""
    i, j = place
    h = simulation_step(controller, h)
    count = int(np.ceil(t[-1] / h)) + 2
    rows_y, rows_u = [], []
    for plant in plants:
        try:
            at, error, u = step_response(plant, controller, step, h, count, output=j, input=i)
        except LoopError:
            continue
        y = (1.0 if step == "set-point" else 0.0) - error
        rows_y.append(np.interp(t, at, y))
        rows_u.append(np.interp(t, at, u))
    if not rows_y:
        return np.full((t.size, 3), np.nan), np.full((t.size, 3), np.nan)
    out = []
    for rows in (np.array(rows_y), np.array(rows_u)):
        low, high = np.quantile(rows, tails, axis=0)
        out.append(np.column_stack([low, rows[0], high]))
    return out[0], out[1]


def prediction_errors(study: Study, estimates: Mapping[int, OutputEstimate]) -> Array:
    """(n_y,) prediction error of each output, 0 where it was not estimated."""
    sizes = [float(np.sqrt(estimates[i].fit.variance)) if i in estimates else 0.0 for i in range(study.model.shape[0])]
    return np.array(sizes)
