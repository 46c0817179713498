"""What today's controller does on the model, and what it does on the plant as estimated."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from trueplant.errors import LoopError
from trueplant.loop import Controller
from trueplant.lti import TransferMatrix
from trueplant.robust import margins

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
    return {
        "controller_of": study.project.experiments[k].name,
        "margins": found,
        "worse": [on_plant["input"] for on_model, on_plant in rows if _worse(on_model, on_plant)],
    }


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
