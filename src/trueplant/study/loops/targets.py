"""What is asked of each loop that is to be retuned: what is known of it, and how fast it may become."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from trueplant.identify import OutputEstimate, unanswered
from trueplant.loop import PID, Controller, Linear, LinearLoop
from trueplant.lti import TransferFunction
from trueplant.result import Code, ControllerCheck, Reason
from trueplant.study import levels
from trueplant.study.loops.settings import Shown, slope_of
from trueplant.study.plant.identified import Identified
from trueplant.study.study import Place, Study
from trueplant.tune import LoopTask, unseen_dead_time
from trueplant.tune.response import axis, frequencies

Bands = tuple[tuple[tuple[float, float] | None, ...], ...]


@dataclass(frozen=True)
class Target:
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


def not_as_declared(study: Study, checks: Sequence[ControllerCheck]) -> tuple[Reason, ...]:
    """Which controllers of today's loop did not write OP as they are declared."""
    assert study.loop_experiment is not None
    name = study.project.experiments[study.loop_experiment].name
    why = (
        "no settings are proposed: today's controller is what they are set against, and OP was not written by the one "
        "declared: correct its [[controller]] entry, or give the stretch in which it holds a file of its own"
    )
    return tuple(
        Reason(Code.TUNING, why, one.input) for one in checks if one.experiment == name and one.confirmed is False
    )


def target_of(
    study: Study,
    identified: Identified,
    today: LinearLoop,
    entry: PID | Linear,
    place: Place,
    bands: Bands | None,
) -> Target:
    """What is known and asked about the loop at (input, output).

    today: the plant as estimated with today's controllers; entry: the controller of this loop as in the project;
    bands: `speaking_band` of the record, or None.
    """
    i, j = place
    tuning = study.project.tuning
    assert tuning is not None  # nothing is retuned without it
    estimates, plant = identified.estimates, today.plant
    now = today.controller.entries[place]
    slope = slope_of(entry, now)
    shown = Shown.of(study.project, entry, i, j)
    g = plant[j, i]
    closed = _not_known(study, identified, i, j, g)
    if closed:
        return Target(place, entry, slope, None, closed, (), shown)
    limit, why = _crossover_limit(study, today, place, None if bands is None else bands[j][i])
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
    kind = tuning.kind or ("PID" if isinstance(now, PID) and now.parallel[2] * now.parallel[0] > 0 else "PI")
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
    return Target(place, entry, slope, task, why, tuple(assumptions), shown)


def _not_known(study: Study, identified: Identified, i: int, j: int, g: TransferFunction) -> str:
    """Why the loop over this element cannot be tuned, or nothing."""
    name = f"{study.project.input_names[i]} -> {study.project.output_names[j]}"
    if g.is_zero:
        return f"the plant has no response {name}, over which this loop is closed"
    estimates = identified.estimates
    if (j, i) not in identified.specs:
        return ""
    if j not in estimates:
        return f"{name} could not be estimated from these data"
    reasons = unanswered(estimates[j])
    for spec, part in zip(estimates[j].row.specs, estimates[j].row.slices, strict=True):
        if spec.column == i:
            names = spec.structure.names
            for index in range(part.start, part.stop):
                if index in reasons:
                    return f"{name}: {names[index - part.start].replace('_', ' ')} is not known: {reasons[index].text}"
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
    study: Study, today: LinearLoop, place: Place, speaks: tuple[float, float] | None
) -> tuple[float, str]:
    """The highest crossover that a proposal may have, and what sets it."""
    assert study.project.tuning is not None
    unit = f"rad per {study.project.time_unit}"
    speed = study.project.tuning.limits.speed or levels.SPEED
    i, j = place
    g = today.plant[j, i]
    now, said = pace(g, today.controller, place, unit)
    if speaks is not None and now <= speaks[1] < speed * now:
        return float(speaks[1]), f"the record shows this response up to {speaks[1]:.3g} {unit}, no further"
    if speaks is not None and speaks[1] < now:
        why = f"{said}: the loop runs with it, but the record shows the response only up to {speaks[1]:.3g} {unit}"
        return now, why
    return speed * now, f"{speed:g} times {said}, the largest change made in one step"


def pace(g: TransferFunction, today: Controller, place: Place, unit: str) -> tuple[float, str]:
    """Today's crossover, or what stands for it, and what that is; `unit` of a frequency."""
    now = crossover(g, today, place)
    if now is not None:
        return now, f"today's crossover ({now:.3g} {unit})"
    lags = sum(-1 / p.real for p in g.poles if p.real < 0)
    now = 1 / (lags + max(term.dead_time for term in g.terms) or 1.0)
    return now, "the inverse of the element's lags and dead time (today's loop gain is below 1 throughout)"


def crossover(g: TransferFunction, today: Controller, place: Place) -> float | None:
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
        if spec.column == i:
            ends = (found.intervals[part, 1] - found.theta[part])[spec.structure.is_dead_time]
            longest = float(np.max(ends[np.isfinite(ends)], initial=longest))
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
