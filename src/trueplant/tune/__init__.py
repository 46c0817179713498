"""Controllers for the updated plant: tuning rules, optimal and robust settings, before and after."""

from trueplant.tune.compare import Comparison, LoopMetrics, StepMetrics, compare, loop_metrics, step_metrics
from trueplant.tune.forms import Notation, Settings, converted, pid_of, settings_of
from trueplant.tune.integral import Limits, max_ki
from trueplant.tune.optimal import optimal
from trueplant.tune.reduce import Reduced, half_rule, matched, reduced
from trueplant.tune.response import frequencies, ultimate
from trueplant.tune.retune import METHODS, Choices, Retuned, retune
from trueplant.tune.rules import (
    amigo,
    cohen_coon,
    imc,
    improved_simc,
    lambda_tuning,
    minimum_error,
    reaction_curve,
    simc,
    tyreus_luyben,
    ziegler_nichols,
)
from trueplant.tune.several import BLT, blt, sequential
from trueplant.tune.shaping import loop_shaping, pole_placement
from trueplant.tune.uncertain import UncertainTuning, draw_parameters, holds, tune_uncertain

__all__ = [
    "BLT",
    "METHODS",
    "Choices",
    "Comparison",
    "Limits",
    "LoopMetrics",
    "Notation",
    "Reduced",
    "Retuned",
    "Settings",
    "StepMetrics",
    "UncertainTuning",
    "amigo",
    "blt",
    "cohen_coon",
    "compare",
    "converted",
    "draw_parameters",
    "frequencies",
    "half_rule",
    "holds",
    "imc",
    "improved_simc",
    "lambda_tuning",
    "loop_metrics",
    "loop_shaping",
    "matched",
    "max_ki",
    "minimum_error",
    "optimal",
    "pid_of",
    "pole_placement",
    "reaction_curve",
    "reduced",
    "retune",
    "sequential",
    "settings_of",
    "simc",
    "step_metrics",
    "tune_uncertain",
    "tyreus_luyben",
    "ultimate",
    "ziegler_nichols",
]
