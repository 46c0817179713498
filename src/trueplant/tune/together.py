"""Settings for several loops at once that hold the limits for a share of the plants that a record leaves possible.

Each loop in turn gets the largest integral gain that keeps its S and T, the other loops closed, within the limits for
the share of the drawn plants (`uncertain` does this for one loop); a few rounds settle what the loops do to each other.
Fresh draws then prove all loops together: they are slowed down by one factor until the binomial test grants the share.

Where a plant has no dead time no limit on S or T stops the gain. What stops it is that the record says nothing about
the plant beyond some frequency: each loop has a crossover that its gain may not pass, and what the record does not show
may be counted as dead time (`unseen_dead_time`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from trueplant.arrays import Array, ComplexArray
from trueplant.errors import LoopError
from trueplant.loop import PID, Controller, unstable_poles
from trueplant.loop.pid import Entry
from trueplant.lti import TransferFunction, TransferMatrix, UncertainPlant
from trueplant.tune import levels
from trueplant.tune.drawn import common_grid, peaks
from trueplant.tune.forms import series_ratio
from trueplant.tune.integral import Discs, Limits, best_kp, best_td
from trueplant.tune.reduce import reduced
from trueplant.tune.response import axis
from trueplant.tune.uncertain import most_failures


@dataclass(frozen=True)
class LoopTask:
    """One loop to tune: where it is, what its controller keeps, and how fast it may become."""

    input: int
    output: int
    crossover: float
    """rad per time unit; |L| stays at or below 1 beyond it."""
    like: PID
    """Scan, limits and all else but gains and times are kept."""
    kind: str = "PI"
    alpha: float = levels.ALPHA
    unseen: float = 0.0
    """Dead time that the settings have to stand on top of the plant's own."""
    dead_time_error: float = 0.0
    """How much longer the element's dead time may be than estimated; for rules, which know no covariance."""


@dataclass(frozen=True, eq=False)
class TunedTogether:
    """Settings for all loops, ideal form, and what certainty costs."""

    controller: Controller
    nominal: Controller
    """The same rounds on the nominal plant alone."""
    slowed: float
    """Factor on kp (its square on ki) by which the proof slows the loops down; 1: not at all."""
    price: tuple[float, ...]
    """For each task the part of the nominal integral gain that is given up."""


def tune_together(
    uncertain: UncertainPlant,
    tasks: Sequence[LoopTask],
    start: Controller,
    *,
    limit: float = levels.PEAK,
    share: float = levels.SHARE,
    confidence: float = levels.CONFIDENCE,
    count: int = levels.DRAWS,
    seed: int = 0,
) -> TunedTogether:
    """PI or ideal PID controllers whose loops all keep Ms and Mt within `limit` for a share of the plants.

    start: today's controllers; those that no task names are kept. count: draws in all; half of them choose, half
    prove, so that with the given confidence at least the share of all plants holds the limits in every loop. The
    plants must be stable but for integrators.

    Raises LoopError if no settings hold for so many plants, or for too few draws.
    """
    check_plant(uncertain.nominal, tasks)
    half = count // 2
    rank = most_failures(count - half, share, confidence)
    stable = _stable_start(uncertain.nominal, tasks, start)
    w = common_grid(uncertain.nominal, stable, max(task.crossover for task in tasks))
    drawn = uncertain.draw(count, seed).response(w)
    choosing, proving = (_with_unseen(part, tasks, w) for part in (drawn[:half], drawn[half:]))
    nominal = _with_unseen(uncertain.nominal(axis(w))[None], tasks, w)
    alone = _rounds(nominal, nominal, tasks, stable, w, limit, 0.5, {})
    if unstable_poles(uncertain.nominal, alone):
        raise LoopError("the loops tuned one after the other are unstable together: check the pairing")
    # the derivative times are those of the nominal plant: what is uncertain takes gain, not shape
    derivative = {task: _pid(alone, task).Td for task in tasks}
    chosen = _rounds(choosing, nominal, tasks, alone, w, limit, (rank + 0.5) / (count - half), derivative)
    slowed, found = 0.0, chosen
    # from the slowest on, and the first failure ends it: testing many costs no confidence (fixed sequence)
    for factor in levels.SLOWDOWNS:
        slower = with_entries(chosen, {t: slow_down(_pid(chosen, t), float(factor)) for t in tasks})
        law = slower(axis(w))
        holds = np.all([peaks(version, law, w).within(limit) for version in proving], axis=(0, 2))
        if np.sum(~holds) > rank:
            break
        slowed, found = float(factor), slower
    if not slowed:
        raise LoopError(
            f"no settings were found that hold a peak of {limit:g} in all loops for {100 * share:g} % of the plants "
            "that the record leaves possible: allow a higher peak or a smaller share, or record more"
        )
    gains = [(_pid(found, t).parallel[1], _pid(alone, t).parallel[1]) for t in tasks]
    return TunedTogether(found, alone, slowed, tuple(1 - a / b for a, b in gains))


def unseen_dead_time(g: TransferFunction, crossover: float, scan: float = 0.0) -> float:
    """Dead time that brings that of g up to 0.5/crossover, where the SIMC rule has that crossover; 0 if it is longer.

    So an element about which nothing is known beyond a frequency is tuned as if all that could be hidden there were
    dead time. Half of the scan counts as dead time that is there.
    """
    try:
        known = reduced(g).dead_time
    except LoopError:
        known = max((term.dead_time for term in g.terms), default=0.0)
    return max(levels.UNSEEN / crossover - known - scan / 2, 0.0)


def _with_unseen(response: ComplexArray, tasks: Sequence[LoopTask], w: Array) -> list[ComplexArray]:
    """The plants as they are, and where a task asks for it with the dead times that could be hidden as well."""
    if not any(task.unseen for task in tasks):
        return [response]
    later = np.ones((w.size, 1, response.shape[-1]), dtype=np.complex128)
    for task in tasks:
        later[:, 0, task.input] *= np.exp(-axis(w) * task.unseen)
    return [response, response * later]


def slow_down(pid: PID, factor: float) -> PID:
    """The same law with kp times the factor, ki times its square and kd like kp: slower, damped alike."""
    if pid.form == "parallel":
        return replace(pid, Kp=(pid.Kp or 0.0) * factor, Ki=pid.Ki * factor**2, Kd=pid.Kd * factor)
    return replace(pid, Kc=(pid.Kc or 0.0) * factor, Ti=None if not pid.Ti else pid.Ti / factor)


def with_entries(controller: Controller, pids: Mapping[LoopTask, Entry]) -> Controller:
    """The controller with other laws for these tasks."""
    changed = {(task.input, task.output): pid for task, pid in pids.items()}
    return replace(controller, entries={**controller.entries, **changed})


def _pid(controller: Controller, task: LoopTask) -> PID:
    found = controller.entries[task.input, task.output]
    assert isinstance(found, PID)  # every task was given one
    return found


def check_plant(plant: TransferMatrix, tasks: Sequence[LoopTask]) -> None:
    """Raises LoopError for a plant that is unstable in open loop, and for a task without a gain at rest."""
    for row in plant.elements:
        for element in row:
            poles = element.poles
            if np.any(poles.real > levels.UNSTABLE * np.abs(poles)):
                raise LoopError(f"{element} is unstable in open loop: this tuning is for plants that are stable")
    for task in tasks:
        gain = plant[task.output, task.input].dc_gain
        if not (abs(gain) > 0):
            raise LoopError(
                f"output {task.output + 1} does not follow input {task.input + 1} at rest: no integral action can "
                "hold it there"
            )


def _stable_start(plant: TransferMatrix, tasks: Sequence[LoopTask], start: Controller) -> Controller:
    """Integral laws for all tasks with which the loops are stable: today's, made slower where need be."""
    laws: dict[LoopTask, Entry] = {}
    for task in tasks:
        today = start.entries.get((task.input, task.output))
        gain = plant[task.output, task.input].dc_gain
        sign = float(np.sign(gain))
        usable = isinstance(today, PID) and today.pv_transform is None and today.parallel[0] * sign > 0
        if usable and isinstance(today, PID) and today.parallel[1] * sign > 0:
            kp, ki, *_ = today.parallel
            pid = replace(bare_law(task), Kc=kp, Ti=kp / ki)
        else:
            size = abs(plant[task.output, task.input](np.array([1j * task.crossover]))[0])
            pid = replace(bare_law(task), Kc=sign / (levels.SLOW_START * size), Ti=levels.SLOW_START / task.crossover)
        laws[task] = pid
    factor = 1.0
    while factor >= levels.SLOWEST_START:
        slower = with_entries(start, {t: slow_down(_as_pid(law), factor) for t, law in laws.items()})
        if not unstable_poles(plant, slower):
            return slower
        factor /= 2
    raise LoopError("even very slow controllers leave these loops unstable together: check the pairing and the actions")


def _as_pid(entry: Entry) -> PID:
    assert isinstance(entry, PID)
    return entry


def bare_law(task: LoopTask) -> PID:
    """All of the task's law but gains and times, in the ideal form and engineering units."""
    bare = replace(task.like, form="ideal", Kc=1.0, Ti=None, Td=0.0, alpha=task.alpha, Kp=None, Ki=0.0, Kd=0.0, Tf=0.0)
    return replace(bare, action=None, gain_unit="engineering")


def _rounds(
    drawn: Sequence[ComplexArray],
    nominal: Sequence[ComplexArray],
    tasks: Sequence[LoopTask],
    start: Controller,
    w: Array,
    limit: float,
    share_lost: float,
    derivative: Mapping[LoopTask, float],
) -> Controller:
    """Each loop tuned on the drawn plants with the others closed, over and over; derivative times kept where given."""
    found, known = start, dict(derivative)
    for _ in range(levels.ROUNDS if len(tasks) > 1 else 1):
        for task in sorted(tasks, key=lambda t: -t.crossover):
            seen = [seen_by(version, found, task, w) for version in drawn]
            own = seen_by(nominal[0], found, task, w)[0]
            pid = _largest(seen, own, task, w, limit, share_lost, known.get(task))
            known[task] = pid.Td
            found = with_entries(found, {task: pid})
    return found


def seen_by(response: ComplexArray, controller: Controller, task: LoopTask, w: Array) -> ComplexArray:
    """(count, n_w) the plant as one loop finds it, the others closed."""
    others = [(i, j) for i, j in controller.entries if (i, j) != (task.input, task.output)]
    direct = response[:, :, task.output, task.input]
    if not others:
        return direct
    s = axis(w)
    inputs, outputs = [i for i, _ in others], [j for _, j in others]
    inner = response[:, :, outputs][:, :, :, inputs].copy()
    # (Q^-1 + G)^-1 stays finite where integral action does not
    for k, place in enumerate(others):
        inner[:, :, k, k] += 1 / controller.entries[place].feedback(s)
    to = response[:, :, outputs, task.input]
    through = np.asarray(to / inner[..., 0] if len(others) == 1 else np.linalg.solve(inner, to[..., None])[..., 0])
    return np.asarray(direct - np.sum(response[:, :, task.output][:, :, inputs] * through, axis=2))


def _largest(
    seen: Sequence[ComplexArray],
    own: ComplexArray,
    task: LoopTask,
    w: Array,
    limit: float,
    share_lost: float,
    known_td: float | None,
) -> PID:
    """The PI or PID with the largest ki that all but this share of the plants stand in each version (count, n_w)."""
    blank = bare_law(task)
    sign = float(np.sign(own[0].real)) if abs(own[0].real) >= abs(own[0].imag) else float(-np.sign(own[0].imag))
    discs = Discs.of(sign * np.concatenate(seen), w, Limits(limit, limit))
    beyond = w >= task.crossover
    room = 1 / np.abs(own[beyond])

    def best(td: float) -> tuple[float, float]:
        law = replace(blank, Td=td).feedback(axis(w))
        shape = np.tile(law, 2)
        edge = discs.proportional_limit(shape).reshape(len(seen), -1).min(axis=0)
        far = law[beyond]
        top = min(float(np.quantile(edge, share_lost, method="lower")), float(np.min(room / np.abs(far))))

        def ki_at(kp: float) -> float:
            limits = discs.integral_limit(shape, kp).reshape(len(seen), -1).min(axis=0)
            allowed = np.where(edge > kp, limits, 0.0)
            ki = float(np.quantile(allowed, share_lost, method="lower"))
            if td:
                ki = min(ki, kp / (series_ratio(task.alpha) * td))
            # |kp shape - j ki/w| <= 1/|G| beyond the crossover
            free = room**2 - (kp * far.real) ** 2
            most = w[beyond] * (kp * far.imag + np.sqrt(np.maximum(free, 0.0)))
            return max(min(ki, float(np.min(most))), 0.0)

        return best_kp(ki_at, top, zooms=levels.DRAWN_ZOOMS)

    td = 0.0
    if task.kind == "PID":
        td = best_td(lambda x: best(x)[1], 2 * np.pi / task.crossover) if known_td is None else known_td
    kp, ki = best(td)
    if not (ki > 0 and np.isfinite(ki)):
        raise LoopError(
            f"no integral action keeps a peak of {limit:g} in the loop of output {task.output + 1} for so many plants: "
            "allow a higher peak or a smaller share"
        )
    return replace(blank, Kc=sign * kp, Ti=kp / ki, Td=td)
