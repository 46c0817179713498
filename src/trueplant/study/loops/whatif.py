"""What other settings would do: answered from a saved analysis alone, again and again, in some ten milliseconds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from trueplant.arrays import Array
from trueplant.errors import LoopError
from trueplant.loop import PID, Controller, Linear
from trueplant.loop.many import Bank
from trueplant.lti import TransferMatrix
from trueplant.project import Project
from trueplant.project.tables import Tuning
from trueplant.result import ControllerSettings, ElementVerdict, LoopRetuning, Result
from trueplant.result.recommendation_words import Outlook, Recommendation, recommendation_sentence
from trueplant.study import levels
from trueplant.study.loops.candidates import BY_HAND
from trueplant.study.loops.judging import Judge, judge_of, limits_of
from trueplant.study.loops.metrics import Surroundings, simulation_step
from trueplant.study.loops.recommendation import Judged, Limits, recommend
from trueplant.study.loops.settings import Shown, law_of_settings, law_settings, slope_of
from trueplant.study.loops.situation import NotReady, Situation, in_hand
from trueplant.study.loops.targets import crossover, pace
from trueplant.study.loops.weighted import weights_of
from trueplant.study.study import Place
from trueplant.tune import Proposal, common_grid


@dataclass(frozen=True, eq=False)
class Hand:
    """One loop whose settings can be tried."""

    place: Place
    """(input, output)"""
    input: str
    output: str
    entry: PID | Linear
    """Today's, linearised."""
    slope: float
    shown: Shown
    settings: ControllerSettings
    """Today's, in the keys of the project file."""
    retuning: LoopRetuning | None
    """What the result proposes, where it was asked."""
    highest: float
    """Crossover that the record vouches for."""
    why: str
    """What sets it."""

    @property
    def presets(self) -> dict[str, ControllerSettings]:
        """Settings of the result's methods, by name; those without an answer, and no PIDs, are left out."""
        rows = () if self.retuning is None else self.retuning.proposals
        return {row.method: row.settings for row in rows if row.settings is not None and row.settings.tf is None}


@dataclass(frozen=True, eq=False)
class Spread:
    """One signal over many plants, (n_t, 3): 5 %, median and 95 %."""

    t: Array
    band: Array


@dataclass(frozen=True, eq=False)
class Answer:
    """PV and OP of one loop after a step of its set-point and of a load, from where the record worked."""

    pv: Mapping[str, Spread]
    """By "set-point" and "load"."""
    op: Mapping[str, Spread]
    at_limit: float
    """Share of the plants on which OP comes to stand at a limit."""


@dataclass(frozen=True)
class Verdict:
    """Would one enter these settings?"""

    recommended: bool
    sentence: str
    found: Recommendation
    too_fast: Mapping[str, str]
    """By input: why the loop is faster than what the record vouches for."""


class WhatIf:
    """Settings of today's controllers, tried on the plant as estimated and on plants drawn from what is not known."""

    def __init__(self, situation: Situation) -> None:
        """Raises NotReady where settings cannot be tried, and why."""
        self.situation = situation
        self.today = in_hand(situation)
        project, result = situation.project, situation.result
        assert situation.declared is not None  # in_hand has seen to it
        self.loops = tuple(
            _hand(project, result, place, situation.declared.entries[place], entry, situation)
            for place, entry in self.today.entries.items()
        )
        self._banks: dict[float, Bank] = {}

    def controller(self, settings: Mapping[str, ControllerSettings]) -> Controller:
        """Today's controllers with other settings in the loops of these inputs. Raises LoopError."""
        entries = dict(self.today.entries)
        for hand in self.loops:
            given = settings.get(hand.input)
            if given is None or given == hand.settings:
                continue
            if not isinstance(hand.entry, PID):
                raise LoopError(f"the controller of {hand.input} is no PID: it has no settings to try")
            entries[hand.place] = law_of_settings(given, hand.entry, hand.shown, hand.slope)
        return replace(self.today, entries=entries)

    # -- numbers ----------------------------------------------------------------------------------------------------

    @cached_property
    def limits(self) -> Limits:
        """What the loops have to keep, as in the retuning of the analysis."""
        project, result = self.situation.project, self.situation.result
        changed = any(e.verdict in (ElementVerdict.CHANGED, ElementVerdict.FOUND) for e in result.elements)
        return limits_of((project.tuning or Tuning()).limits, self._weights is not None, changed)

    @cached_property
    def judge(self) -> Judge:
        """Raises LoopError where the plant is too uncertain to draw from."""
        situation, known = self.situation, self.situation.known
        highest = max(hand.highest for hand in self.loops)
        laws = [self.today, *(self._all(way) for way in ("slow", "fast"))]
        w = max((common_grid(known.nominal, law, highest) for law in laws), key=len)
        step = min(self._sample_time, levels.FINE_STEP / highest)
        around = Surroundings(self._noise, None, self._weights, step)
        places = [hand.place for hand in self.loops]
        return judge_of(None, known, places, self.limits, around, w, situation.project.analysis.seed)

    @cached_property
    def judged_today(self) -> Judged:
        return self.judge.of(self.today)

    def verdict(self, controller: Controller, judged: Judged) -> Verdict:
        """The judgement of the analysis on these settings against today's; `judged` is theirs."""
        names = {hand.place: hand.input for hand in self.loops}
        proposal = Proposal(BY_HAND, controller, (True,) * len(names), ("",) * len(names), (None,) * len(names))
        unit = self.situation.project.time_unit
        found = recommend([proposal], {BY_HAND: judged}, self.judged_today, names, self.limits, unit)
        fast = {}
        for hand in self.loops:
            now = crossover(self.situation.known.nominal[hand.place[::-1]], controller, hand.place)
            if now is not None and now > hand.highest * (1 + levels.SAME_CROSSOVER):
                fast[hand.input] = (
                    f"faster than the record vouches for: its crossover would be {now:.3g} rad per {unit}, and "
                    f"{hand.highest:.3g} is the most ({hand.why})"
                )
        good = found.method == BY_HAND and found.outlook in (Outlook.CHANGE, Outlook.LESS_MU) and not fast
        sentence = recommendation_sentence(found)
        if not judged.keeps(self.limits):
            sentence = _unkept(judged, self.limits)
        if fast:
            sentence = "; ".join(f"{name}: {why}" for name, why in fast.items())
        return Verdict(good, sentence, found, fast)

    @cached_property
    def _sample_time(self) -> float:
        return self.situation.result.data[self.situation.experiment].sample_time

    @cached_property
    def _noise(self) -> Array:
        """(n_y,) prediction error of each output, 0 where it was not estimated."""
        errors = {
            row.output: row.residual_tests.prediction_error
            for row in self.situation.result.fit
            if row.residual_tests is not None
        }
        return np.array([errors.get(name, 0.0) for name in self.situation.project.output_names])

    @cached_property
    def _weights(self) -> tuple[object, object] | None:
        declared = self.situation.project.robustness
        if declared is None or declared.wI is None or declared.wP is None:
            return None
        return weights_of(declared.wI), weights_of(declared.wP)

    def _all(self, way: str) -> Controller:
        """Today's PIDs with integral times as far off as sliders go, which the grid of frequencies is to serve."""
        factor = levels.TRIED_SLOWER if way == "slow" else 1 / levels.TRIED_SLOWER
        entries = dict(self.today.entries)
        for place, entry in entries.items():
            if isinstance(entry, PID):
                kp, ki, kd, tf = entry.parallel
                entries[place] = PID("parallel", Kp=kp, Ki=ki / factor, Kd=kd, Tf=tf, sample_time=entry.sample_time)
        return replace(self.today, entries=entries)

    # -- curves -----------------------------------------------------------------------------------------------------

    @cached_property
    def plants(self) -> tuple[TransferMatrix, ...]:
        """Those that curves are drawn over: the first of those that judge."""
        return tuple(self.judge.drawn.plant(k) for k in range(levels.TRIED_PLANTS))

    def span(self, hand: Hand) -> float:
        """Time after which today's settings and those that the result proposes have settled on the plant as estimated,
        as far as they do."""
        rows = () if hand.retuning is None else hand.retuning.proposals
        some = [self.judged_today.metrics[hand.place].plant, *(row.metrics.plant for row in rows if row.metrics)]
        times = [step.settling for one in some for step in (one.setpoint, one.load) if step is not None]
        least = 20 * self.judge.around.step
        return levels.TRIED_SPAN * float(np.median(times)) if times else least

    def answer(self, controller: Controller, hand: Hand, steps: tuple[float, float], span: float) -> Answer:
        """Curves over the drawn plants; steps: of the set-point in PV's unit, and of a load in OP's.

        OP keeps its limits. Raises LoopError for a controller that cannot be run in time.
        """
        (i, j), situation = hand.place, self.situation
        bank, controller = self._bank(controller, span)
        count = int(np.ceil(span / bank.h)) + 1
        t: Array = np.asarray(bank.h * np.arange(count), dtype=np.float64)
        thin = np.unique(np.linspace(0, count - 1, min(count, levels.RESPONSE_POINTS)).astype(int))
        pv, op, at_limit = {}, {}, 0.0
        low, high = situation.limits[i]
        edge = 1e-9 * (high - low) if np.isfinite(high - low) else 0.0
        for kind, size in zip(("set-point", "load"), steps, strict=True):
            r, load = np.tile(situation.y0, (count, 1)), np.zeros((count, situation.u0.size))
            if kind == "set-point":
                r[:, j] += size
            else:
                load[:, i] = size
            y, u = bank.run(controller, r, load, y0=situation.y0, u0=situation.u0, limits=situation.limits)
            # the last sample is looked at too: OP may come to rest on its limit
            rests = (u[:, -1, i] <= low + edge) | (u[:, -1, i] >= high - edge)
            at_limit = max(at_limit, float(np.mean(rests)))
            pv[kind], op[kind] = _spread(t, y[:, :, j], thin), _spread(t, u[:, :, i], thin)
        return Answer(pv, op, at_limit)

    def _bank(self, controller: Controller, span: float) -> tuple[Bank, Controller]:
        """The drawn plants at the step that this takes.

        Scans that are short against what can be seen of the curves run as if there were none.
        """
        fastest = max(hand.highest for hand in self.loops)
        wanted = max(min(span / levels.TRIED_STEPS[0], levels.FINE_STEP / fastest), span / levels.TRIED_STEPS[1])
        h = simulation_step(controller, wanted)
        if span / h > levels.TRIED_STEPS[1] * 1.01:
            h, controller = wanted, _continuous(controller)
        if h not in self._banks:
            self._banks[h] = Bank.of(self.plants, h)
        return self._banks[h], controller


def _hand(
    project: Project, result: Result, place: Place, declared: PID | Linear, entry: PID | Linear, situation: Situation
) -> Hand:
    i, j = place
    retuning = next((c for c in result.controllers if c.input == project.input_names[i]), None)
    shown, slope = Shown.of(project, declared, i, j), slope_of(declared, entry)
    if retuning is not None and retuning.limits.crossover is not None:
        highest, why = retuning.limits.crossover, retuning.limits.why
    else:
        assert situation.today is not None  # whose loop this is
        g, unit = situation.known.nominal[j, i], f"rad per {project.time_unit}"
        if g.is_zero:
            raise NotReady(f"the plant has no response of {project.output_names[j]} to {project.input_names[i]}")
        now, said = pace(g, situation.today, place, unit)
        highest, why = levels.SPEED * now, f"{levels.SPEED:g} times {said} is the largest change made in one step"
    return Hand(
        place,
        project.input_names[i],
        project.output_names[j],
        entry,
        slope,
        shown,
        law_settings(entry, shown, slope),
        retuning,
        highest,
        why,
    )


def _unkept(judged: Judged, limits: Limits) -> str:
    """Why settings that do not hold the limits are none to enter."""
    named = f"Ms and Mt below {limits.Ms:.3g} in all loops"
    if limits.mu is not None:
        named += f", and mu of robust performance below {limits.mu:.3g},"
    held = f"for {100 * judged.share(limits):.3g} % of the plants that the record leaves possible"
    return f"these settings hold {named} {held}, and {100 * limits.share:.3g} % is asked for"


def _continuous(controller: Controller) -> Controller:
    entries = {place: replace(entry, sample_time=None) for place, entry in controller.entries.items()}
    return replace(controller, entries=entries)


def _spread(t: Array, curves: Array, thin: Array) -> Spread:
    """(count, N) curves as their 5, 50 and 95 %; what runs away is far off, on the side to which it does."""
    some = np.nan_to_num(curves[:, thin], nan=levels.FAR_OFF, posinf=levels.FAR_OFF, neginf=-levels.FAR_OFF)
    low, middle, high = np.quantile(some, [0.05, 0.5, 0.95], axis=0)
    return Spread(t[thin], np.column_stack([low, middle, high]))
