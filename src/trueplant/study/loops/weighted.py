"""Robust performance of today's loops under the declared weights and errors, and under those of the estimate."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from trueplant.arrays import Array, ComplexArray
from trueplant.errors import UsageError
from trueplant.loop import LinearLoop
from trueplant.lti import TransferMatrix, UncertainPlant, simplified, tf, to_formula
from trueplant.project.tables import PerformanceNumbers, UncertaintyNumbers
from trueplant.project.tables import Robustness as Declared
from trueplant.result import MuCurves, Peak, SystemPeaks, WorstElement
from trueplant.robust import (
    ElementErrors,
    Robustness,
    gain_and_dead_time_weight,
    parametric_loop,
    parametric_performance,
    performance_weight,
    perturbed_plant,
    robust_performance,
)
from trueplant.robust.grid import rates_of
from trueplant.study.plant.uncertainty import element_errors
from trueplant.study.study import Study


def weighted(
    study: Study, on_model: LinearLoop, on_plant: LinearLoop, known: UncertainPlant
) -> tuple[dict[str, SystemPeaks], tuple[MuCurves, ...]]:
    """NP, RS and RP with the declared weights (28)-(32); empty without any.

    "model" and "plant" are judged under the declared uncertainty: wI of each input's channel, real errors of the
    elements; "estimate" is the plant under what the covariance of its parameters leaves open.
    """
    declared = study.project.robustness
    if declared is None or declared == Declared():
        return {}, ()
    performance = 0.0 if declared.wP is None else weights_of(declared.wP)
    uncertain = declared.wI is not None or declared.elements is not None
    cases, worst = {}, None
    for name, loop in (("model", on_model), ("plant", on_plant)):
        # the last is the plant's
        cases[name], worst = _judged(study, declared, loop, performance)
    tests = {name: _tests(uncertain, declared.wP is not None) for name in cases}
    certain = _of_estimate(study, on_plant, known, performance)
    if certain is not None:
        # without uncertainty it is the plant, whose nominal performance is there already
        cases["estimate"] = certain
        tests["estimate"] = tuple(t for t in _tests(True, declared.wP is not None) if t != "NP")
    table = {name: _peaks(found, tests[name]) for name, found in cases.items()}
    if "RP" in tests["plant"] and math.isfinite(cases["plant"].RP.upper):
        table["plant"] = replace(table["plant"], worst_plant=_elements(study, worst))
    curves = (_curves(name, found, tests[name]) for name, found in cases.items() if found.stable)
    return table, tuple(curves)


def _tests(uncertain: bool, demanding: bool) -> tuple[str, ...]:
    """Which tests say something: nominal performance needs a wP, robust stability an uncertainty, the third both."""
    return ("NP",) * demanding + ("RS",) * uncertain + ("RP",) * (demanding and uncertain)


def _of_estimate(study: Study, loop: LinearLoop, known: UncertainPlant, performance: Any) -> Robustness | None:
    """Robust performance over the plants within the confidence of the estimate, each element's error on its own."""
    if not known.varying:
        return None
    plant, controller = loop.plant, loop.controller
    grid = rates_of(plant, controller).grid(per_decade=30)
    w = np.append(1e-9 * grid[0], grid)
    size = element_errors(known, w, study.project.analysis.confidence)[:, :, : plant.shape[1]].reshape(w.size, -1)
    weights = [_interpolated(w, element) for element in size.T]
    return robust_performance(plant, controller, weights, performance, "elements")


def _interpolated(w: Array, size: Array) -> Callable[[ComplexArray], Array]:
    log_w, log_size = np.log(w), np.log(np.maximum(size, 1e-300))
    return lambda s: np.asarray(np.exp(np.interp(np.log(np.maximum(np.abs(s), 1e-300)), log_w, log_size)))


def _judged(
    study: Study, declared: Declared, loop: LinearLoop, performance: Any
) -> tuple[Robustness, TransferMatrix | None]:
    """The tests under the declared uncertainty, and the plant that makes the peak of robust performance, if any."""
    plant, controller = loop.plant, loop.controller
    uncertainty = None if declared.wI is None else weights_of(declared.wI)
    if declared.elements is None:
        found = robust_performance(plant, controller, 0.0 if uncertainty is None else uncertainty, performance)
        if not math.isfinite(found.RP.upper) or uncertainty is None:
            return found, None
        return found, perturbed_plant(plant, uncertainty, found.worst, found.worst_frequency)
    uncertain = parametric_loop(plant, controller, _errors(study, declared, plant), performance, uncertainty)
    found = parametric_performance(uncertain)
    if not math.isfinite(found.RP.upper) or not found.worst_frequency:
        return found, None
    try:
        return found, uncertain.moved(found.worst, found.worst_frequency)
    except UsageError:  # it would need a dead time below zero
        return found, None


def declared_peak(study: Study, loop: LinearLoop) -> float:
    """Upper bound of mu of robust performance of this loop under the declared errors; infinite where it is unstable."""
    declared = study.project.robustness
    assert declared is not None  # nothing is asked of it otherwise,
    assert declared.wP is not None  # nor without this
    return _judged(study, declared, loop, weights_of(declared.wP))[0].RP.upper


def _errors(study: Study, declared: Declared, plant: TransferMatrix) -> ElementErrors:
    if not isinstance(declared.elements, list):
        assert declared.elements is not None
        return ElementErrors.of(plant, declared.elements.gain_percent / 100, declared.elements.dead_time)
    gain, dead_time = np.zeros(plant.shape), np.zeros(plant.shape)
    for error in declared.elements:
        at = study.project.output_names.index(error.output), study.project.input_names.index(error.input)
        gain[at], dead_time[at] = error.gain_percent / 100, error.dead_time
    return ElementErrors.of(plant, gain, dead_time)


def _elements(study: Study, plant: TransferMatrix | None) -> tuple[WorstElement, ...]:
    """Its formulas; empty for None."""
    if plant is None:
        return ()
    outputs, inputs = study.project.output_names, study.project.input_names
    return tuple(
        WorstElement(outputs[i], inputs[j], to_formula(simplified(plant[i, j])))
        for i, j in np.ndindex(*plant.shape)
        if not plant[i, j].is_zero
    )


def _peaks(found: Robustness, tests: tuple[str, ...]) -> SystemPeaks:
    NP, RS, RP = (
        Peak(peak.lower, peak.upper, peak.frequency) if test in tests else None
        for test, peak in (("NP", found.NP), ("RS", found.RS), ("RP", found.RP))
    )
    return SystemPeaks(found.stable, found.passes if "RP" in tests else None, NP, RS, RP)


def _curves(name: str, found: Robustness, tests: tuple[str, ...]) -> MuCurves:
    nominal = np.column_stack([found.nominal, found.nominal])
    values = {"NP": nominal, "RS": found.stability, "RP": found.performance}
    peaks = {"NP": found.NP, "RS": found.RS, "RP": found.RP}
    return MuCurves(
        system=name,
        w=found.w,
        bounds={test: values[test] for test in tests},
        peaks={test: (peaks[test].frequency, peaks[test].upper) for test in tests},
    )


def weights_of(given: Any) -> Any:
    """Weights as `robust` takes them: one, or one a channel."""
    if isinstance(given, list):
        return [weights_of(one) for one in given]
    if isinstance(given, UncertaintyNumbers):
        return gain_and_dead_time_weight(given.gain_percent / 100, given.dead_time)
    if isinstance(given, PerformanceNumbers):
        return performance_weight(given.bandwidth, given.M, given.A)
    return tf(given)
