"""Which proposal is recommended, if any."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from trueplant.result import DrawnShares, LoopMetrics, MetricsOfBoth
from trueplant.result.recommendation_words import Outlook, Recommendation
from trueplant.result.trade_off import trade_off
from trueplant.study import levels
from trueplant.study.study import Place
from trueplant.tune import CERTAIN, PERFORMANCE, Proposal
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
    sound: float | None = None
    """Ms below which today's loop on an unchanged plant is left alone; None where the plant has changed."""


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
    def mu(self) -> float:
        """Of robust performance on the plant; infinite where it is unstable or nothing is known."""
        found = next(iter(self.metrics.values())).plant.mu
        return float("inf") if found is None else found.upper

    def on_plant(self, places: Sequence[Place]) -> list[LoopMetrics]:
        return [self.metrics[place].plant for place in places]

    def share(self, limits: Limits) -> float:
        """Of drawn plants on which all limits are held, at most."""
        if (drawn := self.all_loops) is None:
            return 0.0
        return drawn.share_all if limits.mu is None else min(drawn.share_all, drawn.mu_share or 0.0)

    def keeps(self, limits: Limits) -> bool:
        """Are the limits held for the share of plants asked for, and that of mu on the plant as estimated?"""
        return self.share(limits) >= limits.share and (limits.mu is None or self.mu <= limits.mu)

    def is_sound(self, limits: Limits) -> bool:
        """On a plant that has not changed: is Ms of every loop low enough, and mu within its limit?"""
        if limits.sound is None:
            return False
        highest = [None if one is None else one.Ms.q95 for one in self.drawn.values()]
        if any(Ms is None or Ms > limits.sound for Ms in highest):
            return False
        drawn = self.all_loops
        enough = drawn is not None and (drawn.mu_share or 0.0) >= limits.share
        return limits.mu is None or (enough and self.mu <= limits.mu)


def recommend(
    proposals: Sequence[Proposal],
    judged: Mapping[str, Judged],
    today: Judged,
    loops: Mapping[Place, str],
    limits: Limits,
    time_unit: str = "",
) -> Recommendation:
    """The method to use for all loops, if any, and why (not); loops: the name of each input by (input, output).

    Only what holds the limits for the share of independently drawn plants, and where mu is limited has none larger than
    today's. Where today's settings hold them too, or the plant has not changed and their margins are sound, it has to
    lower the error of a load step by a tenth in one loop and raise it by as much in none; on the unchanged plant
    overshoot and settling may not pay for it, and margin only where that error halves. Of several ours is taken, or
    where today's mu is too large the one that was sought for mu, else that with the least load error. Where none holds
    the limits, the one that lowers mu by a tenth.
    """
    places = list(loops)
    said = Recommendation(Outlook.NO_ANSWER, limits.Ms, 0.0, limits.share, mu=limits.mu, time_unit=time_unit)
    if not judged:
        return replace(said, notes=tuple(f"{p.method}: {p.notes[0]}" for p in proposals))

    def chosen(method: str, outlook: Outlook) -> Recommendation:
        pairs = list(zip(loops.values(), today.on_plant(places), judged[method].on_plant(places), strict=True))
        stable = all(old.stable and new.stable for _, old, new in pairs)
        return replace(
            said,
            outlook=outlook,
            share=judged[method].share(limits),
            method=method,
            today=None if today.all_loops is None else today.share(limits),
            changes=tuple(trade_off(*pair) for pair in pairs) if stable else (),
        )

    whole = [p.method for p in proposals if p.method in judged and all(p.answered)]
    good = [method for method in whole if judged[method].keeps(limits)]
    usual = [m for m in good if m not in DESIGNS] or good
    better = [m for m in usual if limits.mu is None or judged[m].mu <= today.mu]
    sound = today.is_sound(limits)
    if sound or today.keeps(limits):
        better = [m for m in better if _pays(_load_changes(judged[m], today, places))]
        if sound:
            better = [m for m in better if not _costs(judged[m], today, places)]
        if not better:
            kept = Outlook.KEEP_UNCHANGED if sound else Outlook.KEEP
            return replace(said, outlook=kept, share=today.share(limits))
    if better:
        first = CERTAIN if limits.mu is None or today.mu <= limits.mu else PERFORMANCE
        least = min(better, key=lambda m: _worst_load(judged[m], today, places))
        return chosen(first if first in better else least, Outlook.CHANGE)
    if usual:
        return replace(said, outlook=Outlook.NO_BETTER)
    if limits.mu is not None:
        lower = [m for m in whole if m not in DESIGNS and judged[m].mu <= levels.WORTH_A_CHANGE * today.mu]
        held = [m for m in lower if (drawn := judged[m].all_loops) is not None and drawn.stable >= limits.share]
        if held:
            return chosen(min(held, key=lambda m: judged[m].mu), Outlook.LESS_MU)
    best = max(found.share(limits) for found in judged.values())
    notes = tuple(p.notes[0] for p in proposals if p.method == CERTAIN and p.controller is None)
    return replace(said, outlook=Outlook.NONE_HOLDS, share=best, notes=notes)


def _pays(changes: Sequence[float]) -> bool:
    """Does a load step's error fall by a tenth in one loop, and rise by as much in none?"""
    return bool(changes) and min(changes) <= levels.WORTH_A_CHANGE - 1 and max(changes) <= 1 - levels.WORTH_A_CHANGE


def _costs(found: Judged, today: Judged, places: Sequence[Place]) -> bool:
    """Does a set-point step overshoot more or settle later in some loop, or is margin given for a little speed?"""
    for new, old in zip(found.on_plant(places), today.on_plant(places), strict=True):
        less_margin = new.Ms is not None and old.Ms is not None and new.Ms > old.Ms + levels.MORE_PEAK
        if less_margin and new.load and old.load and new.load.iae > levels.WORTH_MARGIN * old.load.iae:
            return True
        if new.setpoint is None or old.setpoint is None:
            continue
        if (new.setpoint.overshoot or 0.0) > (old.setpoint.overshoot or 0.0) + levels.MORE_OVERSHOOT:
            return True
        if levels.WORTH_A_CHANGE * new.setpoint.settling > old.setpoint.settling:
            return True
    return False


def _load_changes(found: Judged, today: Judged, places: Sequence[Place]) -> list[float]:
    """Relative change of the load step's IAE on the plant, of each loop; empty where today's loops are unstable."""
    pairs = list(zip(found.on_plant(places), today.on_plant(places), strict=True))
    if not all(new.stable and old.stable for new, old in pairs):
        return []
    loads = [(new.load, old.load) for new, old in pairs]
    return [new.iae / old.iae - 1 for new, old in loads if new and old and old.iae > 0]


def _worst_load(found: Judged, today: Judged, places: Sequence[Place]) -> float:
    change = _load_changes(found, today, places)
    if change:
        return max(change)
    loads = [m.load for m in found.on_plant(places) if m.stable]
    return sum(load.iae for load in loads if load) if len(loads) == len(places) else float("inf")
