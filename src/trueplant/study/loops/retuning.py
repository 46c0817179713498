"""Retuned controllers for the plant as estimated: proposals, what they do, and which holds for the likely plants."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from trueplant.arrays import Array
from trueplant.errors import LoopError
from trueplant.loop import PID, Controller, Linear
from trueplant.lti import UncertainPlant
from trueplant.mismatch import FrequencyResponse, speaking_band
from trueplant.result import Reason, RetuningCurves
from trueplant.robust import margins
from trueplant.study.loops.metrics import (
    FINE,
    Surroundings,
    band,
    drawn_peaks,
    drawn_table,
    loop_table,
    mu_table,
    noise_of,
    recovered,
    replayed,
    share_below_mu,
)
from trueplant.study.loops.recommendation import law_settings, reason_of, vendor_settings
from trueplant.study.loops.robustness import weights_of
from trueplant.study.loops.targets import Asked, asked_of
from trueplant.study.plant.identified import Identified
from trueplant.study.study import Study
from trueplant.tune import (
    AS_DESIGNED,
    CERTAIN,
    LoopTask,
    Proposal,
    common_grid,
    propose,
)

Place = tuple[int, int]

DEFAULT_METHODS = (CERTAIN, AS_DESIGNED, "max-ki", "simc", "lambda", "amigo", "tyreus-luyben")
FOR_SEVERAL = ("blt", "sequential")
MS, SHARE, MU = 1.59, 0.95, 1.0
"""Limits where the project states none: Ms of SIMC's tight settings, share of plants, mu."""
DRAWS = 1000
BAND_DRAWS = 60
POINTS = 300


@dataclass(frozen=True, eq=False)
class Retuning:
    """`controllers` of the result, the report's curves, and notes."""

    table: tuple[Mapping[str, Any], ...] = ()
    curves: tuple[RetuningCurves, ...] = ()
    notes: tuple[Reason, ...] = ()


def retuning_of(study: Study, found: Identified, plant: UncertainPlant, response: FrequencyResponse | None) -> Retuning:
    """Proposals for every loop of today's controller; empty without a [tuning] table in the project."""
    if study.project.tuning is None:
        return Retuning()
    k, today = study.loop_experiment, study.loop(plant.nominal)
    declared = None if k is None else study.records.declared[k]
    if today is None or declared is None:
        why = "retuning needs the controllers of a usable closed experiment: declare them as [[controller]]"
        return Retuning(notes=(Reason("tuning", why),))
    if not declared.is_decentralised:
        why = "retuning is for one controller a loop, and these share inputs or outputs"
        return Retuning(notes=(Reason("tuning", why),))
    known = plant.keeping_signs([(j, i) for i, j in declared.entries]).first(study.n_u)
    bands = None if response is None else speaking_band(response)
    asked = [asked_of(study, found, today, declared.entries[place], place, bands) for place in declared.entries]
    tasks = [loop.task for loop in asked if loop.task is not None]
    if not tasks:
        return Retuning(
            notes=tuple(Reason("tuning", loop.why, study.project.input_names[loop.place[0]]) for loop in asked)
        )
    try:
        return _Workshop(study, found, known, today.controller, asked, tasks).retuning()
    except LoopError as error:
        return Retuning(notes=(Reason("tuning", f"no settings can be proposed: {error}"),))


# -- the proposals --------------------------------------------------------------------------------------------------


class _Workshop:
    """All that the proposals of one project share."""

    def __init__(
        self,
        study: Study,
        found: Identified,
        known: UncertainPlant,
        today: Controller,
        asked: Sequence[Asked],
        tasks: Sequence[LoopTask],
    ) -> None:
        project = study.project
        assert project.tuning is not None
        self.study, self.known, self.today, self.asked, self.tasks = study, known, today, asked, tasks
        self.limits = project.tuning.limits
        self.limit, self.share = self.limits.Ms or MS, self.limits.share or SHARE
        self.seed = project.analysis.seed + 2
        self.model = study.inputs_model
        highest = max(task.crossover for task in tasks)
        declared = project.robustness
        weights = None
        if declared is not None and declared.wI is not None and declared.wP is not None:
            weights = weights_of(declared.wI), weights_of(declared.wP)
        step = min(study.segments[0].h, FINE / highest)
        disturbance = recovered(study, found, known.nominal)
        self.around = Surroundings(noise_of(study, found.estimates), disturbance, weights, step)
        methods = list(project.tuning.methods) or [*DEFAULT_METHODS, *(FOR_SEVERAL if len(tasks) > 1 else ())]
        self.proposals = propose(
            known,
            tasks,
            today,
            methods,
            model=self.model,
            limit=self.limit,
            share=self.share,
            seed=project.analysis.seed + 1,
        )
        laws = [today, *(p.controller for p in self.proposals if p.controller is not None)]
        self.w = max((common_grid(known.nominal, law, highest) for law in laws), key=len)
        self.drawn = known.draw(DRAWS, self.seed)
        self.response = self.drawn.response(self.w)

    def retuning(self) -> Retuning:
        """The table, the curves and the notes."""
        today = self._judged(self.today)
        judged = {p.method: self._judged(p.controller) for p in self.proposals if p.controller is not None}
        best, why = reason_of(self.proposals, judged, today, [loop.place for loop in self.asked], self._asked_for())
        table = tuple(self._loop(loop, today, judged, best, why) for loop in self.asked)
        drawn = best or next((p.method for p in self.proposals if p.controller is not None), None)
        chosen = next((p for p in self.proposals if p.method == drawn), None)
        curves = () if chosen is None or chosen.controller is None else self._curves(chosen)
        return Retuning(table, curves)

    def _asked_for(self) -> dict[str, Any]:
        mu = self.limits.mu if self.around.weights is not None else None
        return {"Ms": self.limit, "share": self.share, "mu": mu}

    def _judged(self, controller: Controller) -> dict[Place, dict[str, Any]]:
        """Metrics and drawn plants of every loop under one set of controllers."""
        found = drawn_peaks(self.response, controller, self.w)
        inputs = [loop.place[0] for loop in self.asked]
        mu_share = None
        if found is not None:
            mu_share = share_below_mu(self.drawn, controller, found.stable, self.w, self.limits.mu or MU, self.around)
        systems = {"model": self.model, "plant": self.known.nominal}
        mus = {name: mu_table(system, controller, self.around) for name, system in systems.items()}
        return {
            loop.place: {
                "metrics": {
                    name: loop_table(system, controller, loop.place, self.around) | {"mu": mus[name]}
                    for name, system in systems.items()
                },
                "drawn": drawn_table(found, loop.place[0], inputs, self.limit, self.seed, mu_share),
            }
            for loop in self.asked
        }

    def _loop(
        self,
        loop: Asked,
        today: dict[Place, dict[str, Any]],
        judged: Mapping[str, dict[Place, dict[str, Any]]],
        best: str | None,
        why: str,
    ) -> dict[str, Any]:
        project = self.study.project
        k = self.study.loop_experiment
        assert k is not None
        i, j = loop.place
        price = None
        rows = []
        for p in self.proposals:
            row, given = self._proposal(loop, p, judged)
            rows.append(row)
            price = given if given is not None else price
        return {
            "input": project.input_names[i],
            "output": project.output_names[j],
            "controller_of": project.experiments[k].name,
            "form": loop.shown.form,
            "gain_unit": loop.shown.gain_unit,
            "time_unit": project.time_unit,
            "notation": loop.shown.notation,
            "limits": {
                "Ms": self.limit,
                "mu": self.limits.mu,
                "share": self.share,
                "crossover": None if loop.task is None else loop.task.crossover,
                "why": loop.why,
            },
            "assumptions": list(loop.assumptions),
            "current": {
                "settings": law_settings(loop.entry, loop.shown, 1.0),
                "shown": vendor_settings(loop.entry, loop.shown, 1.0),
                **today[loop.place],
            },
            "proposals": rows if loop.task is not None else [],
            "recommended": best if loop.task is not None else None,
            "reason": why if loop.task is not None else loop.why,
            "price": price,
        }

    def _proposal(
        self, loop: Asked, p: Proposal, judged: Mapping[str, dict[Place, dict[str, Any]]]
    ) -> tuple[dict[str, Any], float | None]:
        """One row of the table, and the price where the method has one."""
        nothing: dict[str, Any] = {"settings": None, "shown": None, "metrics": None, "drawn": None}
        if loop.task is None:
            return {"method": p.method, "note": loop.why, **nothing}, None
        at = list(self.tasks).index(loop.task)
        row: dict[str, Any] = {"method": p.method, "note": p.notes[at], **nothing}
        if p.controller is None or not p.answered[at]:
            return row, p.price[at]
        law = p.controller.entries[loop.place]
        row["settings"] = law_settings(law, loop.shown, loop.slope)
        if row["settings"] is not None and isinstance(law, Linear):
            others = {
                self.study.project.output_names[j]: law_settings(entry, loop.shown, 1.0)["tf"]
                for (i, j), entry in p.controller.entries.items()
                if i == loop.place[0] and j != loop.place[1]
            }
            row["settings"] |= {"others": others} if others else {}
        row["shown"] = vendor_settings(law, loop.shown, loop.slope)
        return row | judged[p.method][loop.place], p.price[at]

    # -- what the report draws --------------------------------------------------------------------------------------

    def _curves(self, chosen: Proposal) -> tuple[RetuningCurves, ...]:
        assert chosen.controller is not None
        laws = {"before": self.today, "after": chosen.controller}
        tail = (1 - self.study.project.analysis.confidence) / 2
        plants = [self.known.nominal, *(self.drawn.plant(k) for k in range(BAND_DRAWS))]
        replays = {name: replayed(self.known.nominal, law, self.around) for name, law in laws.items()}
        seen = self.around.disturbance
        found = []
        for loop in self.asked:
            if loop.task is None:
                continue
            names = self.study.project
            t = np.linspace(0, self._span(loop.place, laws), POINTS)
            bands = {
                (kind, name): band(plants, law, loop.place, kind, t, self.around.step, (tail, 1 - tail))
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

    def _span(self, place: Place, laws: Mapping[str, Controller]) -> float:
        """Long enough for the slower of the loops to settle, up to a hundred times the inverse crossover."""
        slowest = []
        for law in laws.values():
            try:
                crossover = margins(self.known.nominal, law, place[0]).phase_margin_frequency
            except LoopError:
                continue
            _, ki, *_ = entry.parallel if isinstance(entry := law.entries[place], PID) else (0.0, 0.0)
            gain = abs(self.known.nominal[place[1], place[0]].dc_gain)
            rate = min(crossover, abs(ki) * gain) if ki and np.isfinite(gain) else crossover
            slowest.append(rate if np.isfinite(rate) else crossover)
        finite = [rate for rate in slowest if np.isfinite(rate) and rate > 0]
        return 12 / min(finite) if finite else 20 * self.around.step
