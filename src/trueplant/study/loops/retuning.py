"""Retuned controllers for the plant as estimated: proposals, what they do, and which holds for the likely plants."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from trueplant.arrays import Array
from trueplant.errors import LoopError
from trueplant.loop import Controller, Linear, LinearLoop
from trueplant.lti import UncertainPlant
from trueplant.mismatch import FrequencyResponse, speaking_band
from trueplant.result import (
    KEEP,
    Code,
    ControllerCheck,
    CurrentSettings,
    Element,
    ElementVerdict,
    LoopRetuning,
    ProposedSettings,
    Reason,
    RetuningCurves,
    RetuningLimits,
)
from trueplant.result.recommendation_words import Outlook, Recommendation, recommendation_sentence
from trueplant.study import levels
from trueplant.study.loops.candidates import candidates_of
from trueplant.study.loops.judging import Judge, judge_of, limits_of, response_span
from trueplant.study.loops.metrics import Surroundings, band, prediction_errors, recovered, replayed
from trueplant.study.loops.real_errors import held_against_elements
from trueplant.study.loops.recommendation import Judged, recommend
from trueplant.study.loops.settings import law_settings, vendor_settings
from trueplant.study.loops.targets import Target, not_as_declared, target_of
from trueplant.study.loops.weighted import weights_of
from trueplant.study.plant.identified import Identified
from trueplant.study.study import Progress, Study, quiet
from trueplant.tune import (
    AS_DESIGNED,
    CERTAIN,
    PERFORMANCE,
    LoopTask,
    Proposal,
    Weighting,
    common_grid,
    propose,
)

Place = tuple[int, int]

DEFAULT_METHODS = (CERTAIN, AS_DESIGNED, "max-ki", "simc", "lambda", "amigo", "tyreus-luyben")
FOR_SEVERAL = ("blt", "sequential")
WITH_WEIGHTS = (PERFORMANCE,)


@dataclass(frozen=True, eq=False)
class Retuning:
    """`controllers` of the result, the report's curves, and notes."""

    table: tuple[LoopRetuning, ...] = ()
    curves: tuple[RetuningCurves, ...] = ()
    notes: tuple[Reason, ...] = ()


def retuning_of(
    study: Study,
    found: Identified,
    plant: UncertainPlant,
    response: FrequencyResponse | None,
    checks: Sequence[ControllerCheck],
    elements: Sequence[Element],
    say: Progress = quiet,
) -> Retuning:
    """Proposals for every loop of today's controller; empty without a [tuning] table in the project.

    None either where a controller that is declared did not write OP: settings are set against it.
    """
    if study.project.tuning is None:
        return Retuning()
    k, today = study.loop_experiment, study.loop(plant.nominal)
    declared = None if k is None else study.records.declared[k]
    if today is None or declared is None:
        why = "retuning needs the controllers of a usable closed experiment: declare them as [[controller]]"
        return Retuning(notes=(Reason(Code.TUNING, why),))
    if wrong := not_as_declared(study, checks):
        return Retuning(notes=wrong)
    if not declared.is_decentralised:
        why = "retuning is for one controller a loop, and these share inputs or outputs"
        return Retuning(notes=(Reason(Code.TUNING, why),))
    known = plant.keeping_signs([(j, i) for i, j in declared.entries]).first(study.n_u)
    bands = None if response is None else speaking_band(response, known.nominal)
    targets = [target_of(study, found, today, declared.entries[place], place, bands) for place in declared.entries]
    if all(loop.task is None for loop in targets):
        return Retuning(
            notes=tuple(Reason(Code.TUNING, loop.why, study.project.input_names[loop.place[0]]) for loop in targets)
        )
    try:
        return _workshop(study, found, known, today, targets, elements, say).retuning()
    except LoopError as error:
        return Retuning(notes=(Reason(Code.TUNING, f"no settings can be proposed: {error}"),))


# -- the proposals --------------------------------------------------------------------------------------------------


def _workshop(
    study: Study,
    found: Identified,
    known: UncertainPlant,
    today: LinearLoop,
    targets: Sequence[Target],
    elements: Sequence[Element],
    say: Progress,
) -> _Workshop:
    """Proposals by every method asked for, and the plants to judge them on."""
    project = study.project
    assert project.tuning is not None  # nothing is retuned without it
    asked, seed = project.tuning.limits, project.analysis.seed
    tasks = [target.task for target in targets if target.task is not None]
    highest = max(task.crossover for task in tasks)
    declared = project.robustness
    weights = None
    if declared is not None and declared.wI is not None and declared.wP is not None:
        weights = weights_of(declared.wI), weights_of(declared.wP)
    changed = any(e.verdict in (ElementVerdict.CHANGED, ElementVerdict.FOUND) for e in elements)
    limits = limits_of(asked, weights is not None, changed)
    usual = (*DEFAULT_METHODS, *(FOR_SEVERAL if len(tasks) > 1 else ()), *(WITH_WEIGHTS if weights else ()))
    methods = list(project.tuning.methods) or usual
    proposals = propose(
        known,
        tasks,
        today.controller,
        methods,
        model=study.inputs_model,
        weighting=None if weights is None else Weighting(*weights),
        limit=limits.Ms,
        share=limits.share,
        seed=seed + 1,
        say=lambda method: say(f"settings for the controllers: {method}"),
    )
    proposals += candidates_of(study, today, tasks)
    laws = [today.controller, *(p.controller for p in proposals if p.controller is not None)]
    w = max((common_grid(known.nominal, law, highest) for law in laws), key=len)
    return _Workshop(
        study=study,
        known=known,
        today=today,
        targets=targets,
        judge=judge_of(
            study.inputs_model,
            known,
            [target.place for target in targets],
            limits,
            Surroundings(
                prediction_errors(study, found.estimates),
                recovered(study, found, known.nominal),
                weights,
                min(study.segments[0].h, levels.FINE_STEP / highest),
            ),
            w,
            seed,
        ),
        proposals=proposals,
        say=say,
    )


def _recommended(found: Recommendation, leaves: str | None) -> tuple[str | None, str]:
    """The method whose settings to enter into a loop, and why; leaves: why the recommended one does not touch it."""
    if leaves is not None:
        return KEEP, leaves
    method = KEEP if found.outlook in (Outlook.KEEP, Outlook.KEEP_UNCHANGED) else found.method
    return method, recommendation_sentence(found)


@dataclass(frozen=True, eq=False)
class _Workshop:
    """All that the proposals of one project share."""

    study: Study
    known: UncertainPlant
    """The plant from the inputs, with what is uncertain about it."""
    today: LinearLoop
    targets: Sequence[Target]
    """Every loop of today's controller."""
    judge: Judge
    proposals: Sequence[Proposal]
    say: Progress

    @property
    def tasks(self) -> list[LoopTask]:
        """Those of the targets that can be tuned."""
        return [target.task for target in self.targets if target.task is not None]

    def retuning(self) -> Retuning:
        """The table, the curves and the notes."""
        today = self.judge.of(self.today.controller)
        judged = {}
        for p in self.proposals:
            if p.controller is not None:
                self.say(f"settings for the controllers: judging {p.method}")
                judged[p.method] = self.judge.of(p.controller)
        project = self.study.project
        assert project.tuning is not None  # nothing is retuned without it
        loops = {loop.place: project.input_names[loop.place[0]] for loop in self.targets}

        def choose(left: Mapping[str, Judged]) -> Recommendation:
            return recommend(self.proposals, left, today, loops, self.judge.limits, project.time_unit)

        limit = project.tuning.limits.mu or levels.LIMIT_MU
        found = held_against_elements(self.study, self.today, self.proposals, judged, choose, limit, self.say)
        self.say("settings for the controllers: responses")
        table = tuple(self._loop(loop, today, judged, found) for loop in self.targets)
        drawn = found.method or next((p.method for p in self.proposals if p.controller is not None), None)
        chosen = next((p for p in self.proposals if p.method == drawn), None)
        curves = () if chosen is None or chosen.controller is None else self._curves(chosen)
        return Retuning(table, curves)

    def _loop(self, loop: Target, today: Judged, judged: Mapping[str, Judged], found: Recommendation) -> LoopRetuning:
        project, k, limits = self.study.project, self.study.loop_experiment, self.judge.limits
        assert k is not None  # nothing is retuned without today's loop,
        assert project.tuning is not None  # or unasked
        i, j = loop.place
        rows = [self._proposal(loop, p, judged) for p in self.proposals]
        prices = [price for _, price in rows if price is not None]
        crossover = None if loop.task is None else loop.task.crossover
        recommended, reason = (None, loop.why) if loop.task is None else _recommended(found, self._leaves(loop, found))
        return LoopRetuning(
            input=project.input_names[i],
            output=project.output_names[j],
            controller_of=project.experiments[k].name,
            form=loop.shown.form,
            gain_unit=loop.shown.gain_unit,
            time_unit=project.time_unit,
            notation=loop.shown.notation,
            limits=RetuningLimits(limits.Ms, limits.mu, limits.share, crossover, loop.why),
            assumptions=loop.assumptions,
            current=CurrentSettings(
                law_settings(loop.entry, loop.shown, 1.0),
                vendor_settings(loop.entry, loop.shown, 1.0),
                today.metrics[loop.place],
                today.drawn[loop.place],
            ),
            proposals=tuple(row for row, _ in rows) if loop.task is not None else (),
            recommended=recommended,
            reason=reason,
            price=prices[-1] if prices else None,
            trade_off=next((one for one in found.changes if one.input == project.input_names[i]), None),
        )

    def _leaves(self, loop: Target, found: Recommendation) -> str | None:
        """What the recommended proposal says of a loop whose law it leaves as it is; None where it gives another."""
        chosen = next((p for p in self.proposals if p.method == found.method), None)
        if chosen is None or chosen.controller is None or loop.task is None:
            return None
        same = chosen.controller.entries[loop.place] == self.today.controller.entries[loop.place]
        return chosen.notes[self.tasks.index(loop.task)] if same else None

    def _proposal(
        self, loop: Target, p: Proposal, judged: Mapping[str, Judged]
    ) -> tuple[ProposedSettings, float | None]:
        """One row of the table, and the price where the method has one."""
        if loop.task is None:
            return ProposedSettings(p.method, loop.why), None
        at = self.tasks.index(loop.task)
        if p.controller is None or not p.answered[at]:
            return ProposedSettings(p.method, p.notes[at]), p.price[at]
        law = p.controller.entries[loop.place]
        settings = law_settings(law, loop.shown, loop.slope)
        if isinstance(law, Linear):
            settings = replace(settings, others=self._others(loop, p.controller))
        row = ProposedSettings(
            p.method,
            p.notes[at],
            settings,
            vendor_settings(law, loop.shown, loop.slope),
            judged[p.method].metrics[loop.place],
            judged[p.method].drawn[loop.place],
        )
        return row, p.price[at]

    def _others(self, loop: Target, controller: Controller) -> dict[str, str]:
        """Formulas of the laws from other outputs to this loop's input, by output."""
        laws = {
            self.study.project.output_names[j]: law_settings(entry, loop.shown, 1.0).tf
            for (i, j), entry in controller.entries.items()
            if i == loop.place[0] and j != loop.place[1]
        }
        return {output: formula for output, formula in laws.items() if formula is not None}

    # -- what the report draws --------------------------------------------------------------------------------------

    def _curves(self, chosen: Proposal) -> tuple[RetuningCurves, ...]:
        assert chosen.controller is not None
        laws = {"before": self.today.controller, "after": chosen.controller}
        tail = (1 - self.study.project.analysis.confidence) / 2
        plants = [self.known.nominal, *(self.judge.drawn.plant(k) for k in range(levels.BAND_DRAWS))]
        replays = {name: replayed(self.known.nominal, law, self.judge.around) for name, law in laws.items()}
        seen = self.judge.around.disturbance
        found = []
        for loop in self.targets:
            if loop.task is None:
                continue
            names = self.study.project
            least = 20 * self.judge.around.step
            span = response_span(self.known.nominal, laws.values(), loop.place, least)
            t = np.linspace(0, span, levels.RESPONSE_POINTS)
            bands = {
                (kind, name): band(plants, law, loop.place, kind, t, self.judge.around.step, (tail, 1 - tail))
                for kind in ("set-point", "load")
                for name, law in laws.items()
            }
            replay: dict[str, Array] = {}
            replay_t: Array = np.zeros(0)
            if seen is not None and all(run is not None for run in replays.values()):
                replay_t = np.asarray(seen.h * np.arange(len(seen.v)), dtype=np.float64)
                replay["record"] = seen.error[:, loop.place[1]]
                for name, run in replays.items():
                    assert run is not None
                    replay[name] = np.interp(replay_t, run[0], run[1][:, loop.place[1]])
            found.append(
                RetuningCurves(
                    input=names.input_names[loop.place[0]],
                    output=names.output_names[loop.place[1]],
                    method=chosen.method,
                    t=t,
                    setpoint={name: bands["set-point", name][0] for name in laws},
                    load={name: bands["load", name][0] for name in laws},
                    op_setpoint={name: bands["set-point", name][1] for name in laws},
                    op_load={name: bands["load", name][1] for name in laws},
                    replay_t=replay_t,
                    replay=replay,
                )
            )
        return tuple(found)
