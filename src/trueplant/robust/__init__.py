"""Robustness: margins, uncertainty and performance weights, structured singular values, robust performance."""

from trueplant.robust.blocks import Block, Full, Real, Repeated, diagonal
from trueplant.robust.disk import multiloop_disk_margin
from trueplant.robust.generalised import generalised_plant, perturbed_plant, uncertainty_blocks
from trueplant.robust.margins import Margins, margins, niederlinski, rga
from trueplant.robust.mu import MuResult, mu
from trueplant.robust.parametric import ElementErrors, ParametricLoop, parametric_loop, parametric_performance
from trueplant.robust.peaks import Peak
from trueplant.robust.performance import Robustness, robust_performance
from trueplant.robust.skewed import worst_gain
from trueplant.robust.weights import (
    covariance_weight,
    covering_weight,
    gain_and_dead_time_weight,
    performance_weight,
    set_weight,
    uncertainty_weight,
)

__all__ = [
    "Block",
    "ElementErrors",
    "Full",
    "Margins",
    "MuResult",
    "ParametricLoop",
    "Peak",
    "Real",
    "Repeated",
    "Robustness",
    "covariance_weight",
    "covering_weight",
    "diagonal",
    "gain_and_dead_time_weight",
    "generalised_plant",
    "margins",
    "mu",
    "multiloop_disk_margin",
    "niederlinski",
    "parametric_loop",
    "parametric_performance",
    "performance_weight",
    "perturbed_plant",
    "rga",
    "robust_performance",
    "set_weight",
    "uncertainty_blocks",
    "uncertainty_weight",
    "worst_gain",
]
