"""How much more data: the moves that would settle what an analysis had to leave open.

Plans are tried out on the plant as estimated, in the loop as declared and within its limits. What each would tell is
the Fisher information of its noise-free record under the noise model that was found, on top of what is known. What
noise stirs up by itself is not counted.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import norm

from trueplant.arrays import Array
from trueplant.errors import LoopError
from trueplant.identify import OutputEstimate, unanswered
from trueplant.lti import TransferMatrix
from trueplant.project.simulated import Simulate
from trueplant.project.simulation import steps_per_sample
from trueplant.result import MoreData, PlannedMove, Settled
from trueplant.result.plan_words import plan_sentence
from trueplant.study import levels
from trueplant.study.experiment.moves import Bench, Moves, Plan, combined, fit_at, information, pattern, simulated_noise
from trueplant.study.study import Study


@dataclass(frozen=True)
class Open:
    """A parameter that is not known well enough."""

    output: int
    column: int
    index: int
    name: str
    unit: str
    value: float
    wanted: float
    """Half-width of its interval."""
    now: float


def more_data(study: Study, estimates: Mapping[int, OutputEstimate], plant: TransferMatrix) -> tuple[MoreData, ...]:
    """Plans that would settle what is open, the shortest first, as result.json has them; empty where nothing is open.

    Where no plan suffices within the longest time looked at, the one that comes closest is given and says so.
    """
    confidence = study.project.analysis.confidence
    asked = _open_parameters(study, estimates, confidence)
    if not asked:
        return ()
    try:
        bench = _bench(study, estimates, plant)
    except LoopError as error:
        return (MoreData(f"no moves could be planned: {error}"),)
    plans = _plans(study, estimates, bench, asked, confidence)
    best: dict[tuple[int, ...], Plan] = {}
    for plan in plans:
        key = tuple(plan.moves.size)
        if key not in best or _rank(plan, asked) < _rank(best[key], asked):
            best[key] = plan
    ranked = sorted(best.values(), key=lambda plan: _rank(plan, asked))
    enough = [plan for plan in ranked if plan.suffices] or ranked[:1]
    return tuple(_entry(study, bench, plan, asked) for plan in enough)


def _rank(plan: Plan, asked: Sequence[Open]) -> tuple[bool, float, int]:
    """Plans that suffice by their length, fewer loops first where equal; others by how far they fall short."""
    short = max(then / one.wanted for then, one in zip(plan.then, asked, strict=True))
    return (not plan.suffices, plan.length if plan.suffices else short, len(plan.moves.size))


def _open_parameters(study: Study, estimates: Mapping[int, OutputEstimate], confidence: float) -> list[Open]:
    z = float(norm.ppf(0.5 + confidence / 2))
    project, found = study.project, []
    for i, estimate in estimates.items():
        if not _data_can_help(estimate):
            continue
        reasons = unanswered(estimate)
        theta = fit_at(estimate, reasons).theta
        sigma = np.sqrt(np.diag(estimate.covariance))
        for spec, part in zip(estimate.row.specs, estimate.row.slices, strict=True):
            if spec.column >= len(project.inputs):
                continue  # nobody moves a disturbance
            structure, p = spec.structure, theta[part]
            units = structure.units(project.outputs[i].unit, project.inputs[spec.column].unit, project.time_unit)
            for k, name in enumerate(structure.names):
                index = part.start + k
                model = abs(spec.initial[k]) if spec.initial is not None else 0.0
                size = max(abs(p[k]), model if structure.is_gain[k] else 0.0)
                size += structure.lag(p) if structure.is_dead_time[k] else 0.0
                low, high = estimate.intervals[index]
                now = max(z * float(sigma[index]), (high - low) / 2 if np.isfinite(high - low) else np.inf)
                hopeless = index in reasons and not reasons[index].why.more_data_helps
                if size > 0 and not hopeless and (index in reasons or now > levels.WANTED_PRECISION * size):
                    value, wanted = float(p[k]), float(levels.WANTED_PRECISION * size)
                    found.append(Open(i, spec.column, index, name, units[k], value, wanted, float(now)))
    return found


def _data_can_help(estimate: OutputEstimate) -> bool:
    """Not where runs of the plant differ, or the structure is too simple: there more of the same narrows nothing."""
    return not estimate.disputed and not estimate.undermodelled


def _bench(study: Study, estimates: Mapping[int, OutputEstimate], plant: TransferMatrix) -> Bench:
    """Raises LoopError where the loop cannot be simulated."""
    project = study.project
    own, loop = plant.columns(0, study.n_u), study.loop(plant)
    h = study.segments[0].h
    samples = int(min(50 * _slowest(study, estimates) / h, 20_000)) + 100
    noise = simulated_noise(study, estimates, samples, project.analysis.seed)
    if loop is None:
        return Bench(own, None, h, 1, noise)
    scans = [law.sample_time for law in project.controllers if law.sample_time is not None]
    whole = [scan * max(1, round(h / scan)) for scan in scans]
    if whole and abs(whole[0] / h - 1) < 0.01:
        h = whole[0]  # stamps may be rounded, scans are not
    every = steps_per_sample(project, Simulate(duration=10 * h, sample_time=h), own)
    return Bench(own, loop.controller, h, every, noise)


def _slowest(study: Study, estimates: Mapping[int, OutputEstimate]) -> float:
    """Lag and dead time of the slowest element that is known."""
    times = [10 * study.segments[0].h]
    for estimate in estimates.values():
        reasons = unanswered(estimate)
        theta = fit_at(estimate, reasons).theta
        for spec, part in zip(estimate.row.specs, estimate.row.slices, strict=True):
            p = theta[part]
            if spec.initial is not None or not all(k in reasons for k in range(part.start, part.stop)):
                times.append(spec.structure.lag(p) + spec.structure.longest_dead_time(p))
    return float(max(times))


def _plans(
    study: Study, estimates: Mapping[int, OutputEstimate], bench: Bench, asked: Sequence[Open], confidence: float
) -> Iterator[Plan]:
    """The best length of each pattern of moves."""
    slowest = _slowest(study, estimates)
    spread = bench.spread()
    channels = range(bench.channels)
    sets = [(c,) for c in channels] + ([tuple(channels)] if len(channels) > 1 else [])
    for which in sets:
        for factor in levels.MOVE_INTERVALS:
            unit = max(bench.h, round(factor * slowest / bench.h) * bench.h)
            intervals = {
                c: max(bench.h, round(unit * levels.MOVE_RATIO**n / bench.h) * bench.h) for n, c in enumerate(which)
            }
            samples = min(int(levels.LONGEST_PLAN * slowest / bench.h), levels.PLAN_SAMPLES)
            moves = pattern(samples, bench.h, intervals, bench.channels)
            sizes, limited = _largest(study, bench, which, moves, spread)
            if sizes is None:
                continue
            scaled = moves * np.array([sizes.get(c, 0.0) for c in channels])
            _, u = bench.run(scaled)
            told = _widths(study, estimates, asked, u, bench, confidence)
            yield _shortest(asked, told, Moves(sizes, intervals, limited))


def _largest(
    study: Study, bench: Bench, which: Sequence[int], moves: Array, spread: tuple[Array, Array]
) -> tuple[dict[int, float] | None, str]:
    """How far each channel may go to each side, and which limit says so; None where there is no room at all."""
    project = study.project
    seen = _seen(study, bench.controller is not None)
    wished = {c: levels.LARGER_MOVES * seen[c] for c in which if seen[c] > 0}
    if len(wished) < len(which):
        return None, ""
    y, u = bench.run(moves * np.array([wished.get(c, 0.0) for c in range(bench.channels)]))
    k = study.loop_experiment
    limits = project.experiments[0 if k is None else k].limits
    segment = study.segments[-1]
    today_y, today_u = np.nanmedian(segment.y, axis=0), np.median(segment.u, axis=0)
    signals = [
        *((o.name, o.limits, today_y[i], y[:, i], spread[0][i], "PV") for i, o in enumerate(project.outputs)),
        *((o.name, limits[j], today_u[j], u[:, j], spread[1][j], "OP") for j, o in enumerate(project.inputs)),
    ]
    share, why = 1.0, ""
    for name, bounds, today, excursion, noise, what in signals:
        if bounds is None:
            continue
        for room, reach in ((bounds[1] - today, excursion.max()), (today - bounds[0], -excursion.min())):
            allowed = (room - levels.LIMIT_MARGIN * noise) / max(reach, 1e-300)
            if reach > 0 and allowed < share:
                share, why = allowed, f"{what} of {name}"
    if share <= levels.LEAST_ROOM:
        return None, why
    return {c: _round(size * share) for c, size in wished.items()}, why


def _seen(study: Study, closed: bool) -> Array:
    """Half of how far each set-point (OP in open loop) moved in the records; where it did not, a part of its span."""
    project = study.project
    out = []
    for c in range(len(project.outputs) if closed else len(project.inputs)):
        signals = [(s.r if closed else s.u)[:, c] for s in study.segments]
        ranges = [float(np.ptp(x)) / 2 for x in signals if np.isfinite(x).all()]
        limits = project.outputs[c].limits if closed else project.inputs[c].limits
        size = max(ranges, default=0.0)
        if size == 0 and limits is not None:
            size = (limits[1] - limits[0]) * levels.SPAN_PART / levels.LARGER_MOVES
        if size == 0 and closed:
            size = max(float(np.nanstd(s.y[:, c])) for s in study.segments)
        out.append(size)
    return np.array(out)


def _round(value: float) -> float:
    """Down to two digits: what one would type in."""
    step = 10.0 ** (np.floor(np.log10(value)) - 1)
    return float(f"{np.floor(value / step * (1 + 1e-9)) * step:.10g}")


def _widths(
    study: Study,
    estimates: Mapping[int, OutputEstimate],
    asked: Sequence[Open],
    u: Array,
    bench: Bench,
    confidence: float,
) -> tuple[Array, Array]:
    """Half-widths (asked, n) of the open parameters after each of n lengths of a record with inputs u, and these."""
    z = float(norm.ppf(0.5 + confidence / 2))
    ends: Array = np.zeros(0)
    rows: dict[int, Array] = {}
    for i in {one.output for one in asked}:
        estimate = estimates[i]
        fit = fit_at(estimate, unanswered(estimate))
        told, ends = information(fit, u, bench.h, len(study.columns), not estimate.predicted_by)
        rows[i] = z * combined(estimate.covariance, told)
    return np.array([rows[one.output][:, one.index] for one in asked]), ends


def _shortest(asked: Sequence[Open], widths: tuple[Array, Array], moves: Moves) -> Plan:
    """The moves, as long as they have to be."""
    after, ends = widths
    whole = 2 * max(moves.interval.values())  # up and down once is the least
    enough = np.all(after <= np.array([one.wanted for one in asked])[:, None], axis=0) & (ends >= whole)
    at = int(np.argmax(enough)) if enough.any() else ends.size - 1
    unit = min(moves.interval.values())
    length = float(np.ceil(ends[at] / unit - 1e-9) * unit)
    return Plan(moves, length, bool(enough.any()), tuple(float(w) for w in after[:, at]))


def _entry(study: Study, bench: Bench, plan: Plan, asked: Sequence[Open]) -> MoreData:
    """A plan as the result has it."""
    project = study.project
    closed = bench.controller is not None
    signal, channels = ("set-point", project.outputs) if closed else ("OP", project.inputs)
    found = MoreData(
        sentence="",
        moves=tuple(
            PlannedMove(signal, channels[c].name, size, channels[c].unit, plan.moves.interval[c])
            for c, size in plan.moves.size.items()
        ),
        length=plan.length,
        suffices=plan.suffices,
        limited_by=plan.moves.limited_by,
        settles=tuple(
            Settled(
                output=project.output_names[one.output],
                input=study.columns[one.column],
                parameter=one.name,
                unit=one.unit,
                now=one.now if one.now < 1e6 * max(one.wanted, 1e-300) else None,
                wanted=one.wanted,
                then=then,
            )
            for one, then in zip(asked, plan.then, strict=True)
        ),
    )
    return replace(found, sentence=plan_sentence(project.time_unit, found))
