"""Which proposal is recommended, if any."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from trueplant.result import DrawnShares, LoopMetrics, MetricsOfBoth
from trueplant.result.recommendation_words import Outlook, Recommendation
from trueplant.study import levels
from trueplant.study.study import Place
from trueplant.tune import CERTAIN, Proposal
from trueplant.tune.state_space import DESIGNS


@dataclass(frozen=True)
class Limits:
    """What the loops have to keep, all of them at once."""

    Ms: float
    """Of Ms and Mt."""
    share: float
    """Of plants drawn anew."""
    mu: float | None
    """None where no weights are declared."""


@dataclass(frozen=True, eq=False)
class Judged:
    """What one set of controllers does, loop by loop."""

    metrics: Mapping[Place, MetricsOfBoth]
    """By (input, output)."""
    drawn: Mapping[Place, DrawnShares | None]

    @property
    def all_loops(self) -> DrawnShares | None:
        """The shares that hold for all loops together are the same in each."""
        return next(iter(self.drawn.values()))

    @property
    def share(self) -> float:
        """Of drawn plants on which all loops keep Ms and Mt."""
        return 0.0 if self.all_loops is None else self.all_loops.share_all

    def on_plant(self, places: Sequence[Place]) -> list[LoopMetrics]:
        return [self.metrics[place].plant for place in places]

    def keeps(self, limits: Limits) -> bool:
        """Are the limits held for the share of plants asked for?"""
        drawn = self.all_loops
        if drawn is None or drawn.share_all < limits.share:
            return False
        return limits.mu is None or (drawn.mu_share is not None and drawn.mu_share >= limits.share)


def recommend(
    proposals: Sequence[Proposal],
    judged: Mapping[str, Judged],
    today: Judged,
    places: Sequence[Place],
    limits: Limits,
) -> Recommendation:
    """The method to use for all loops, if any, and why (not).

    Ours where it holds the limits for the share of independently drawn plants, else the one of those that do which has
    the least load error. Nothing where today's settings hold as well and no load error would fall by a tenth.
    """
    good = [p.method for p in proposals if p.method in judged and all(p.answered) and judged[p.method].keeps(limits)]
    usual = [m for m in good if m not in DESIGNS] or good
    if not judged:
        notes = tuple(f"{p.method}: {p.notes[0]}" for p in proposals)
        return Recommendation(Outlook.NO_ANSWER, limits.Ms, 0.0, limits.share, notes=notes)
    if not usual:
        best = max(found.share for found in judged.values())
        notes = tuple(p.notes[0] for p in proposals if p.method == CERTAIN and p.controller is None)
        return Recommendation(Outlook.NONE_HOLDS, limits.Ms, best, limits.share, notes=notes)
    method = CERTAIN if CERTAIN in usual else min(usual, key=lambda m: _worst_load(judged[m], today, places))
    change = _load_changes(judged[method], today, places)
    if today.keeps(limits) and change and min(change) > levels.WORTH_A_CHANGE - 1:
        return Recommendation(Outlook.KEEP, limits.Ms, today.share, limits.share)
    louder = max(_noise_changes(judged[method], today, places), default=0.0)
    return Recommendation(
        Outlook.CHANGE,
        limits.Ms,
        judged[method].share,
        limits.share,
        method,
        today=None if today.all_loops is None else today.share,
        load_changes=tuple(change),
        louder=louder if louder > levels.LOUDER_NOISE else None,
    )


def _load_changes(found: Judged, today: Judged, places: Sequence[Place]) -> list[float]:
    """Relative change of the load step's IAE on the plant, of each loop; empty where today's loops are unstable."""
    pairs = list(zip(found.on_plant(places), today.on_plant(places), strict=True))
    if not all(new.stable and old.stable for new, old in pairs):
        return []
    loads = [(new.load, old.load) for new, old in pairs]
    return [new.iae / old.iae - 1 for new, old in loads if new and old and old.iae > 0]


def _noise_changes(found: Judged, today: Judged, places: Sequence[Place]) -> list[float]:
    """How many times more noise moves OP on the plant, of each loop."""
    pairs = zip(found.on_plant(places), today.on_plant(places), strict=True)
    noise = [(new.noise, old.noise) for new, old in pairs]
    return [new.op_variation / old.op_variation for new, old in noise if new and old and old.op_variation > 0]


def _worst_load(found: Judged, today: Judged, places: Sequence[Place]) -> float:
    change = _load_changes(found, today, places)
    if change:
        return max(change)
    loads = [m.load for m in found.on_plant(places) if m.stable]
    return sum(load.iae for load in loads if load) if len(loads) == len(places) else float("inf")
