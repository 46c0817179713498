"""What today's controller does on the model, on the plant as estimated, and on the plants that the data leave open."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from trueplant.arrays import Array, BoolArray, ComplexArray
from trueplant.errors import LoopError
from trueplant.loop import Controller, Linear, LinearLoop
from trueplant.lti import TransferMatrix, UncertainPlant
from trueplant.result import (
    Code,
    ControllerCheck,
    DrawnLoop,
    DrawnStability,
    LoopMargins,
    LoopRobustness,
    Margins,
    MuCurves,
    Pairing,
    Reason,
    SystemPeaks,
)
from trueplant.result.numbers import number
from trueplant.robust import margins, niederlinski, rga
from trueplant.robust.generalised import channels
from trueplant.robust.grid import on_axis, rates_of
from trueplant.study import levels
from trueplant.study.loops.targets import not_as_declared
from trueplant.study.loops.weighted import weighted, weights_of
from trueplant.study.study import Study
from trueplant.tune.drawn import Peaks, common_grid, peaks


@dataclass(frozen=True, eq=False)
class LoopToday:
    """What is found about today's loop; empty without a declared controller."""

    table: LoopRobustness | None = None
    mu: tuple[MuCurves, ...] = ()
    notes: tuple[Reason, ...] = ()


def robustness_of(
    study: Study, known: UncertainPlant, settled: float | None, checks: Sequence[ControllerCheck]
) -> LoopToday:
    """Margins of each loop (the others closed), pairing, robust performance, and the share of likely plants that hold.

    The controller is that of the last usable closed experiment, linearised about the mean PV where it acts on a
    transformed one. `settled` is for how long it is known not to have run away (`settled_for`). Where OP was written by
    another, as `checks` may say, no note says what the loop of today does.
    """
    k, loop = study.loop_experiment, study.loop(known.nominal)
    if k is None or loop is None:
        return LoopToday()
    model, today, controller, loops = study.inputs_model, loop.plant, loop.controller, loop.inputs
    names = study.project.input_names
    on_model, on_plant = (tuple(_margins(matrix, controller, i, names[i]) for i in loops) for matrix in (model, today))
    peaks, mu = weighted(study, loop.on(model), loop, known)
    table = LoopRobustness(
        controller_of=study.project.experiments[k].name,
        margins=Margins(on_model, on_plant),
        worse=tuple(b.input for a, b in zip(on_model, on_plant, strict=True) if _worse(a, b)),
        peaks=peaks,
        pairing=pairing_of(names, controller, {"model": model, "plant": today}),
        drawn=_drawn(study, loop, known, settled),
    )
    notes = [*(() if not_as_declared(study, checks) else _tuning_notes(table)), *_pairing_notes(table)]
    if beyond := study.project.experiments[k].beyond():
        said = f"margins, mu and settings are those of the controller without {beyond}"
        notes = [*notes, Reason(Code.CONTROLLER, said, study.project.experiments[k].name)]
    return LoopToday(table, mu, tuple(notes))


# -- margins and pairing ----------------------------------------------------------------------------------------


def _margins(plant: TransferMatrix, controller: Controller, loop: int, name: str) -> LoopMargins:
    """Margins of one loop, or why it has none."""
    try:
        found = margins(plant, controller, loop)
    except LoopError as error:
        return LoopMargins(name, False, message=str(error))
    # No finite margin is no limit.
    gain, phase, delay, peak_s, peak_t = (
        float(value) if math.isfinite(value) else None
        for value in (found.gain_margin, found.phase_margin, found.delay_margin, found.Ms, found.Mt)
    )
    return LoopMargins(name, True, gain, phase, delay, peak_s, peak_t)


def _worse(model: LoopMargins, plant: LoopMargins) -> bool:
    """Is the loop unstable on the plant, or its sensitivity peak above 2 although it was not on the model?"""
    if not plant.stable:
        return model.stable
    return model.stable and plant.Ms is not None and plant.Ms > levels.HIGHEST_MS >= (model.Ms or 0)


def pairing_of(
    names: Sequence[str], controller: Controller, systems: Mapping[str, TransferMatrix]
) -> dict[str, Pairing]:
    """Relative gains and Niederlinski index of each system at rest, and the inputs in loops of the wrong sign.

    names: of the inputs. Empty where a relative gain says nothing about these loops: unless each output has one
    controller and one input of its own, and a finite gain that can be inverted.
    """
    n_y, n_u = next(iter(systems.values())).shape
    if n_y != n_u or n_u < 2 or not controller.is_decentralised or len(controller.entries) < n_u:
        return {}
    places = sorted(controller.entries)
    outputs = [j for _, j in places]
    found: dict[str, Pairing] = {}
    for name, matrix in systems.items():
        gain = matrix.dc_gain
        try:
            relative, index = rga(gain), niederlinski(gain[outputs])
        except LoopError:
            return {}
        wrong = tuple(names[i] for i, j in places if relative[j, i] < 0)
        found[name] = Pairing(tuple(tuple(row) for row in relative.tolist()), float(index), wrong)
    return found


# -- the plants that the data leave open --------------------------------------------------------------------------


def _drawn(study: Study, loop: LinearLoop, known: UncertainPlant, settled: float | None) -> DrawnStability | None:
    """How many of the plants drawn from the estimate today's controller keeps stable, below which Ms, and within wP.

    Plants on which the loop would have run away in a record in which it did not are none of those that the data leave
    open. None where that cannot be counted (`drawn_responses`).
    """
    seed = study.project.analysis.seed
    drawn = drawn_responses(seed, loop, known)
    if drawn is None:
        return None
    w, response, law = drawn
    bounded = None if settled is None else bounded_for(seed, loop, known, settled)
    if bounded is not None and bounded.any():
        response = response[bounded]
    found = peaks(response, law, w)
    rows = []
    for i in loop.inputs:
        middle, high = (float(q) if found.stable.all() else None for q in np.quantile(found.Ms[:, i], [0.5, 0.95]))
        held = float(np.mean(found.stable & (found.Ms[:, i] <= levels.HIGHEST_MS)))
        rows.append(DrawnLoop(study.project.input_names[i], held, middle, high))
    share = _share_performance(study, response, law, w, found)
    return DrawnStability(len(response), seed, found.share_stable, levels.HIGHEST_MS, tuple(rows), share)


def drawn_responses(
    seed: int, loop: LinearLoop, known: UncertainPlant, growth: float = 0.0
) -> tuple[Array, ComplexArray, ComplexArray] | None:
    """Frequencies w (n_w,), plants drawn (count, n_w, n_y, n_u) and controller (n_w, n_u, n_y) at s = growth + jw.

    None where nothing varies, or where plant or controller is unstable by itself: the count of the draws' unstable
    poles rests on their stability.
    """
    plant, controller = loop.plant, loop.controller
    laws = [entry.tf for entry in controller.entries.values() if isinstance(entry, Linear)]
    elements = [element for row in plant.elements for element in row]
    if any(np.any(f.poles.real > 0) for f in (*elements, *laws)) or not known.varying:
        return None
    try:
        draws = known.draw(levels.STABILITY_DRAWS, seed)
    except LoopError:
        return None
    w = common_grid(plant, controller, _crossover(plant, controller))
    response = draws.response(w - 1j * growth if growth else w)[:, :, :, : plant.shape[1]]
    return w, response, controller(on_axis(w) + growth)


def bounded_for(seed: int, loop: LinearLoop, known: UncertainPlant, span: float) -> BoolArray | None:
    """(count,) of the drawn plants, on which the loop would grow by less than RUNS_AWAY within the span.

    The poles to the right of Re s = log(RUNS_AWAY) / span are counted; None where they cannot be (`drawn_responses`).
    """
    drawn = drawn_responses(seed, loop, known, float(np.log(levels.RUNS_AWAY)) / span)
    if drawn is None:
        return None
    w, response, law = drawn
    return peaks(response, law, w).stable


def _share_performance(study: Study, response: ComplexArray, law: ComplexArray, w: Array, found: Peaks) -> float | None:
    """Share of the drawn plants (count, n_w, n_y, n_u) that are stable and within wP; None where none is declared."""
    declared = study.project.robustness
    if declared is None or declared.wP is None:
        return None
    n_y = response.shape[2]
    asked = np.stack([f(on_axis(w)) for f in channels(weights_of(declared.wP), n_y, "the performance")], axis=1)
    sensitivity = np.linalg.inv(np.eye(n_y) + response @ law)
    error = np.linalg.norm(asked[:, :, None] * sensitivity, ord=2, axis=(2, 3)).max(axis=1)
    return float(np.mean(found.stable & (error < 1)))


def _crossover(plant: TransferMatrix, controller: Controller) -> float:
    """The highest frequency at which the loop gain, in its strongest direction, is above 1."""
    rates = rates_of(plant, controller)
    w = rates.grid(per_decade=20, above=10.0)
    s = on_axis(w, plant)
    strong = w[np.linalg.norm(plant(s) @ controller(s), ord=2, axis=(1, 2)) > 1]
    return float(strong[-1]) if strong.size else rates.slowest


# -- in words -----------------------------------------------------------------------------------------------------


def _pairing_notes(table: LoopRobustness) -> list[Reason]:
    wrong = table.pairing["plant"].wrong_sign if table.pairing else ()
    message = (
        "on the plant the steady-state relative gain of these pairings is negative: with integral action either the "
        "loops together are unstable, or this loop alone is, or the others are once it is opened; pair the outputs "
        "with other inputs"
    )
    return [Reason(Code.PAIRING, message, ", ".join(wrong))] if wrong else []


def _tuning_notes(table: LoopRobustness) -> list[Reason]:
    """What today's controller does on the plant."""
    notes = [
        Reason(
            Code.MARGINS,
            "on the plant as estimated, today's controller leaves this loop unstable or with little margin",
            name,
        )
        for name in table.worse
    ]
    if found := _missed(table.peaks):
        notes.append(Reason(Code.ROBUST_PERFORMANCE, found))
    if table.drawn and table.drawn.share_stable < 1 and table.margins.plant[0].stable:
        unstable = 100 * (1 - table.drawn.share_stable)
        of = "" if table.drawn.count == levels.STABILITY_DRAWS else ", without those on which it would have run away"
        notes.append(
            Reason(
                Code.DRAWN,
                f"in {number(unstable, 2)} % of the plants that these data leave open, today's controller is unstable "
                f"({table.drawn.count} plants drawn from the estimate{of})",
            )
        )
    return notes


def _missed(peaks: Mapping[str, SystemPeaks]) -> str:
    """What today's controller no longer achieves on the plant as estimated; empty if it does, or was not asked."""
    if not peaks:
        return ""
    on_model, on_plant = peaks["model"], peaks["plant"]
    for before, peak, what in (
        (on_model.RP, on_plant.RP, "robust performance"),
        (on_model.NP, on_plant.NP, "the performance asked for"),
    ):
        if peak is None or before is None:
            continue
        if not on_plant.stable:
            return f"with today's controller {what} is out of reach: the loop is unstable on the plant as estimated"
        if not math.isfinite(peak.upper):
            return f"with today's controller {what} is out of reach: the weight wP integrates and the loop does not"
        if peak.upper >= 1:
            where = "towards frequency 0" if peak.frequency == 0 else "at its peak"
            return (
                f"with today's controller {what} does not hold on the plant as estimated: its measure, which must stay "
                f"below 1, is {number(peak.upper)} {where} ({number(before.upper)} on the model)"
            )
        return ""
    return ""
