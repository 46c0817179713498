"""What controllers do to every loop, judged on the plant and on plants drawn from what is not known of it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from trueplant.arrays import Array, ComplexArray
from trueplant.errors import LoopError
from trueplant.loop import PID, Controller
from trueplant.lti import DrawnPlants, TransferMatrix, UncertainPlant
from trueplant.project.tables import TuningLimits
from trueplant.result import LoopMetrics, MetricsOfBoth
from trueplant.robust import margins
from trueplant.study import levels
from trueplant.study.loops.metrics import (
    Surroundings,
    drawn_peaks,
    drawn_shares,
    loop_metrics_of,
    mu_peak,
    share_below_mu,
)
from trueplant.study.loops.recommendation import Judged, Limits
from trueplant.study.study import Place

UNSEEN = LoopMetrics(False, "the model was not looked at")


@dataclass(frozen=True, eq=False)
class Judge:
    """All that controllers of the same loops are judged by."""

    model: TransferMatrix | None
    """(n_y, n_u), as `known`: the inputs without measured disturbances; None: only the plant is looked at."""
    known: UncertainPlant
    places: Sequence[Place]
    """(input, output) of every loop."""
    limits: Limits
    around: Surroundings
    w: Array
    """Frequencies that serve all controllers that will be judged."""
    drawn: DrawnPlants
    response: ComplexArray
    """(count, n_w, n_y, n_u) of the drawn plants."""
    seed: int
    """Of the draws."""

    def of(self, controller: Controller) -> Judged:
        """Metrics and drawn plants of every loop under one set of controllers."""
        found = drawn_peaks(self.response, controller, self.w)
        inputs = [i for i, _ in self.places]
        mu_share = None
        if found is not None:
            limit = self.limits.mu or levels.LIMIT_MU
            mu_share = share_below_mu(self.drawn, controller, found.stable, self.w, limit, self.around)
        plant = self.metrics(self.known.nominal, controller)
        model = [UNSEEN] * len(plant) if self.model is None else self.metrics(self.model, controller)
        both = zip(self.places, model, plant, strict=True)
        return Judged(
            {place: MetricsOfBoth(model, plant) for place, model, plant in both},
            {(i, j): drawn_shares(found, i, inputs, self.limits.Ms, self.seed, mu_share) for i, j in self.places},
        )

    def metrics(self, plant: TransferMatrix, controller: Controller) -> list[LoopMetrics]:
        """Of every loop on one plant."""
        mu = mu_peak(plant, controller, self.around)
        return [loop_metrics_of(plant, controller, place, self.around, mu) for place in self.places]


def judge_of(
    model: TransferMatrix | None,
    known: UncertainPlant,
    places: Sequence[Place],
    limits: Limits,
    around: Surroundings,
    w: Array,
    seed: int,
) -> Judge:
    """The judge of a project with that seed: it draws other plants than those that proposals are made on."""
    drawn = known.draw(levels.JUDGING_DRAWS, seed + 2)
    return Judge(model, known, places, limits, around, w, drawn, drawn.response(w), seed + 2)


def response_span(plant: TransferMatrix, laws: Iterable[Controller], place: Place, least: float) -> float:
    """Long enough for the slowest of the loops to settle, up to a hundred times the inverse crossover."""
    slowest = []
    for law in laws:
        try:
            crossover = margins(plant, law, place[0]).phase_margin_frequency
        except LoopError:
            continue
        _, ki, *_ = entry.parallel if isinstance(entry := law.entries[place], PID) else (0.0, 0.0)
        gain = abs(plant[place[1], place[0]].dc_gain)
        rate = min(crossover, abs(ki) * gain) if ki and np.isfinite(gain) else crossover
        slowest.append(rate if np.isfinite(rate) else crossover)
    finite = [rate for rate in slowest if np.isfinite(rate) and rate > 0]
    return 12 / min(finite) if finite else least


def limits_of(asked: TuningLimits, weighted: bool, changed: bool) -> Limits:
    """What the loops have to keep: as asked, else the usual; mu where weights are declared."""
    return Limits(
        asked.Ms or levels.LIMIT_MS,
        asked.share or levels.LIMIT_SHARE,
        (asked.mu or levels.LIMIT_MU) if weighted else None,
        None if changed else asked.Ms or levels.HIGHEST_MS,
    )
