"""Controllers for the updated plant: tuning rules, optimal and robust settings, before and after."""

from trueplant.tune.compare import (
    Comparison,
    LoopMetrics,
    StepMetrics,
    compare,
    loop_metrics,
    step_metrics,
    step_response,
)
from trueplant.tune.drawn import Peaks, common_grid, peaks
from trueplant.tune.forms import Notation, Settings, converted, pid_of, settings_of
from trueplant.tune.integral import Limits, max_ki
from trueplant.tune.methods import METHODS, Choices
from trueplant.tune.mu_synthesis import MuDesigned, dk_iteration
from trueplant.tune.optimal import optimal
from trueplant.tune.performance import TunedForPerformance, Weighting, tune_performance
from trueplant.tune.propose import ALL_METHODS, AS_DESIGNED, CERTAIN, PERFORMANCE, OwnMethod, Proposal, propose
from trueplant.tune.reduce import Reduced, half_rule, matched, reduced
from trueplant.tune.response import frequencies, ultimate
from trueplant.tune.retune import Retuned, retune
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
from trueplant.tune.shaping import loop_shaping, pole_placement, shaped_like
from trueplant.tune.state_space import Designed, fastest, h2, h_infinity, lqg
from trueplant.tune.together import LoopTask, TunedTogether, slow_down, tune_together, unseen_dead_time
from trueplant.tune.uncertain import UncertainTuning, draw_parameters, holds, tune_uncertain

__all__ = [
    "ALL_METHODS",
    "AS_DESIGNED",
    "BLT",
    "CERTAIN",
    "METHODS",
    "PERFORMANCE",
    "Choices",
    "Comparison",
    "Designed",
    "Limits",
    "LoopMetrics",
    "LoopTask",
    "MuDesigned",
    "Notation",
    "OwnMethod",
    "Peaks",
    "Proposal",
    "Reduced",
    "Retuned",
    "Settings",
    "StepMetrics",
    "TunedForPerformance",
    "TunedTogether",
    "UncertainTuning",
    "Weighting",
    "amigo",
    "blt",
    "cohen_coon",
    "common_grid",
    "compare",
    "converted",
    "dk_iteration",
    "draw_parameters",
    "fastest",
    "frequencies",
    "h2",
    "h_infinity",
    "half_rule",
    "holds",
    "imc",
    "improved_simc",
    "lambda_tuning",
    "loop_metrics",
    "loop_shaping",
    "lqg",
    "matched",
    "max_ki",
    "minimum_error",
    "optimal",
    "peaks",
    "pid_of",
    "pole_placement",
    "propose",
    "reaction_curve",
    "reduced",
    "retune",
    "sequential",
    "settings_of",
    "shaped_like",
    "simc",
    "slow_down",
    "step_metrics",
    "step_response",
    "tune_performance",
    "tune_together",
    "tune_uncertain",
    "tyreus_luyben",
    "ultimate",
    "unseen_dead_time",
    "ziegler_nichols",
]
