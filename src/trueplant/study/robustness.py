"""What today's controller does on the model, and what it does on the plant as estimated."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from trueplant.errors import LoopError
from trueplant.loop import Controller
from trueplant.lti import TransferMatrix, tf
from trueplant.robust import gain_and_dead_time_weight, margins, performance_weight, robust_performance
from trueplant.study.project_parts import PerformanceNumbers, UncertaintyNumbers

if TYPE_CHECKING:
    from trueplant.study.pipeline import Study

KEYS = ("gain_margin", "phase_margin", "delay_margin", "Ms", "Mt")


def robustness_of(study: Study, plant: TransferMatrix) -> dict[str, Any]:
    """Margins of each loop, the others closed, on model and plant; empty without a declared controller.

    The controller is that of the last usable closed experiment, linearised about the mean PV where it acts on a
    transformed one.
    """
    k = study.loop_experiment
    controller = None if k is None else study.project.controller(k)
    if k is None or controller is None:
        return {}
    controller = controller.linearised(np.nanmean(study.screened[k].record.y, axis=0))
    n_u = len(study.project.inputs)
    loops = sorted({i for i, _ in controller.entries})
    found = {
        name: [{"input": study.project.input_names[i]} | _margins(_first(matrix, n_u), controller, i) for i in loops]
        for name, matrix in (("model", study.model), ("plant", plant))
    }
    rows = zip(found["model"], found["plant"], strict=True)
    weighted = _weighted(study, controller, {"model": study.model, "plant": plant})
    return weighted | {
        "controller_of": study.project.experiments[k].name,
        "margins": found,
        "worse": [on_plant["input"] for on_model, on_plant in rows if _worse(on_model, on_plant)],
    }


def _weighted(study: Study, controller: Controller, systems: dict[str, TransferMatrix]) -> dict[str, Any]:
    """NP, RS and RP with the declared weights (28)-(32), per-channel input uncertainty; empty without both weights."""
    declared = study.project.robustness
    if declared is None or declared.wI is None or declared.wP is None:
        return {}
    uncertainty, performance = (_weights(given) for given in (declared.wI, declared.wP))
    peaks = {}
    for name, matrix in systems.items():
        found = robust_performance(_first(matrix, len(study.project.inputs)), controller, uncertainty, performance)
        peaks[name] = {"stable": found.stable, "robust_performance_holds": found.passes} | {
            test: {"lower": peak.lower, "upper": peak.upper, "frequency": peak.frequency}
            for test, peak in (("NP", found.NP), ("RS", found.RS), ("RP", found.RP))
        }
    return {"peaks": peaks}


def _weights(given: Any) -> Any:
    """Weights as `robust` takes them: one, or one a channel."""
    if isinstance(given, list):
        return [_weights(one) for one in given]
    if isinstance(given, UncertaintyNumbers):
        return gain_and_dead_time_weight(given.gain_percent / 100, given.dead_time)
    if isinstance(given, PerformanceNumbers):
        return performance_weight(given.bandwidth, given.M, given.A)
    return tf(given)


def _first(matrix: TransferMatrix, n_u: int) -> TransferMatrix:
    return TransferMatrix(tuple(row[:n_u] for row in matrix.elements), matrix.time_unit)


def _margins(plant: TransferMatrix, controller: Controller, loop: int) -> dict[str, Any]:
    """Margins of one loop, or why it has none."""
    try:
        found = margins(plant, controller, loop)
    except LoopError as error:
        return {"stable": False, "message": str(error)}
    values = {key: getattr(found, key) for key in KEYS}
    # No finite margin is no limit: null in JSON, and said here.
    return {"stable": True} | {key: value if math.isfinite(value) else None for key, value in values.items()}


def _worse(model: dict[str, Any], plant: dict[str, Any]) -> bool:
    """Is the loop unstable on the plant, or its sensitivity peak above 2 although it was not on the model?"""
    if not plant["stable"]:
        return bool(model["stable"])
    return bool(model["stable"] and plant["Ms"] is not None and plant["Ms"] > 2 >= (model["Ms"] or 0))
