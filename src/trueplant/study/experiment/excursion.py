"""What the moves of a plan will do to every PV and OP, on plants that the record leaves possible."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trueplant.arrays import Array
from trueplant.loop import simulate
from trueplant.loop.many import Bank
from trueplant.lti import TransferMatrix
from trueplant.result import MoreData
from trueplant.study import levels
from trueplant.study.experiment.moves import Moves
from trueplant.study.loops.metrics import simulation_step
from trueplant.study.loops.situation import Situation


@dataclass(frozen=True, eq=False)
class Excursion:
    """From where the record worked, without noise; bands (n_t, 3) are 5 %, median and 95 % over the plants."""

    t: Array
    closed: bool
    """Are set-points moved, or OPs by hand?"""
    moved: Array
    """(n_t, n_y) set-points, or (n_t, n_u) OPs where these are moved."""
    pv: tuple[Array, ...]
    """By output: (n_t, 3)."""
    op: tuple[Array, ...]
    farthest: Array
    """(n_y + n_u, 2) lowest and highest value on any plant: PVs, then OPs."""


def excursion(situation: Situation, plan: MoreData) -> Excursion:
    """Of a plan with moves. Raises LoopError where the loop cannot be simulated."""
    project = situation.project
    closed = plan.moves[0].signal != "OP"
    names = project.output_names if closed else project.input_names
    places = {move.name: names.index(move.name) for move in plan.moves}
    moves = Moves(
        {places[m.name]: m.size for m in plan.moves},
        {places[m.name]: m.every for m in plan.moves},
    )
    sample = situation.result.data[situation.experiment].sample_time
    length = plan.length or 0.0
    rest = max(m.every for m in plan.moves)
    wanted = max(sample, (length + rest) / levels.TRIED_STEPS[1])
    h = wanted if situation.today is None else simulation_step(situation.today, wanted)
    course = moves.course(length, h, len(names), int(rest / h))
    drawn = situation.known.draw(levels.TRIED_PLANTS, project.analysis.seed)
    plants = [situation.known.nominal, *(drawn.plant(k) for k in range(drawn.count))]
    y, u = _closed(situation, plants, course, h) if closed else _open(situation, plants, course, h)
    thin = np.unique(np.linspace(0, len(course) - 1, min(len(course), levels.MOVED_POINTS)).astype(int))
    both = np.concatenate([y, u], axis=2)
    both = np.nan_to_num(both, nan=levels.FAR_OFF, posinf=levels.FAR_OFF, neginf=-levels.FAR_OFF)
    bands = np.moveaxis(np.quantile(both[:, thin], [0.05, 0.5, 0.95], axis=0), 0, -1)
    n_y = y.shape[2]
    return Excursion(
        t=h * thin,
        closed=closed,
        moved=(course + (situation.y0 if closed else situation.u0))[thin],
        pv=tuple(bands[:, i] for i in range(n_y)),
        op=tuple(bands[:, n_y + j] for j in range(u.shape[2])),
        farthest=np.column_stack([both.min(axis=(0, 1)), both.max(axis=(0, 1))]),
    )


def _closed(situation: Situation, plants: list[TransferMatrix], course: Array, h: float) -> tuple[Array, Array]:
    assert situation.today is not None  # set-points are planned where a controller is declared
    load = np.zeros((len(course), situation.u0.size))
    r = course + situation.y0
    return Bank.of(plants, h).run(situation.today, r, load, y0=situation.y0, u0=situation.u0, limits=situation.limits)


def _open(situation: Situation, plants: list[TransferMatrix], course: Array, h: float) -> tuple[Array, Array]:
    still = np.tile(situation.y0, (len(course), 1))
    u = course + situation.u0
    runs = [
        simulate(plant, None, still, h, u=u, limits=situation.limits, u0=situation.u0, y0=situation.y0)
        for plant in plants
    ]
    return np.array([run.y_true for run in runs]), np.array([run.u for run in runs])
