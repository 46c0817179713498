"""A loop that settled, held against the plant: estimates on which it could not have are not given."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from trueplant.identify import WhyUnanswered
from trueplant.loop import LinearLoop
from trueplant.lti import UncertainPlant
from trueplant.record import Segment
from trueplant.result import ControllerCheck
from trueplant.study import levels
from trueplant.study.loops.robustness import bounded_for
from trueplant.study.plant.identified import Identified
from trueplant.study.plant.updated import updated_plant
from trueplant.study.study import Study


def against_settled_loop(study: Study, identified: Identified, checks: Sequence[ControllerCheck]) -> Identified:
    """What was identified, without any answer where today's loop, which settled, is unstable on nearly all plants that
    the estimates leave open.
    """
    known = updated_plant(study.model, identified.estimates)
    segment, loop = _settled(study, checks), study.loop(known.nominal)
    if segment is None or loop is None:
        return identified
    share = share_diverging(study.project.analysis.seed, loop, known, _span(segment))
    if share <= levels.REFUTED_SHARE:
        return identified
    where = study.project.experiments[segment.experiment].name
    text = (
        f"the loop of {where} settled, but on {100 * share:.3g} % of the plants that this estimate leaves open it "
        "would have run away: see whether the declared controller was at work all the time, or ask for another "
        "structure"
    )
    estimates = {
        i: one.without_answers(WhyUnanswered.LOOP_SETTLED, text) if i in known.rows else one
        for i, one in identified.estimates.items()
    }
    return replace(identified, estimates=estimates)


def settled_for(study: Study, checks: Sequence[ControllerCheck]) -> float | None:
    """For how long today's loop did not run away, in time units; None where no record shows that it did not."""
    segment = _settled(study, checks)
    return None if segment is None else _span(segment)


def _span(segment: Segment) -> float:
    return float(segment.t[-1] - segment.t[0])


def _settled(study: Study, checks: Sequence[ControllerCheck]) -> Segment | None:
    """The longest stretch off all limits of the experiment that stands for today's loop; None unless the declared
    controller ran it, without PV moving away from its set-point."""
    k = study.loop_experiment
    if k is None:
        return None
    own = [check for check in checks if check.experiment == study.project.experiments[k].name]
    if not own or not all(check.confirmed for check in own):
        return None
    parts = [part for s in study.segments if s.experiment == k for part in s.free_parts()]
    segment = max(parts, key=len, default=None)
    if segment is None or len(segment) < 2:
        return None
    early, late = np.array_split(segment.y - segment.r, 2)
    with np.errstate(invalid="ignore"):
        grown = np.nanstd(late, axis=0) > np.sqrt(levels.RUNS_AWAY) * np.nanstd(early, axis=0)
    return None if grown.any() else segment


def share_diverging(seed: int, loop: LinearLoop, known: UncertainPlant, span: float) -> float:
    """Share of the drawn plants on which the loop would run away within the span; 0 where that cannot be counted."""
    bounded = bounded_for(seed, loop, known, span)
    return 0.0 if bounded is None else 1.0 - float(np.mean(bounded))
