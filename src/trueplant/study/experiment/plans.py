"""How much more data: the moves that would settle what an analysis had to leave open.

Plans are tried out by simulating today's loop on the plant as estimated and on plants that the record leaves possible,
each under a disturbance of the record's size: on none of them may a PV or an OP leave its limits. What a plan would
tell is the Fisher information of its noise-free record under the noise model that was found, on top of what is known.
What noise stirs up by itself is not counted.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import norm

from trueplant.arrays import Array, BoolArray
from trueplant.calendar import unit_seconds
from trueplant.errors import LoopError
from trueplant.identify import OutputEstimate
from trueplant.lti import TransferMatrix
from trueplant.result import MoreData, NotWorth, PlannedMove, Settled
from trueplant.result.plan_words import not_worth_sentence, plan_sentence
from trueplant.study import levels
from trueplant.study.experiment.known import Known, known_of
from trueplant.study.experiment.moves import Moves, combined, information
from trueplant.study.experiment.open_questions import (
    Matter,
    Open,
    open_parameters,
    possible_plants,
    what_matters,
    with_what_is_wanted,
)
from trueplant.study.experiment.stand import Stand, bench_of, stand_of
from trueplant.study.study import Study

UNKNOWN_CONTROLLER = MoreData(
    "no test can be planned before it is known which controller is at work: its moves have to keep the limits with "
    "that one, and OP was written by another than is declared"
)


@dataclass(frozen=True, eq=False)
class Question:
    """What is open, and what a plan has to reach."""

    study: Study
    known: Mapping[int, Known]
    asked: tuple[Open, ...]
    matters: tuple[Matter, ...]
    """The elements of which what is open matters to the loops."""
    longest: float
    """Time that a test may take."""

    @property
    def first_of_two(self) -> bool:
        """Is so little known that a small test has to come before the one that settles everything?"""
        return bool(self.hardly_known)

    @property
    def hardly_known(self) -> tuple[Matter, ...]:
        return tuple(one for one in self.matters if one.now > levels.HARDLY_KNOWN)

    def reached(self, covariances: Mapping[int, Array]) -> BoolArray:
        """(n,) Is what matters known well enough, with covariances (n, q, q) of the outputs' parameters?"""
        return _all_within(self.matters, covariances, levels.MATTERS)

    def goals_reached(self, covariances: Mapping[int, Array]) -> BoolArray:
        """(n,) The same of what this test is to tell: the first of two is about what is hardly known."""
        if not self.first_of_two:
            return self.reached(covariances)
        return _all_within(self.hardly_known, covariances, levels.FIRST_PRECISION)

    def after(self, u: Array, h: float) -> tuple[dict[int, Array], Array]:
        """Covariances (n, q, q) by output after each of n lengths of a record with OPs u (N, n_u), and these lengths.

        The longer ones stand for more of the same: up to `levels.LONGEST_FORETOLD` times the record.
        """
        ends: Array = np.zeros(0)
        rows: dict[int, Array] = {}
        for i in {one.output for one in self.asked} | {one.place[0] for one in self.matters}:
            own = self.known[i]
            told, ends = information(own.fit, u, h, len(self.study.columns), not own.estimate.predicted_by)
            times = np.geomspace(1.0, levels.LONGEST_FORETOLD, levels.PLAN_LENGTHS)[1:]
            told = np.concatenate([told, told[-1] * times[:, None, None]])
            ends = np.concatenate([ends, ends[-1] * times])
            rows[i] = combined(own.covariance, told)
        return rows, ends

    def widths(self, covariances: Mapping[int, Array], at: int) -> tuple[float, ...]:
        """Half-widths of the intervals of what is asked for, after the length of that number."""
        z = float(norm.ppf(0.5 + self.study.project.analysis.confidence / 2))
        return tuple(z * float(np.sqrt(covariances[one.output][at, one.index, one.index])) for one in self.asked)


def _all_within(some: Sequence[Matter], covariances: Mapping[int, Array], most: float) -> BoolArray:
    """(n,) Does what is open of all these elements change the loops by no more than that?"""
    return np.asarray(np.all([one.after(covariances[one.place[0]]) <= most for one in some], axis=0))


@dataclass(frozen=True, eq=False)
class Plan:
    """Moves, how long they take, and what each open parameter would then be known to (half-width)."""

    moves: Moves
    length: float
    """Infinite where no length would do."""
    then: tuple[float, ...] = ()
    told: bool = False
    """Does it tell what it is to tell, within the limits and in the time that a test may take?"""
    suffices: bool = False
    """Would all that matters be known well enough?"""


def more_data(study: Study, estimates: Mapping[int, OutputEstimate], plant: TransferMatrix) -> tuple[MoreData, ...]:
    """Plans that would settle what is open, the shortest first, as result.json has them; empty where nothing is open.

    `plant` (n_y, n_u + n_d) as estimated. Where no plan does within the longest time that a test may take, there is one
    entry without moves that says why.
    """
    h, longest = study.segments[0].h, _longest(study)
    known, slowest = known_of(estimates, h)
    slowest = min(slowest, levels.PLAN_SAMPLES * h / (levels.LATELY[1] + 2 * levels.SETTLING))
    asked = open_parameters(study, known, study.project.analysis.confidence)
    if not asked:
        return ()
    loop, own = study.loop(plant), plant.columns(0, study.n_u)
    w = np.geomspace(levels.LOWEST_OF_SLOWEST / slowest, np.pi / h, levels.MATTERS_POINTS)
    samples = int(min(levels.LONGEST_PLAN * slowest, longest) / h) + int(levels.SETTLING * slowest / h)
    try:
        bench = bench_of(study, own, loop)
        seen = _seen(study, loop is not None)
        elements = what_matters(study, known, loop, w, seen)
        matters = tuple(one for one in elements if one.now > levels.MATTERS)
        places = {one.place for one in matters}
        question = Question(study, known, with_what_is_wanted(asked, elements), matters, longest)
        if not any(one.place in places for one in asked):
            still = loop is None and any(seen[one.column] == 0 for one in asked)
            return (_not_worth(question, NotWorth.NO_LIMITS if still else NotWorth.MATTERS_LITTLE),)
        possible = possible_plants(study, known, plant, loop)
        unsure = {one.place[0] for one in question.hardly_known}
        stand = stand_of(study, estimates, bench, possible, (slowest, min(samples, levels.PLAN_SAMPLES)), unsure)
        return _answer(question, stand)
    except LoopError as error:
        return (MoreData(f"no moves could be planned: {error}"),)


def _longest(study: Study) -> float:
    """Time that a test may take, of no more samples than can be tried out."""
    said = study.project.analysis.longest_test
    shift = levels.SHIFT * 3600.0 / unit_seconds(study.project.time_unit)
    return min(shift if said is None else said, levels.PLAN_SAMPLES * study.segments[0].h)


def _answer(question: Question, stand: Stand) -> tuple[MoreData, ...]:
    """The plans that are good enough, the shortest of each set of channels; else why there is none."""
    tried: dict[tuple[int, ...], list[Plan]] = {}
    tight = ""
    for moves, limited_by in _candidates(question, stand):
        if moves is None:
            tight = limited_by
        else:
            tried.setdefault(tuple(moves.size), []).append(_shortest(question, stand, moves))
    if not tried:
        why = NotWorth.LIMITS_TOO_NEAR if tight else NotWorth.NO_LIMITS
        return (_not_worth(question, why, limited_by=tight, assumed=stand.room.shown),)
    finished = [_best(question, stand, sorted(plans, key=lambda p: p.length)) for plans in tried.values()]
    enough = sorted((p for p in finished if p.told), key=lambda p: (p.length, len(p.moves.size)))
    if enough:
        return tuple(_entry(question, stand, plan) for plan in enough)
    nearest = min(finished, key=lambda p: p.length)
    if not nearest.moves.size:
        why, limited_by = NotWorth.LIMITS_TOO_NEAR, nearest.moves.limited_by
        return (_not_worth(question, why, limited_by=limited_by, assumed=stand.room.shown),)
    return (_not_worth(question, NotWorth.TOO_LONG, nearest.length, nearest.moves.limited_by),)


def _best(question: Question, stand: Stand, plans: Sequence[Plan]) -> Plan:
    """The first of some plans, in order of length, that keeps the limits and tells what it is to.

    Else one that the limits leave no room for, or the shortest: those that are too long were not held against limits.
    """
    kept = []
    for plan in plans:
        kept.append(_kept_within(question, stand, plan))
        if kept[-1].told:
            break
    return min(kept, key=lambda p: (not p.told, bool(p.moves.size), p.length))


def _candidates(question: Question, stand: Stand) -> Iterator[tuple[Moves | None, str]]:
    """Moves of each channel alone and of all at once, at several intervals, as large as the plant as estimated allows.

    None where there is no room, and the limit that says so.
    """
    bench, seen = stand.bench, _seen(question.study, stand.bench.controller is not None)
    larger = 1.0 if question.first_of_two else levels.LARGER_MOVES
    channels = [c for c in _movable(stand) if seen[c] > 0]
    for which in [(c,) for c in channels] + ([tuple(channels)] if len(channels) > 1 else []):
        # once up and once down is the least; what would take longer tells how long a test would take
        most = question.longest / 2 / levels.MOVE_RATIO ** (len(which) - 1)
        units = [factor * stand.slowest for factor in levels.MOVE_INTERVALS]
        for unit in sorted({*units, *(min(one, most) for one in units)}):
            intervals = {c: _whole(unit * levels.MOVE_RATIO**n, bench.h) for n, c in enumerate(which)}
            wished = Moves({c: larger * seen[c] for c in which}, intervals)
            once = wished.course(2 * max(intervals.values()), bench.h, bench.channels)
            share, why = stand.today.share(once, stand.room)
            moves = _smaller(wished, share, why)
            yield (moves, why) if share > levels.LEAST_ROOM else (None, why)


def _movable(stand: Stand) -> list[int]:
    """Outputs whose set-point a controller follows; in open loop all inputs."""
    law = stand.bench.controller
    return list(range(stand.bench.channels)) if law is None else sorted({j for _, j in law.entries})


def _whole(time: float, h: float) -> float:
    """Whole samples, rounded down."""
    return max(1, int(time / h * (1 + 1e-9))) * h


def _smaller(moves: Moves, share: float, why: str) -> Moves:
    """The moves cut to a share of their size, in two digits; as they are where the share is 1 or more."""
    size = {c: _round(size * min(share, 1.0)) for c, size in moves.size.items() if size * share > 0}
    return replace(moves, size=size, limited_by=why if share < 1 else moves.limited_by)


def _seen(study: Study, closed: bool) -> Array:
    """Half of how far each set-point (OP in open loop) moved in the records; where it did not, a part of its span."""
    project = study.project
    out = []
    for c in range(len(project.outputs) if closed else len(project.inputs)):
        signals = [(s.setpoints if closed else s.u)[:, c] for s in study.segments]
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


def _shortest(question: Question, stand: Stand, moves: Moves) -> Plan:
    """The moves, for as long as they have to be made."""
    bench = stand.bench
    length = max(len(stand.today.still) * bench.h, 2 * max(moves.interval.values()))
    tried = min(length, max(question.longest, 2 * max(moves.interval.values())))
    _, u = bench.run(moves.course(tried, bench.h, bench.channels))
    covariances, ends = question.after(u, bench.h)
    enough = question.goals_reached(covariances)
    if not enough.any():
        return Plan(moves, np.inf)
    up_and_down = 2 * max(moves.interval.values())
    return Plan(moves, float(max(1.0, np.ceil(ends[np.argmax(enough)] / up_and_down - 1e-9)) * up_and_down))


def _kept_within(question: Question, stand: Stand, plan: Plan) -> Plan:
    """The plan made so small, and therefore long, that it keeps the limits on all plants drawn, the way back included.

    It suffices if it still reaches its goals in the time that a test may take.
    """
    bench = stand.bench
    settling = int(levels.SETTLING * stand.slowest / bench.h)
    for _ in range(levels.SIZED_TWICE):
        if not plan.length <= question.longest * (1 + 1e-9):
            return plan
        share, why = stand.share(plan.moves.course(plan.length, bench.h, bench.channels, settling))
        if share <= levels.LEAST_ROOM:
            return replace(plan, moves=replace(plan.moves, size={}, limited_by=why), length=np.inf)
        if share >= 1:
            return _settled(question, stand, plan)
        plan = _shortest(question, stand, _smaller(plan.moves, share, why))
    return replace(plan, length=np.inf)


def _settled(question: Question, stand: Stand, plan: Plan) -> Plan:
    """What the record of this very plan would tell."""
    bench = stand.bench
    _, u = bench.run(plan.moves.course(plan.length, bench.h, bench.channels))
    covariances, ends = question.after(u, bench.h)
    at = min(int(np.searchsorted(ends, plan.length * (1 - 1e-9))), len(ends) - 1)
    then = question.widths(covariances, at)
    return replace(plan, then=then, told=True, suffices=bool(question.reached(covariances)[at]))


def _not_worth(
    question: Question, why: NotWorth, needs: float = np.inf, limited_by: str = "", assumed: tuple[str, ...] = ()
) -> MoreData:
    """Why no test is worth it."""
    found = MoreData(
        sentence="",
        not_worth=why,
        needs=needs if np.isfinite(needs) else None,
        limited_by=limited_by,
        assumed_limits=assumed,
        longest=question.longest,
    )
    return replace(found, sentence=not_worth_sentence(question.study.project.time_unit, found))


def _entry(question: Question, stand: Stand, plan: Plan) -> MoreData:
    """A plan as the result has it."""
    study, project = question.study, question.study.project
    closed = stand.bench.controller is not None
    signal, channels = ("set-point", project.outputs) if closed else ("OP", project.inputs)
    places = {one.place for one in question.matters}
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
                matters=one.place in places,
                as_modelled=question.known[one.output].as_modelled,
            )
            for one, then in zip(question.asked, plan.then, strict=True)
        ),
        first_of_two=question.first_of_two and not plan.suffices,
        assumed_limits=stand.room.shown,
        longest=question.longest,
    )
    return replace(found, sentence=plan_sentence(project.time_unit, found))
