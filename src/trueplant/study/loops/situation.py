"""Where a saved analysis leaves the loops: the plant with what is not known of it, today's controllers, and where they
work. All of it comes from the result and its project, without the data."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trueplant.arrays import Array
from trueplant.errors import UsageError
from trueplant.loop import Controller
from trueplant.lti import UncertainPlant
from trueplant.project import Project
from trueplant.result import ControllerCheck, Result, Trend


class NotReady(UsageError):
    """What is asked cannot be told from this result, and why."""


@dataclass(frozen=True, eq=False)
class Situation:
    """Of the experiment whose controllers stand for today's."""

    project: Project
    """As it was analysed."""
    result: Result
    known: UncertainPlant
    """(n_y, n_u): the inputs, without measured disturbances."""
    experiment: int
    declared: Controller | None
    """Today's, as the project has them; None where OP is moved by hand."""
    today: Controller | None
    """The same for small changes about y0."""
    y0: Array
    """(n_y,) and ..."""
    u0: Array
    """... (n_u,): where the record worked, in the mean."""
    limits: Array
    """(n_u, 2) of OP, infinite where none are declared."""

    @property
    def checks(self) -> Sequence[ControllerCheck]:
        """Whether today's controllers wrote the OPs of their experiment."""
        name = self.result.data[self.experiment].name
        return [one for one in self.result.methods.controller_consistency if one.experiment == name]


def situation_of(project: Project, result: Result) -> Situation:
    """Raises NotReady where nothing is answered, or where the record worked is not known."""
    if result.plant is None:
        why = result.reasons[0].message if result.reasons else "nothing was answered"
        raise NotReady(f"the analysis has no plant to try settings on: {why}")
    plans = project.experiments
    if len(plans) != len(result.data):
        raise NotReady("the project's records are not those of the result: run the analysis again")
    usable = [k for k, one in enumerate(result.data) if one.refused is None]
    closed = [k for k in usable if plans[k].closed and plans[k].controllers]
    if not usable:
        raise NotReady("none of the project's records could be used: see what the verdict says of them")
    k = (closed or usable)[-1]
    name = result.data[k].name  # the project's own may be seen from another folder
    trend = next((t for t in (() if result.curves is None else result.curves.trends) if t.name == name), None)
    if trend is None:
        raise NotReady("curves.json of the result is missing, which tells where the loops work: run the analysis again")
    y0, u0 = _mean(trend, trend.y), _mean(trend, trend.u)
    declared = project.controller(k) if closed else None
    limits = np.tile([-np.inf, np.inf], (len(project.inputs), 1))
    for i, limit in enumerate(plans[k].limits):
        if limit is not None:
            limits[i] = limit
    known = result.plant
    if declared is not None:
        known = known.keeping_signs([(j, i) for i, j in declared.entries])
    today = None if declared is None else declared.linearised(y0)
    u0 = np.clip(u0, limits[:, 0], limits[:, 1])
    return Situation(project, result, known.first(len(project.inputs)), k, declared, today, y0, u0, limits)


def in_hand(situation: Situation) -> Controller:
    """Today's controllers, where settings of theirs can be tried. Raises NotReady with the reason, where not.

    Settings are set against today's controller, so it has to be the one that wrote OP.
    """
    if situation.today is None or situation.declared is None:
        raise NotReady("no controller is declared, so there are no settings to change: declare them as [[controller]]")
    for check in situation.checks:
        if check.confirmed is False:
            raise NotReady(f"the replay of {check.input} disagrees with the record: {check.message}")
    if not situation.declared.is_decentralised:
        raise NotReady("settings are tried for one controller a loop, and these share inputs or outputs")
    return situation.today


def _mean(trend: Trend, values: Array) -> Array:
    """Over the time of a trend, whose samples may be thinned. Raises NotReady for a signal without any value."""
    weight = np.gradient(trend.t) if trend.t.size > 1 else np.ones(trend.t.size)
    known = np.isfinite(values)
    total = (known * weight[:, None]).sum(axis=0)
    if not np.all(total > 0):
        raise NotReady("a PV or OP has no usable value in the record, so it is not known where its loop works")
    found: Array = (np.where(known, values, 0.0) * weight[:, None]).sum(axis=0) / total
    return found
