"""Settings held against the real errors of the elements that a project declares, and which no method seeks them for."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

from trueplant.loop import LinearLoop
from trueplant.result import BeforeAfter
from trueplant.result.recommendation_words import Outlook, Recommendation
from trueplant.study.loops.recommendation import Judged
from trueplant.study.loops.weighted import declared_peak
from trueplant.study.study import Progress, Study
from trueplant.tune import Proposal


def held_against_elements(
    study: Study,
    today: LinearLoop,
    proposals: Sequence[Proposal],
    judged: Mapping[str, Judged],
    choose: Callable[[Mapping[str, Judged]], Recommendation],
    limit: float,
    say: Progress,
) -> Recommendation:
    """What `choose` recommends of those judged, with its mu under the declared `elements` of [robustness].

    today: the plant as estimated with today's controllers. What has a larger mu than they have, and one above `limit`,
    is not recommended; the rest is chosen from again. Without `elements`, or a wP, it is what `choose` says.
    """
    found = first = choose(judged)
    declared = study.project.robustness
    if declared is None or declared.elements is None or declared.wP is None or found.method is None:
        return found
    laws = {p.method: p.controller for p in proposals if p.controller is not None}
    left = dict(judged)
    before = declared_peak(study, today)
    while found.method is not None:
        say(f"settings for the controllers: {found.method} under errors of the elements")
        after = declared_peak(study, replace(today, controller=laws[found.method]))
        if after <= max(before, limit):
            return _with_mu(found, BeforeAfter(before, after), declared.wI is not None)
        del left[found.method]
        found = choose(left) if left else replace(found, method=None)
    # of those that are left none was fit to be recommended from the beginning
    kept = found.outlook in (Outlook.KEEP, Outlook.KEEP_UNCHANGED)
    return found if kept else replace(first, outlook=Outlook.NO_BETTER, method=None, changes=())


def _with_mu(found: Recommendation, mu: BeforeAfter, beside: bool) -> Recommendation:
    """`beside`: the trade-offs have a mu already, that under wI alone."""
    if beside:
        return replace(found, with_elements=mu)
    return replace(found, changes=tuple(replace(change, mu=mu) for change in found.changes))
