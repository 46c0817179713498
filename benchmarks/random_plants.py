"""Plants, loops and records drawn at random: what `bench_random_plants.py` runs through an analysis.

Every record is simulated from its half and number alone. Each factor takes its levels in random order, block by
block, so that all come equally often; the structures of the elements are drawn one by one.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from scipy.signal import lfilter

import trueplant as tp
from trueplant.errors import TrueplantError
from trueplant.identify import OutputEstimate, Row, Spec, fit_row, pieces_of
from trueplant.identify.noise import fit_ar
from trueplant.loop import Controller, Simulation, Step, Valve, alternating_steps, simulate, unstable_poles
from trueplant.lti import Structure, TransferFunction, TransferMatrix, to_formula
from trueplant.lti.sampled import sampled_response
from trueplant.notebook.loops import project_of
from trueplant.project import Project
from trueplant.record.types import Segment
from trueplant.result import Element
from trueplant.study.data.controller_check import check_controllers
from trueplant.study.data.excitation import blocked, doubts
from trueplant.study.data.prepare import prepare
from trueplant.study.loops.settled import against_settled_loop
from trueplant.study.pipeline import analyse
from trueplant.study.plant.elements import judge
from trueplant.study.plant.gate import through_the_gate
from trueplant.study.plant.identified import identify
from trueplant.study.plant.updated import updated_plant
from trueplant.study.study import quiet
from trueplant.tune import METHODS, Choices

Array = np.ndarray

FACTORS = {
    "loops": ("1", "2", "3", "4"),
    "plant": ("unchanged", "changed"),
    "moves": ("often", "rarely", "in turn", "at once"),
    "noise": ("white", "AR", "ARMA", "random walk", "1/f"),
    "besides": ("nothing", "load steps", "outliers", "correlated", "Student t"),
    "actuator": ("nothing", "limits", "rounding", "backlash", "stick-slip"),
}
STRUCTURES = ("fopdt", "sopdt", "sopdt+lead", "pair", "integrator+lag", "sopdt+delayed")
STRUCTURE_SHARES = (0.35, 0.15, 0.2, 0.1, 0.1, 0.1)
RULES = ("simc", "improved-simc", "lambda", "imc", "amigo", "tyreus-luyben", "max-ki")
SCALE = 10.0
"""Minutes: what all times are drawn around, unless another number is asked for. Samples are half a minute to two apart:
around one minute most loops answer within a sample or two."""
OPERATING_POINTS = (50.0, 351.5, -18.0, 1210.0)
"""Of PV and set-point of each loop: real ones are no deviations."""
ORDER = 25
"""Of the autoregression that the Cramer-Rao bound takes for the noise."""


@dataclass(frozen=True, eq=False)
class Case:
    """One simulated record with what it was made from."""

    half: int
    number: int
    levels: dict[str, str]
    structures: list[list[Structure]]
    model: list[list[Array]]
    """Parameters that are declared."""
    truth: list[list[Array]]
    law: Controller
    simulation: Simulation
    op_limits: Array | None
    """(n, 2)"""
    noise: Array
    """(N, n): all of PV that the plant does not make of the recorded OP."""

    @property
    def size(self) -> int:
        return len(self.structures)


def levels_of(half: int, number: int) -> dict[str, str]:
    """The level of each factor."""
    found = {}
    for k, (factor, levels) in enumerate(FACTORS.items()):
        block, place = divmod(number, len(levels))
        found[factor] = levels[np.random.default_rng([half, k, block]).permutation(len(levels))[place]]
    return found


@dataclass(frozen=True)
class Sampled:
    """How records are sampled."""

    scale: float = SCALE
    """Minutes that all times are drawn around."""
    finer: int = 1
    """Samples for each that there would be else."""

    @property
    def finely(self) -> bool:
        """Then transmitters have noise of their own, dead times may be short, and controllers are tuned with care."""
        return self.finer > 1


def draw(half: int, number: int, sampled: Sampled = Sampled()) -> Case:
    """The record of this number.

    Plants that no rule can control, and loops that are unstable, are drawn again.
    """
    levels = levels_of(half, number)
    for attempt in range(1000):
        rng = np.random.default_rng([half, number, attempt])
        case = _drawn(half, number, levels, rng, sampled)
        if case is not None:
            return case
    raise RuntimeError(f"nothing stable in 1000 draws for record {number} of half {half}")


def _drawn(half: int, number: int, levels: dict[str, str], rng: np.random.Generator, sampled: Sampled) -> Case | None:
    n, h, scale = int(levels["loops"]), float(rng.choice([0.5, 1.0, 2.0])) / sampled.finer, sampled.scale
    structures = [[Structure.parse(rng.choice(STRUCTURES, p=STRUCTURE_SHARES)) for _ in range(n)] for _ in range(n)]
    model = [[_parameters(rng, structures[i][j], i == j, scale, sampled.finely) for j in range(n)] for i in range(n)]
    truth = [[theta.copy() for theta in row] for row in model]
    if levels["plant"] == "changed":
        i = int(rng.integers(n))
        j = i if rng.random() < 0.6 else int(rng.integers(n))
        truth[i][j] = _changed(rng, structures[i][j], truth[i][j], scale)
    declared, plant = _matrix(structures, model), _matrix(structures, truth)
    law = _law(rng, declared, h, 0.1 * scale if sampled.finely else 0.0)
    if law is None:
        return None
    steps = int(rng.integers(1200, 2400)) * sampled.finer
    r = _moves(rng, levels["moves"], steps, h, n, scale)
    try:
        if unstable_poles(declared, law) or unstable_poles(plant, law):
            return None
        still = simulate(plant, law, r, h)
    except TrueplantError:
        return None
    if np.max(np.abs(still.y)) > 4 * np.max(np.abs(r)):
        return None
    return _record(Case(half, number, levels, structures, model, truth, law, still, None, r), plant, rng, sampled)


def _parameters(
    rng: np.random.Generator, structure: Structure, diagonal: bool, scale: float = SCALE, short: bool = False
) -> Array:
    """Parameters in the order of `Structure.names`; gains of elements off the diagonal are smaller.

    Dead times are a tenth of the scale to all of it, each as likely; where they may be `short`, a hundredth to all of
    it, each ratio as likely.
    """
    size = rng.uniform(1.0, 3.0) * (1.0 if diagonal else rng.uniform(0.15, 0.5)) * rng.choice([-1.0, 1.0])
    lag = scale * np.exp(rng.uniform(np.log(0.5), np.log(2.0)))
    dead = scale * (np.exp(rng.uniform(np.log(0.01), 0.0)) if short else rng.uniform(0.1, 1.0))
    theta = np.zeros(len(structure.names))
    gains = np.flatnonzero(structure.is_gain)
    theta[gains[0]] = size / lag if structure.integrators else size
    if gains.size > 1:
        theta[gains[1]] = -size * rng.uniform(0.3, 0.7)
    lags = np.flatnonzero(structure.is_lag)
    theta[lags] = (lag * np.array([1.0, rng.uniform(0.2, 0.8)]))[: lags.size]
    if structure.integrators:
        theta[lags] *= 0.3
    for at in np.flatnonzero(structure.is_frequency):
        theta[at], theta[at + 1] = 1 / lag, rng.uniform(0.3, 0.9)
    theta[structure.is_lead] = lag * (rng.uniform(0.2, 0.6) if rng.random() < 0.5 else rng.uniform(-0.8, -0.2))
    times = np.flatnonzero(structure.is_dead_time)
    theta[times] = dead * np.array([1.0, 1.0 + rng.uniform(0.5, 1.5)])[: times.size]
    return theta


def _changed(rng: np.random.Generator, structure: Structure, theta: Array, scale: float) -> Array:
    """One kind of its parameters changed: gains, lags, or dead times."""
    out, kind = theta.copy(), rng.choice(["gain", "lag", "dead time"])
    factor = float(np.exp(rng.choice([-1.0, 1.0]) * rng.uniform(np.log(1.2), np.log(1.7))))
    lags = structure.is_lag | structure.is_frequency
    if kind == "lag" and np.any(lags):
        out[lags] *= factor**1.5
    elif kind == "dead time":
        out[structure.is_dead_time] += scale * rng.uniform(0.2, 0.6)
    else:
        out[structure.is_gain] *= factor
    return out


def _matrix(structures: list[list[Structure]], theta: list[list[Array]]) -> TransferMatrix:
    rows = zip(structures, theta, strict=True)
    return TransferMatrix(
        tuple(tuple(s.transfer(p) for s, p in zip(row, values, strict=True)) for row, values in rows), "min"
    )


def _law(rng: np.random.Generator, model: TransferMatrix, h: float, spare: float = 0.0) -> Controller | None:
    """A controller for each diagonal element by a random rule, the slower the more loops there are.

    `spare` is a dead time that it is tuned for besides: else loops of short dead times would multiply PV's noise.
    """
    pids = []
    for k in range(model.shape[0]):
        rule, kind = METHODS[rng.choice(RULES)], rng.choice(["PI", "PID"], p=[0.7, 0.3])
        element = model[k, k] * _delay(h / 2 + spare)
        try:
            pid = rule(element, Choices(kind=kind))
        except TrueplantError:
            return None
        slower = (1.0 + 0.5 * (model.shape[0] - 1)) * rng.uniform(0.8, 1.5)
        Kc, Ti = pid.Kc / slower, pid.Ti
        if not (np.isfinite(Kc) and Kc):
            return None
        pids.append(tp.PID(Kc=float(Kc), Ti=Ti, Td=pid.Td, alpha=pid.alpha, sample_time=h))
    return Controller.diagonal(pids)


def _delay(time: float) -> TransferFunction:
    return tp.tf(f"exp(-{time!r} s)")


def _moves(rng: np.random.Generator, kind: str, steps: int, h: float, n: int, scale: float) -> Array:
    """Set-points (steps, n) of about unit size that begin at rest."""
    mean = rng.uniform(4.0, 8.0) * scale / h
    size = rng.uniform(0.7, 1.5, n)
    if kind == "in turn":
        return alternating_steps(steps, h, mean * h, size)
    first = np.arange(steps) >= 20
    if kind == "rarely":
        r = np.zeros((steps, n))
        for i in range(n):
            up, down = np.sort(rng.uniform([0.05, 0.5], [0.45, 0.9]) * steps)
            r[:, i] = size[i] * ((np.arange(steps) >= up) & (np.arange(steps) < down))
        return r
    together = rng.random((steps, 1)) < 1 / mean
    flips = (
        np.where(together, rng.random((steps, n)) < 0.7, False)
        if kind == "at once"
        else (rng.random((steps, n)) < 1 / mean)
    )
    return np.where(first[:, None] & (np.cumsum(flips & first[:, None], axis=0) % 2 == 1), size, 0.0)


def _noise(
    rng: np.random.Generator, levels: dict[str, str], steps: int, h: float, spread: Array, sampled: Sampled
) -> Array:
    """(steps, n) disturbances of PV, their size relative to that of the moves."""
    n, kind, scale, before = spread.size, levels["noise"], sampled.scale, 1000 * sampled.finer
    e = (
        rng.standard_t(3, (steps + before, n)) / np.sqrt(3)
        if levels["besides"] == "Student t"
        else (rng.standard_normal((steps + before, n)))
    )
    if levels["besides"] == "correlated":
        common = rng.standard_normal((steps + before, 1))
        e = np.sqrt(0.8) * common + np.sqrt(0.2) * e
    pole = np.exp(-h / (scale * rng.uniform(0.2, 1.5)))
    relative = np.exp(rng.uniform(np.log(0.03), np.log(0.3), n)) * spread
    if kind == "random walk":
        # so large that it moves as far in `scale` as the others do
        walk = np.cumsum(e[before:], axis=0) * relative * np.sqrt(h / scale)
        return walk - walk[0]
    a, c = {
        "white": ([1.0], [1.0]),
        "AR": ([1.0, -pole], [1.0]),
        "ARMA": ([1.0, -pole - 0.5, 0.5 * pole], [1.0, -0.3]),
        "1/f": ([1.0], np.cumprod(np.concatenate([[1.0], (np.arange(1, before) - 0.5) / np.arange(1, before)]))),
    }[kind]
    v = lfilter(c, a, e, axis=0)[before:]
    scale = np.sqrt(np.sum(lfilter(c, a, np.eye(1, 5 * before)[0]) ** 2))
    return v / scale * relative


def _record(case: Case, plant: TransferMatrix, rng: np.random.Generator, sampled: Sampled) -> Case | None:
    """The case with a record under its disturbances."""
    still, n = case.simulation, case.size
    steps, h, kind = still.t.size, still.h, case.levels["actuator"]
    spread = np.std(still.y, axis=0)
    v = _noise(rng, case.levels, steps, h, spread, sampled)
    if sampled.finely:
        v += np.std(v, axis=0) * np.exp(rng.uniform(np.log(0.1), 0.0, n)) * rng.standard_normal(v.shape)
    loads = []
    if case.levels["besides"] == "load steps":
        for at in rng.integers(50, steps - 50, 3):
            j = int(rng.integers(n))
            size = rng.choice([-1.0, 1.0]) * rng.uniform(0.2, 0.6) * np.std(still.u[:, j])
            loads.append(Step(at * h, tuple(size * np.eye(n)[j])))
    white = np.std(np.diff(v, axis=0), axis=0)
    spikes = (0.01, 10 * float(np.mean(white))) if case.levels["besides"] == "outliers" else None
    quantum = rng.uniform(0.2, 1.0) * white if kind == "rounding" else None
    limits, valves = None, None
    given = {"v": v, "input_disturbance": loads, "spikes": spikes, "quantisation": quantum, "seed": case.number}
    try:
        free = simulate(plant, case.law, case.noise, h, **given)
        if kind == "limits":
            limits = np.quantile(free.u, [0.05, 0.95], axis=0).T
            if np.any(limits[:, 0] >= 0) or np.any(limits[:, 1] <= 0):
                limits = None
        if kind in ("backlash", "stick-slip"):
            width = rng.uniform(0.01, 0.02) * np.ptp(free.u, axis=0)
            name = "backlash" if kind == "backlash" else "stick"
            valves = [Valve(**{name: float(w)}) for w in width]
        found = simulate(plant, case.law, case.noise, h, limits=limits, valves=valves, **given)
    except TrueplantError:
        return None
    if np.max(np.abs(found.y)) > 20 * np.max(np.abs(still.y)):
        return None
    noise = found.y_true - sampled_response(plant, found.u, h)
    return Case(
        case.half, case.number, case.levels, case.structures, case.model, case.truth, case.law, found, limits, noise
    )


@dataclass(frozen=True)
class Answer:
    """What is said of a record."""

    status: str
    elements: tuple[Element, ...]
    codes: tuple[str, ...]
    """Of reasons and notes."""
    headline: str = ""
    estimates: Mapping[int, OutputEstimate] = field(default_factory=dict)
    """By output."""


def analysed(case: Case, whole: bool) -> Answer:
    """What the whole of `tp.run` says of the case's record, or its stages up to verdicts and causes alone."""
    frame, project = _project(case)
    if not whole:
        return decided(project, frame)
    result = analyse(project, frames=[frame])
    said = (*result.reasons, *result.notes)
    return Answer(str(result.status), result.elements, tuple(sorted({str(r.code) for r in said})), result.headline)


def decided(project: Project, frame: dict[str, Array]) -> Answer:
    """The stages of `tp.run` up to verdicts and causes."""
    study = prepare(project, quiet, [frame])
    reasons, controllers = doubts(study), check_controllers(study)
    if not study.segments or blocked(reasons):
        return Answer("refused", (), tuple(sorted({str(r.code) for r in reasons})))
    identified = against_settled_loop(study, through_the_gate(study, identify(study, quiet)), controllers)
    plant = updated_plant(study.model, identified.estimates)
    judged = judge(study, identified, plant.nominal)
    codes = tuple(sorted({str(reason.code) for reason in judged.causes}))
    status = "ok" if judged.answered else "refused"
    return Answer(status, judged.elements, codes, estimates=identified.estimates)


def _project(case: Case) -> tuple[dict[str, Array], Project]:
    sim, n = case.simulation, case.size
    frame = {"time": sim.t}
    loops = []
    for k in range(n):
        level = OPERATING_POINTS[k]
        frame |= {f"sp{k}": sim.r[:, k] + level, f"op{k}": sim.u[:, k], f"pv{k}": sim.y[:, k] + level}
        limits = None if case.op_limits is None else tuple(case.op_limits[k])
        law = case.law.entries[k, k]
        loops.append(tp.Loop(f"L{k}", pv=f"pv{k}", sp=f"sp{k}", op=f"op{k}", op_limits=limits, controller=law))
    model = {
        (f"L{i}", f"L{j}"): {"tf": to_formula(case.structures[i][j].transfer(case.model[i][j]), 17)}
        for i in range(n)
        for j in range(n)
    }
    return frame, project_of(["record"], loops, model, None, "min", {})


def bounds(case: Case) -> list[list[Array]]:
    """Cramer-Rao covariances (n_p, n_p) of the parameters of each element, the noise's correlation known."""
    sim, n = case.simulation, case.size
    size = sim.t.size
    ones, none = np.ones((size, n), dtype=bool), np.zeros((size, 0))
    segment = Segment(0, sim.h, sim.t, sim.r, sim.u, sim.y, none, ones, ("zoh",) * n)
    found = []
    for i in range(n):
        v = case.noise[:, i] - np.mean(case.noise[:, i])
        ar = fit_ar([v], [np.ones(size, dtype=bool)], ORDER)[0]
        innovation = float(np.var(lfilter(np.concatenate([[1.0], ar]), [1.0], v)[ORDER:]))
        row = Row(tuple(Spec(j, case.structures[i][j]) for j in range(n)), pieces_of([segment], i))
        fit = fit_row(row, np.concatenate(case.truth[i]), ar, iterations=0)
        covariance = fit.covariance / max(fit.variance, 1e-300) * innovation
        found.append([covariance[part, part] for part in row.slices])
    return found
