"""Where plans are tried out: today's loop on plants that the record leaves possible, under its disturbance."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import lfilter

from trueplant.arrays import Array
from trueplant.errors import LoopError, TrueplantError
from trueplant.identify import OutputEstimate
from trueplant.loop import Controller, LinearLoop, simulate, unstable_poles
from trueplant.lti import TransferMatrix, UncertainPlant
from trueplant.lti.sampled import sampled_response
from trueplant.project.simulated import Simulate
from trueplant.project.simulation import steps_per_sample
from trueplant.record import Segment
from trueplant.study import levels
from trueplant.study.study import Study


@dataclass(frozen=True, eq=False)
class Bench:
    """The loop in deviations from today's operating point."""

    plant: TransferMatrix
    """(n_y, n_u)"""
    controller: Controller | None
    """None: OP is moved by hand, in open loop."""
    h: float
    every: int
    """Steps of the simulator in one sample."""

    @property
    def channels(self) -> int:
        return self.plant.shape[0 if self.controller else 1]

    def run(self, moves: Array, noise: Array | None = None) -> tuple[Array, Array]:
        """(y, u) at the samples; moves (N, channels) of the set-points, of OP in open loop; noise (N, n_y) on PV.

        OP has no limits here: a plan is to keep away from them.
        """
        n_y, n_u = self.plant.shape
        free = np.tile([-np.inf, np.inf], (n_u, 1))
        fine = np.repeat(moves, self.every, axis=0)
        v = None if noise is None else np.repeat(noise, self.every, axis=0)
        h = self.h / self.every
        if self.controller is None:
            still = np.zeros((len(fine), n_y))
            sim = simulate(self.plant, None, still, h, u=fine, v=v, limits=free, record_every=self.every)
        else:
            sim = simulate(self.plant, self.controller, fine, h, v=v, limits=free, record_every=self.every)
        return sim.y, sim.u


@dataclass(frozen=True, eq=False)
class Room:
    """How far PVs, then OPs may go from where they are now."""

    names: tuple[str, ...]
    """(n_y + n_u,) "PV of ...", "OP of ..."."""
    low: Array
    high: Array
    shown: tuple[str, ...]
    """Those without declared limits: the range that the record shows, widened, takes their place."""

    def share(self, still: Array, moved: Array) -> tuple[float, str]:
        """The largest share of moves that keeps within, and what limits it.

        still, moved (N, n_y + n_u): what the disturbance does to the signals by itself, and the moves.
        """
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            ahead = np.where(moved > 0, self.high - still, self.low - still) / moved
        shares = np.where(moved == 0, np.inf, ahead).min(axis=0, initial=np.inf)
        shares = np.where(((still > self.high) | (still < self.low)).any(axis=0), 0.0, np.maximum(shares, 0.0))
        at = int(np.argmin(shares))
        return float(shares[at]), self.names[at]


@dataclass(frozen=True, eq=False)
class Rest:
    """Where PVs and OPs come to rest if set-points (OP in open loop) stay as they are at the end of the records."""

    now: Array
    """(n_y + n_u,)"""
    before: Array
    """(n, n_y + n_u) the same at other times of the record, up to a constant: it wanders with disturbances, and with
    what the plant does otherwise than this one. 0 for what does not wander: set-points, OP in open loop."""
    settling: Array
    """(n, n_y + n_u) the way there, after the last moves of the record."""

    @classmethod
    def of(cls, study: Study, bench: Bench, slowest: float) -> Rest:
        """What the moves of the records do is taken off, as this plant would have it; a level stays where it is."""
        segment = _last(study)
        segment = segment.part(max(0, len(segment) - int(levels.LONGEST_PLAN * slowest / segment.h)))
        driven = segment.u if bench.controller is None else segment.r
        known = np.isfinite(driven).all(axis=0)
        moves = np.where(known, driven - driven[-1], 0.0)
        settled = segment.u if bench.controller is None else segment.setpoints
        still = _still_for(np.where(known, settled - settled[-1], 0.0), slowest / segment.h)
        more, late = int(levels.SETTLING * slowest / segment.h), still
        course = np.vstack([np.tile(moves[0], (more, 1)), moves, np.zeros((more, bench.channels))])
        moved = np.hstack(bench.run(course))[more:]
        left = np.hstack([segment.y, segment.u]) - moved[: len(segment)]
        now = _means(left, late)[-1] + moved[-1]
        before = _means(left, max(2, int(levels.WANDERS * slowest / segment.h)))
        n_y = segment.y.shape[1]
        fixed = np.concatenate([np.full(n_y, False), np.full(segment.u.shape[1], True)])
        held = np.concatenate([np.zeros(n_y), segment.u[-1]])
        if bench.controller is not None:
            fixed = np.concatenate([known, np.full(segment.u.shape[1], False)])
            held = np.concatenate([segment.r[-1], np.zeros(segment.u.shape[1])])
        return cls(np.where(fixed, held, now), np.where(fixed, 0.0, before), moved[len(segment) :] - moved[-1])

    def wandered(self, samples: int, rng: np.random.Generator) -> Array:
        """(n_y + n_u,) by how much it differed between two times of the record; in a longer time it may by more."""
        one, other = rng.integers(len(self.before), size=2)
        longer = max(1.0, np.sqrt(samples / len(self.before)))
        return np.asarray(longer * (self.before[one] - self.before[other]))


@dataclass(frozen=True, eq=False)
class Trial:
    """A plant that is possible, and what a disturbance alone does to its loop."""

    bench: Bench
    still: Array
    """(N, n_y + n_u)"""

    @classmethod
    def of(cls, bench: Bench, noise: Array, rest: Rest, away: Array | float = 0.0) -> Trial:
        """`away` (n_y + n_u,): where the signals rest, on this plant, from where they do on the one estimated."""
        still = np.hstack(bench.run(np.zeros((len(noise), bench.channels)), noise)) + away
        still[: len(rest.settling)] += rest.settling[: len(still)]
        return cls(bench, still)

    def share(self, moves: Array, room: Room) -> tuple[float, str]:
        """The largest share of moves (N, channels) that keeps the limits, and what limits it.

        Within its limits the loop is linear, so that answers to moves and to the disturbance add up.
        """
        still = np.resize(self.still, (len(moves), self.still.shape[1]))
        return room.share(still, np.hstack(self.bench.run(moves)))


@dataclass(frozen=True, eq=False)
class Stand:
    """Today's loop, what is allowed, and what it is tried on."""

    bench: Bench
    """On the plant as estimated."""
    room: Room
    slowest: float
    """Lag and dead time of the slowest element that is known."""
    today: Trial
    """On the plant as estimated."""
    trials: tuple[Trial, ...]
    """On plants drawn."""

    def share(self, moves: Array) -> tuple[float, str]:
        """The largest share of moves (N, channels) that keeps the limits on all plants drawn, and what limits it."""
        return min((trial.share(moves, self.room) for trial in self.trials), key=lambda found: found[0])


def bench_of(study: Study, plant: TransferMatrix, loop: LinearLoop | None) -> Bench:
    """Today's loop on a plant (n_y, n_u). Raises LoopError where it cannot be simulated."""
    project, h = study.project, study.segments[0].h
    if loop is None:
        return Bench(plant, None, h, 1)
    scans = [law.sample_time for law in project.controllers if law.sample_time is not None]
    whole = [scan * max(1, round(h / scan)) for scan in scans]
    if whole and abs(whole[0] / h - 1) < levels.WHOLE_SCAN:
        h = whole[0]  # stamps may be rounded, scans are not
    return Bench(plant, loop.controller, h, steps_per_sample(project, Simulate(duration=10 * h, sample_time=h), plant))


def stand_of(
    study: Study,
    estimates: Mapping[int, OutputEstimate],
    bench: Bench,
    possible: UncertainPlant,
    span: tuple[float, int],
    unsure: Collection[int],
) -> Stand:
    """`span`: lag and dead time of the slowest element, and the samples that a plan may have at most; `unsure`: outputs
    of which an element that matters is hardly known.

    Raises LoopError where today's loop is stable on hardly a plant that is possible.
    """
    if not _settles(bench):
        raise LoopError("with the controllers as declared the loops would run away on the plant as estimated")
    slowest, samples = span
    rest = Rest.of(study, bench, slowest)
    room, drift = _room(study, rest.now), np.arange(samples)[:, None] * _drift(study, bench)
    rng = np.random.default_rng(study.project.analysis.seed)
    least = _scatter(study, bench, unsure)
    today = Trial.of(bench, _disturbance(study, estimates, least, samples, rng) + drift, rest)
    drawn = possible.draw(levels.DRAWN_AT_MOST * levels.PLANS_TRIED_ON, study.project.analysis.seed)
    trials: list[Trial] = []
    for k in range(drawn.count):
        if len(trials) == levels.PLANS_TRIED_ON:
            break
        own = replace(bench, plant=drawn.plant(k))
        if _settles(own):
            there = Rest.of(study, own, slowest)
            away = there.now - rest.now + there.wandered(samples, rng)
            trials.append(Trial.of(own, _disturbance(study, estimates, least, samples, rng) + drift, there, away))
    if len(trials) < levels.FEWEST_TRIED_ON:
        raise LoopError(
            "with the controllers as declared the loops would run away on nearly all plants that these data leave "
            "possible"
        )
    return Stand(bench, room, slowest, today, tuple(trials))


def _settles(bench: Bench) -> bool:
    try:
        return bench.controller is None or unstable_poles(bench.plant, bench.controller) == 0
    except TrueplantError:
        return False


def _last(study: Study) -> Segment:
    """The last stretch of the experiment that stands for today's loop; without one the last of all."""
    k = study.loop_experiment
    return [s for s in study.segments if k in (None, s.experiment)][-1]


def _scatter(study: Study, bench: Bench, unsure: Collection[int]) -> dict[int, float]:
    """Standard deviation of what these PVs did in the last record that the loop does not answer to its set-points.

    A fit that hardly knows the plant takes much of the disturbance for the plant's doing. In open loop all that PV did
    may be disturbance.
    """
    segment = _last(study)
    answer = np.zeros(segment.y.shape)
    if bench.controller is not None:
        answer = bench.run(np.nan_to_num(segment.r - segment.r[0]))[0]
    ok = np.isfinite(segment.y)
    return {i: float(np.std((segment.y - answer)[ok[:, i], i])) if ok[:, i].any() else 0.0 for i in unsure}


def _disturbance(
    study: Study,
    estimates: Mapping[int, OutputEstimate],
    least: Mapping[int, float],
    samples: int,
    rng: np.random.Generator,
) -> Array:
    """(samples, n_y) noise as the models of the estimated outputs say, and what measured disturbances do.

    These run as they did in the record, from a random instant on; of an output that was not estimated all of its
    scatter is taken for noise. `least`: standard deviations of outputs at least.
    """
    segment = _last(study)
    out = np.zeros((samples, study.model.shape[0]))
    for i in range(out.shape[1]):
        estimate = estimates.get(i)
        if estimate is None:
            known = segment.y[np.isfinite(segment.y[:, i]), i]
            out[:, i] = (known.std() if known.size else 0.0) * rng.standard_normal(samples)
            continue
        fit, stride = estimate.fit, estimate.row.stride
        e = np.sqrt(fit.variance) * rng.standard_normal(-(-samples // stride) + levels.BURN_IN)
        colour, drifts = _with_drift(fit.ar, max(len(s) for s in study.segments) / stride)
        v = lfilter([1.0], colour, e)[levels.BURN_IN :]
        v = v - v[0] if drifts else v
        larger = max(levels.LARGER_DISTURBANCE, least.get(i, 0.0) / max(float(v.std()), 1e-300))
        out[:, i] = larger * np.repeat(v, stride)[:samples]
    if segment.d.shape[1]:
        course = np.roll(segment.d - segment.d.mean(axis=0), int(rng.integers(len(segment))), axis=0)
        repeated = np.resize(course, (samples, course.shape[1]))
        out += sampled_response(study.model.columns(study.n_u), repeated, segment.h)
    return out


def _with_drift(ar: Array, samples: float) -> tuple[Array, bool]:
    """The denominator of a noise model, and whether it drifts: noise that is slow beside the record may have no end."""
    roots = np.roots(np.r_[1.0, ar])
    slow = np.abs(roots) > np.exp(-1 / (levels.SLOW_NOISE * samples))
    if not slow.any():
        return np.r_[1.0, ar], False
    return np.real(np.poly(np.where(slow, roots / np.abs(roots), roots))), True


def _room(study: Study, now: Array) -> Room:
    """What the declared limits leave from where the loop is `now` (n_y + n_u,); the range shown, widened, without."""
    project = study.project
    of_op = project.experiments[_last(study).experiment].limits
    now_y, now_u = np.split(now, [len(project.outputs)])
    entries = [
        *((f"PV of {o.name}", o.limits, o.span, o.unit, now_y[i], [s.y[:, i] for s in study.segments])
          for i, o in enumerate(project.outputs)),
        *((f"OP of {o.name}", of_op[j], o.span, o.unit, now_u[j], [s.u[:, j] for s in study.segments])
          for j, o in enumerate(project.inputs)),
    ]  # fmt: skip
    low, high, shown = [], [], []
    for name, limits, span, unit, at, courses in entries:
        if limits is None:
            shown.append(name)
            limits = _shown(courses, span or (levels.PERCENT if unit == "%" else None))
        low.append(limits[0] - at)
        high.append(limits[1] - at)
    return Room(tuple(name for name, *_ in entries), np.array(low), np.array(high), tuple(shown))


def _shown(courses: Sequence[Array], span: tuple[float, float] | None) -> tuple[float, float]:
    """The range of a signal in the records, widened, within its instrument's span unless the records leave that."""
    values = np.concatenate([course[np.isfinite(course)] for course in courses])
    low, high = (float(values.min()), float(values.max())) if values.size else (0.0, 0.0)
    more = levels.SHOWN_WIDENED * (high - low)
    bottom, top = span or (-np.inf, np.inf)
    inside = bottom <= low and high <= top
    return (max(low - more, bottom), min(high + more, top)) if inside else (low - more, high + more)


def _drift(study: Study, bench: Bench) -> Array:
    """(n_y,) by which a level moves in a sample with OP where it is, in manual: nobody need have left it balanced."""
    segment, out = _last(study), np.zeros(bench.plant.shape[0])
    integrating = [
        i for i, row in enumerate(bench.plant.elements) if any(np.any(e.poles == 0) for e in row if not e.is_zero)
    ]
    if bench.controller is None and integrating:
        left = segment.y - bench.run(segment.u - segment.u[-1])[0]
        for i in integrating:
            ok = np.isfinite(left[:, i])
            out[i] = np.polyfit(np.flatnonzero(ok), left[ok, i], 1)[0] if ok.sum() > 2 else 0.0
    return out


def _still_for(moves: Array, slowest: float) -> int:
    """Samples at the end that come well after the last move, within what is neither too few nor too long ago."""
    moving = np.flatnonzero(np.any(moves != 0, axis=1))
    since = len(moves) - 1 - (int(moving[-1]) if moving.size else -1)
    within = np.clip(since - levels.WELL_AFTER * slowest, levels.LATELY[0] * slowest, levels.LATELY[1] * slowest)
    return max(2, int(within))


def _means(x: Array, window: int) -> Array:
    """(n, columns) means of x (N, columns) over every window of so many samples, of those that are known."""
    ok, window = np.isfinite(x), min(window, len(x))
    sums, counts = (np.vstack([np.zeros(x.shape[1]), np.cumsum(v, axis=0)]) for v in (np.where(ok, x, 0.0), ok))
    return np.asarray((sums[window:] - sums[:-window]) / np.maximum(counts[window:] - counts[:-window], 1))
