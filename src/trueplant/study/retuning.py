"""Retuned controllers for the plant as estimated: proposals, what they do, and which holds for the likely plants."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from trueplant.errors import LoopError
from trueplant.identify import OutputEstimate, unanswered
from trueplant.loop import PID, Controller, Linear
from trueplant.lti import TransferFunction, TransferMatrix
from trueplant.mismatch import FrequencyResponse, speaking_band
from trueplant.robust import margins
from trueplant.study.drawn import uncertain_plant
from trueplant.study.result import Reason, RetuningCurves
from trueplant.study.retuning_metrics import (
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
from trueplant.study.retuning_words import Shown, law_settings, reason_of, vendor_settings
from trueplant.study.robustness import weights_of
from trueplant.tune import CERTAIN, LoopTask, Proposal, UncertainPlant, common_grid, propose, unseen_dead_time
from trueplant.tune.response import axis, frequencies

if TYPE_CHECKING:
    from trueplant.study.pipeline import Study

Array = NDArray[np.float64]
Place = tuple[int, int]

DEFAULT_METHODS = (CERTAIN, "max-ki", "simc", "lambda", "amigo", "tyreus-luyben")
FOR_SEVERAL = ("blt", "sequential")
MS, SHARE, SPEED, MU = 1.59, 0.95, 2.0, 1.0
"""Limits where the project states none: Ms of SIMC's tight settings, share of plants, times today's crossover, mu."""
DRAWS = 1000
BAND_DRAWS = 60
POINTS = 300


@dataclass(frozen=True, eq=False)
class Retuning:
    """`controllers` of the result, the report's curves, and notes."""

    table: tuple[Mapping[str, Any], ...] = ()
    curves: tuple[RetuningCurves, ...] = ()
    notes: tuple[Reason, ...] = ()


@dataclass(frozen=True)
class Asked:
    """One loop of today's controller, and what is known and asked about it."""

    place: Place
    """(input, output)"""
    entry: PID | Linear
    """As declared."""
    slope: float
    """Of a pv_transform at the mean PV; 1 without."""
    task: LoopTask | None
    """None where nothing can be tuned."""
    why: str
    """Why not, or what sets the highest crossover."""
    assumptions: tuple[str, ...]
    shown: Shown


def retuning_of(
    study: Study, plant: TransferMatrix, estimates: Mapping[int, OutputEstimate], response: FrequencyResponse | None
) -> Retuning:
    """Proposals for every loop of today's controller; empty without a [tuning] table in the project."""
    if study.project.tuning is None:
        return Retuning()
    k = study.loop_experiment
    declared = None if k is None else study.project.controller(k)
    if k is None or declared is None:
        why = "retuning needs the controllers of a usable closed experiment: declare them as [[controller]]"
        return Retuning(notes=(Reason("tuning", why),))
    if not declared.is_decentralised:
        why = "retuning is for one controller a loop, and these share inputs or outputs"
        return Retuning(notes=(Reason("tuning", why),))
    today = declared.linearised(np.nanmean(study.screened[k].record.y, axis=0))
    n_u = len(study.project.inputs)
    steady = [(j, i) for i, j in declared.entries]
    known = uncertain_plant(plant, estimates, steady).first(n_u)
    bands = None if response is None else speaking_band(response)
    asked = [_asked(study, known.nominal, estimates, declared, today, place, bands) for place in declared.entries]
    tasks = [loop.task for loop in asked if loop.task is not None]
    if not tasks:
        return Retuning(
            notes=tuple(Reason("tuning", loop.why, study.project.input_names[loop.place[0]]) for loop in asked)
        )
    return _Workshop(study, known, today, asked, tasks, estimates).retuning()


# -- what is asked of each loop -------------------------------------------------------------------------------------


def _asked(
    study: Study,
    plant: TransferMatrix,
    estimates: Mapping[int, OutputEstimate],
    declared: Controller,
    today: Controller,
    place: Place,
    bands: Any,
) -> Asked:
    i, j = place
    tuning = study.project.tuning
    assert tuning is not None  # retuning_of has asked
    entry, now = declared.entries[place], today.entries[place]
    slope = 1.0
    if isinstance(entry, PID) and isinstance(now, PID) and entry.pv_transform is not None:
        slope = next(a / b for a, b in zip(now.parallel, entry.parallel, strict=True) if b)
    shown = Shown.of(study.project, entry, i, j)
    g = plant[j, i]
    closed = _not_known(study, estimates, i, j, g)
    if closed:
        return Asked(place, entry, slope, None, closed, (), shown)
    limit, why = _crossover_limit(study, plant, today, place, None if bands is None else bands[j][i])
    scan = now.sample_time
    h, unit = study.segments[0].h, study.project.time_unit
    unseen = unseen_dead_time(g, limit, scan or h)
    assumptions = []
    if unseen:
        assumptions.append(
            f"beyond {limit:.3g} rad per {unit}, where no crossover may lie, the plant is not relied on: settings have "
            f"to stand {unseen:.3g} {unit} of dead time that could be hidden there as well"
        )
    if scan is None:
        unseen += h / 2
        assumptions.append(
            f"no scan is declared: half of the record's sample time ({h / 2:.3g} {unit}) counts as dead time"
        )
    held = [
        study.project.input_names[c]
        for c in range(plant.shape[1])
        if not plant[j, c].is_zero and (j, c) not in _varying(estimates)
    ]
    if held:
        assumptions.append(f"taken as declared, as if certain: the response of this output to {', '.join(held)}")
    like = now if isinstance(now, PID) else _like(now)
    form = tuning.form or (like.form if isinstance(now, PID) else "ideal")
    kind = tuning.kind or ("PID" if isinstance(now, PID) and now.parallel[2] else "PI")
    task = LoopTask(
        input=i,
        output=j,
        crossover=limit,
        like=_in_form(like, form),
        kind=kind,
        alpha=_alpha(now),
        unseen=unseen,
        dead_time_error=_dead_time_error(estimates, i, j),
    )
    return Asked(place, entry, slope, task, why, tuple(assumptions), shown)


def _not_known(study: Study, estimates: Mapping[int, OutputEstimate], i: int, j: int, g: TransferFunction) -> str:
    """Why the loop over this element cannot be tuned, or nothing."""
    name = f"{study.project.input_names[i]} -> {study.project.output_names[j]}"
    if g.is_zero:
        return f"the plant has no response {name}, over which this loop is closed"
    if (j, i) not in study.specs:
        return ""
    if j not in estimates:
        return f"{name} could not be estimated from these data"
    reasons = unanswered(estimates[j])
    for spec, part in zip(estimates[j].row.specs, estimates[j].row.slices, strict=True):
        if spec.column == i:
            names = spec.structure.names
            for index in range(part.start, part.stop):
                if index in reasons:
                    return f"{name}: {names[index - part.start].replace('_', ' ')} is not known: {reasons[index]}"
    return ""


def _varying(estimates: Mapping[int, OutputEstimate]) -> set[tuple[int, int]]:
    """(output, column) of the elements with at least one answered parameter."""
    found = set()
    for i, estimate in estimates.items():
        reasons = unanswered(estimate)
        for spec, part in zip(estimate.row.specs, estimate.row.slices, strict=True):
            if any(k not in reasons for k in range(part.start, part.stop)):
                found.add((i, spec.column))
    return found


def _crossover_limit(
    study: Study, plant: TransferMatrix, today: Controller, place: Place, speaks: Any
) -> tuple[float, str]:
    """The highest crossover that a proposal may have, and what sets it."""
    assert study.project.tuning is not None
    unit = f"rad per {study.project.time_unit}"
    speed = study.project.tuning.limits.speed or SPEED
    i, j = place
    now = _crossover(plant[j, i], today, place)
    if now is None:
        lags = sum(-1 / p.real for p in plant[j, i].poles if p.real < 0)
        now = 1 / (lags + max(term.dead_time for term in plant[j, i].terms) or 1.0)
        said = "the inverse of the element's lags and dead time (today's loop gain is below 1 throughout)"
    else:
        said = f"today's crossover ({now:.3g} {unit})"
    if speaks is not None and now <= speaks[1] < speed * now:
        return float(speaks[1]), f"the record shows this response up to {speaks[1]:.3g} {unit}, no further"
    if speaks is not None and speaks[1] < now:
        why = f"{said}: the loop runs with it, but the record shows the response only up to {speaks[1]:.3g} {unit}"
        return now, why
    return speed * now, f"{speed:g} times {said}, the largest change made in one step"


def _crossover(g: TransferFunction, today: Controller, place: Place) -> float | None:
    """The highest frequency at which the loop alone has a gain of 1."""
    w = frequencies([g])
    above = np.flatnonzero(np.abs(g(axis(w)) * today.entries[place].feedback(axis(w))) >= 1)
    return float(w[above[-1]]) if above.size and above[-1] < w.size - 1 else None


def _dead_time_error(estimates: Mapping[int, OutputEstimate], i: int, j: int) -> float:
    """From the estimate of the element's dead time to the upper end of its interval."""
    if j not in estimates:
        return 0.0
    found = estimates[j]
    longest = 0.0
    for spec, part in zip(found.row.specs, found.row.slices, strict=True):
        for k, name in enumerate(spec.structure.names):
            if spec.column == i and name.startswith("dead"):
                end = found.intervals[part.start + k, 1] - found.theta[part.start + k]
                longest = max(longest, float(end)) if np.isfinite(end) else longest
    return longest


def _like(entry: Linear) -> PID:
    return PID(Kc=1.0, sample_time=entry.sample_time, limits=entry.limits)


def _in_form(like: PID, form: str) -> PID:
    """The same controller in another form; only what is not a gain or a time is looked at later."""
    if form == like.form:
        return like
    bare = replace(like, form="parallel", Kc=None, Ti=None, Td=0.0, alpha=0.1, Kp=1.0, Ki=0.0, Kd=0.0, Tf=0.0)
    return bare if form == "parallel" else replace(bare, form=form, Kc=1.0, Kp=None)


def _alpha(entry: PID | Linear) -> float:
    """Ratio of the derivative's filter, today's where it has one that makes sense."""
    if not isinstance(entry, PID):
        return 0.1
    kp, _, kd, tf = entry.parallel
    return float(np.clip(tf * abs(kp) / abs(kd), 0.01, 1.0)) if kd and tf and kp * kd > 0 else 0.1


# -- the proposals --------------------------------------------------------------------------------------------------


class _Workshop:
    """All that the proposals of one project share."""

    def __init__(
        self,
        study: Study,
        known: UncertainPlant,
        today: Controller,
        asked: Sequence[Asked],
        tasks: Sequence[LoopTask],
        estimates: Mapping[int, OutputEstimate],
    ) -> None:
        project = study.project
        assert project.tuning is not None
        self.study, self.known, self.today, self.asked, self.tasks = study, known, today, asked, tasks
        self.limits = project.tuning.limits
        self.limit, self.share = self.limits.Ms or MS, self.limits.share or SHARE
        self.seed = project.analysis.seed + 2
        n_u = len(project.inputs)
        elements = tuple(row[:n_u] for row in study.model.elements)
        self.model = TransferMatrix(elements, study.model.time_unit)
        highest = max(task.crossover for task in tasks)
        declared = project.robustness
        weights = None
        if declared is not None and declared.wI is not None and declared.wP is not None:
            weights = weights_of(declared.wI), weights_of(declared.wP)
        step = min(study.segments[0].h, FINE / highest)
        disturbance = recovered(study, known.nominal)
        self.around = Surroundings(noise_of(study, estimates), disturbance, weights, step)
        methods = list(project.tuning.methods) or [*DEFAULT_METHODS, *(FOR_SEVERAL if len(tasks) > 1 else ())]
        self.proposals = propose(
            known, tasks, today, methods, limit=self.limit, share=self.share, seed=project.analysis.seed + 1
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
            n_u = self.known.nominal.shape[1]
            limit = self.limits.mu or MU
            mu_share = share_below_mu(self.drawn, n_u, controller, found.stable, self.w, limit, self.around)
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
        nothing = {"settings": None, "shown": None, "metrics": None, "drawn": None}
        if loop.task is None:
            return {"method": p.method, "note": loop.why, **nothing}, None
        at = list(self.tasks).index(loop.task)
        row = {"method": p.method, "note": p.notes[at], **nothing}
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
            replay_t = np.zeros(0)
            if seen is not None and all(run is not None for run in replays.values()):
                replay_t = seen.h * np.arange(len(seen.v))
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
