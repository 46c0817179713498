"""Every tuning method by name, for all loops of a plant at once, kept within what a record knows of the plant."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from trueplant.errors import LoopError
from trueplant.loop import PID, Controller, Linear
from trueplant.loop.pid import Entry
from trueplant.lti import TransferFunction, TransferMatrix, UncertainPlant
from trueplant.robust import margins
from trueplant.tune import levels
from trueplant.tune.forms import converted
from trueplant.tune.integral import Limits
from trueplant.tune.methods import METHODS
from trueplant.tune.performance import Weighting, tune_performance
from trueplant.tune.response import axis, frequencies
from trueplant.tune.retune import retune
from trueplant.tune.several import SEVERAL
from trueplant.tune.shaping import shaped_like
from trueplant.tune.state_space import DESIGNS, fastest
from trueplant.tune.together import LoopTask, TunedTogether, bare_law, slow_down, tune_together, with_entries


class OwnMethod(StrEnum):
    """Methods that use more than the plant alone."""

    CERTAIN = "certain-share"
    """The largest integral gains that hold the limits for a share of the plants that the record leaves possible."""
    AS_DESIGNED = "as-designed"
    """Each loop again as nearly as possible what it was on the model that its controller was tuned on."""
    PERFORMANCE = "mu"
    """Nearly the least mu of robust performance under the declared weights."""


CERTAIN, AS_DESIGNED, PERFORMANCE = OwnMethod.CERTAIN, OwnMethod.AS_DESIGNED, OwnMethod.PERFORMANCE
ALL_METHODS = (*OwnMethod, *METHODS, *SEVERAL, *DESIGNS)
"""Ours, the rules, those for several loops, and those whose answer is no PID."""


@dataclass(frozen=True, eq=False)
class Proposal:
    """What one method says for all loops."""

    method: str
    controller: Controller | None
    """Loops without an answer keep today's law; None if no loop has an answer, or nothing stable was found."""
    answered: tuple[bool, ...]
    """Of each task."""
    notes: tuple[str, ...]
    """One for each task, empty where there is nothing to say."""
    price: tuple[float | None, ...]
    """Integral gain given up for certainty, by `CERTAIN` only."""


def propose(
    uncertain: UncertainPlant,
    tasks: Sequence[LoopTask],
    today: Controller,
    methods: Sequence[str],
    *,
    model: TransferMatrix | None = None,
    weighting: Weighting | None = None,
    limit: float = levels.PEAK,
    share: float = levels.SHARE,
    confidence: float = levels.CONFIDENCE,
    seed: int = 0,
    say: Callable[[str], None] = lambda method: None,
) -> tuple[Proposal, ...]:
    """Settings by each method, in the given order; model: what today's controllers were tuned on; say: is told of each.
    weighting: of robust performance, which the method "mu" needs. It starts from the methods before it.

    The rules see each loop's own element, later by what the task calls unseen or by the error of its dead time,
    whichever is longer. Whatever they say is slowed down until the loop's gain is below 1 beyond the task's
    crossover, and, where the loops together are unstable or have a sensitivity peak above 2 that none has alone, until
    they have not. The notes say so.

    Raises LoopError for unknown methods.
    """
    unknown = [name for name in methods if name not in ALL_METHODS]
    if unknown:
        raise LoopError(f"unknown tuning method {unknown[0]!r}: use {', '.join(ALL_METHODS)}")
    found: list[Proposal] = []
    for method in methods:
        say(method)
        try:
            if method == CERTAIN:
                found.append(_certain(uncertain, tasks, today, limit, share, confidence, seed))
            elif method == AS_DESIGNED:
                found.append(_as_designed(uncertain.nominal, tasks, today, model))
            elif method == PERFORMANCE:
                known = [p.controller for p in found if p.controller is not None]
                found.append(_for_performance(uncertain.nominal, tasks, today, weighting, known, seed))
            elif method in METHODS:
                found.append(_by_rule(uncertain.nominal, tasks, today, method, limit))
            elif method in DESIGNS:
                found.append(_by_design(uncertain.nominal, tasks, today, method, limit))
            else:
                found.append(_several(uncertain.nominal, tasks, today, method, limit))
        except LoopError as error:
            found.append(_none(method, tasks, str(error)))
    return tuple(found)


def _none(method: str, tasks: Sequence[LoopTask], why: str) -> Proposal:
    return Proposal(method, None, (False,) * len(tasks), (why,) * len(tasks), (None,) * len(tasks))


def _certain(
    uncertain: UncertainPlant,
    tasks: Sequence[LoopTask],
    today: Controller,
    limit: float,
    share: float,
    confidence: float,
    seed: int,
) -> Proposal:
    """Loops that have nothing to gain keep today's law, if the others can be tuned round it."""

    def tuned(some: Sequence[LoopTask]) -> TunedTogether:
        return tune_together(uncertain, some, today, limit=limit, share=share, confidence=confidence, seed=seed)

    found = tuned(tasks)
    gaining = [task for task in tasks if _gain(found.controller, task) > levels.WORTH_TUNING * _gain(today, task)]
    if gaining and len(gaining) < len(tasks):
        with contextlib.suppress(LoopError):
            return _round_the_rest(tuned(gaining), tasks, gaining)
    laws, notes = zip(*(_in_form(found.controller, task) for task in tasks), strict=True)
    controller = with_entries(found.controller, dict(zip(tasks, laws, strict=True)))
    return Proposal(CERTAIN, controller, (True,) * len(tasks), tuple(notes), found.price)


def _gain(controller: Controller, task: LoopTask) -> float:
    """Integral gain in the direction that the loop needs; 0 for laws that are no PID."""
    law = controller.entries.get((task.input, task.output))
    return abs(law.parallel[1]) if isinstance(law, PID) else 0.0


def _round_the_rest(found: TunedTogether, tasks: Sequence[LoopTask], gaining: Sequence[LoopTask]) -> Proposal:
    laws, notes = {}, []
    prices = dict(zip(gaining, found.price, strict=True))
    for task in tasks:
        if task in prices:
            laws[task], note = _in_form(found.controller, task)
        else:
            note = (
                "keep today's settings here: there is nothing to gain within the limits, and the other loops are set "
                "round them"
            )
        notes.append(note)
    controller = with_entries(found.controller, laws)
    return Proposal(CERTAIN, controller, (True,) * len(tasks), tuple(notes), tuple(prices.get(t) for t in tasks))


def _in_form(controller: Controller, task: LoopTask) -> tuple[PID, str]:
    """The law in the form that the task's controller has, as far as there is an equivalent."""
    law = controller.entries[task.input, task.output]
    assert isinstance(law, PID)
    try:
        return converted(law, task.like.form), ""
    except LoopError:
        return law, f'in the form "{law.form}": there is no equivalent in the form "{task.like.form}"'


def _by_rule(
    plant: TransferMatrix, tasks: Sequence[LoopTask], today: Controller, method: str, limit: float
) -> Proposal:
    laws: dict[LoopTask, PID] = {}
    notes = []
    for task in tasks:
        later = max(task.unseen, task.dead_time_error)
        seen = plant[task.output, task.input] * TransferFunction.rational([1.0], [1.0], later)
        found = retune(seen, task.like, [method], kind=task.kind, limits=Limits(limit, limit))[0]
        note = [found.note] if found.note else []
        if found.pid is not None:
            laws[task], factor = _within_crossover(plant[task.output, task.input], found.pid, task)
            if factor < levels.SAME_SPEED:
                note.append(f"slowed down by {1 / factor:.3g} to keep its crossover")
        notes.append(note)
    if not laws:
        return _none(method, tasks, "; ".join(notes[0]))
    return _slowed_together(plant, tasks, with_entries(today, laws), laws, method, notes)


def _as_designed(
    plant: TransferMatrix, tasks: Sequence[LoopTask], today: Controller, model: TransferMatrix | None
) -> Proposal:
    """Today's settings changed so that each loop is again what it was on the model."""
    laws: dict[LoopTask, PID] = {}
    notes: list[list[str]] = []
    for task in tasks:
        law, note = today.entries[task.input, task.output], ""
        try:
            if model is None or model[task.output, task.input].is_zero:
                raise LoopError("there is no model of this loop that it could be like")
            if not isinstance(law, PID):
                raise LoopError("today's controller is no PID")
            g = plant[task.output, task.input]
            found = shaped_like(g, law, model[task.output, task.input], task.crossover)
            laws[task], note = _in_form(with_entries(today, {task: found}), task)
        except LoopError as error:
            note = str(error)
        notes.append([note] if note else [])
    if not laws:
        return _none(AS_DESIGNED, tasks, "; ".join(notes[0]))
    return _slowed_together(plant, tasks, with_entries(today, laws), laws, AS_DESIGNED, notes)


def _for_performance(
    plant: TransferMatrix,
    tasks: Sequence[LoopTask],
    today: Controller,
    weighting: Weighting | None,
    known: Sequence[Controller],
    seed: int,
) -> Proposal:
    if weighting is None:
        raise LoopError('needs both weights of robust performance: declare wI and wP in the table "robustness"')
    found = tune_performance(plant, tasks, today, weighting, known=known, seed=seed)
    laws, said = zip(*(_in_form(found.controller, task) for task in tasks), strict=True)
    notes = tuple(f"mu {found.mu.upper:.3g}; {note}" if note else f"mu {found.mu.upper:.3g}" for note in said)
    controller = with_entries(found.controller, dict(zip(tasks, laws, strict=True)))
    return Proposal(PERFORMANCE, controller, (True,) * len(tasks), notes, (None,) * len(tasks))


def _several(
    plant: TransferMatrix, tasks: Sequence[LoopTask], today: Controller, method: str, limit: float
) -> Proposal:
    """The rules for several loops, on the plant with its pairs brought to the diagonal."""
    if len(tasks) < 2 or len(tasks) != len(today.entries):
        raise LoopError("is for several loops that are all tuned")
    elements = [
        [plant[j.output, i.input] * TransferFunction.rational([1.0], [1.0], i.unseen) for i in tasks] for j in tasks
    ]
    square = TransferMatrix(tuple(map(tuple, elements)), plant.time_unit)
    kinds = {task.kind for task in tasks}
    kind = kinds.pop() if len(kinds) == 1 else "PI"
    tuned = SEVERAL[method](square, Limits(limit, limit), kind)
    laws, notes = {}, []
    for k, task in enumerate(tasks):
        bare = tuned.entries[k, k]
        assert isinstance(bare, PID)
        kept = replace(bare_law(task), Kc=bare.Kc, Ti=bare.Ti, Td=bare.Td, alpha=bare.alpha)
        law, note = _in_form(with_entries(today, {task: kept}), task)
        laws[task], factor = _within_crossover(plant[task.output, task.input], law, task)
        said = [note] if note else []
        notes.append(
            said + ([f"slowed down by {1 / factor:.3g} to keep its crossover"] if factor < levels.SAME_SPEED else [])
        )
    return _slowed_together(plant, tasks, with_entries(today, laws), laws, method, notes)


def _within_crossover(g: TransferFunction, pid: PID, task: LoopTask) -> tuple[PID, float]:
    """The law slowed down until |g Q| is at most 1 beyond the task's crossover, and the factor."""
    w = frequencies([g])
    w = np.append(task.crossover, w[w > task.crossover])
    if pid.sample_time is not None:
        w = w[w <= np.pi / pid.sample_time]
    size = np.abs(g(axis(w)))

    def passes(factor: float) -> bool:
        law = slow_down(pid, factor) if factor < 1 else pid
        return bool(np.max(size * np.abs(law.feedback(axis(w))), initial=0.0) <= 1 + levels.ROUNDING)

    if passes(1.0):
        return pid, 1.0
    low, high = levels.SLOWEST_CROSSOVER, 1.0
    for _ in range(50):
        middle = float(np.sqrt(low * high))
        low, high = (middle, high) if passes(middle) else (low, middle)
    return slow_down(pid, low), low


def _slowed_together(
    plant: TransferMatrix,
    tasks: Sequence[LoopTask],
    controller: Controller,
    laws: dict[LoopTask, PID],
    method: str,
    notes: list[list[str]],
) -> Proposal:
    """All loops slowed down by one factor where they disturb each other too much."""
    answered = tuple(task in laws for task in tasks)
    alone = [_peak(plant, controller, task, "open") for task in laws]
    factor = 1.0
    if not all(
        _peak(plant, controller, t, "closed") <= max(levels.USUAL_PEAK, a) for t, a in zip(laws, alone, strict=True)
    ):
        for factor in levels.COMMON_SLOWDOWNS[1:]:
            slower = with_entries(controller, {t: slow_down(pid, float(factor)) for t, pid in laws.items()})
            if all(_peak(plant, slower, task, "closed") <= levels.USUAL_PEAK for task in laws):
                controller = slower
                break
        else:
            raise LoopError("its settings are not calm together with the other loops, however far they are slowed down")
    for task, note in zip(tasks, notes, strict=True):
        if factor < 1 and task in laws:
            note.append(f"all loops slowed down by {1 / factor:.3g} because they disturb each other")
    said = tuple("; ".join(note) for note in notes)
    return Proposal(method, controller, answered, said, (None,) * len(tasks))


def _peak(plant: TransferMatrix, controller: Controller, task: LoopTask, others: str) -> float:
    """Ms of one loop; infinite if it is unstable."""
    try:
        return margins(plant, controller, task.input, others).Ms
    except LoopError:
        return np.inf


def _by_design(
    plant: TransferMatrix, tasks: Sequence[LoopTask], today: Controller, method: str, limit: float
) -> Proposal:
    """A controller by optimal control for all tasks' inputs and outputs at once."""
    if len(tasks) != len(today.entries):
        raise LoopError("replaces all controllers at once: tune all loops")
    square = TransferMatrix(tuple(tuple(plant[j.output, i.input] for i in tasks) for j in tasks), plant.time_unit)
    scans = [task.like.sample_time for task in tasks]
    found = fastest(square, method, [task.crossover for task in tasks], limit, scans)
    entries: dict[tuple[int, int], Entry] = {}
    for (i, j), entry in found.controller.entries.items():
        assert isinstance(entry, Linear)
        entries[tasks[i].input, tasks[j].output] = replace(entry, limits=tasks[i].like.limits)
    controller = replace(today, entries=entries)
    note = (
        "no PID: there is no equivalent in any of its forms, enter it as a transfer function (designed for a bandwidth "
        f"of {found.bandwidth:.3g} rad per time unit and a Pade approximation of order {found.pade_order}, judged with "
        "the exact dead time)"
    )
    return Proposal(method, controller, (True,) * len(tasks), (note,) * len(tasks), (None,) * len(tasks))
