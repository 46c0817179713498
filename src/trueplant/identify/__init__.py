"""Parametric estimates of the plant, and how far they can be trusted."""

from trueplant.identify.accounts import Open
from trueplant.identify.answers import unanswered
from trueplant.identify.budget import Budget
from trueplant.identify.equation_error import equation_error, paper_route
from trueplant.identify.estimate import Options, estimate_row
from trueplant.identify.first import INTEGRATING, SELF_REGULATING
from trueplant.identify.fit import RowFit, fit_row
from trueplant.identify.gate import Worse, worse_than_model
from trueplant.identify.halves import counting_halves
from trueplant.identify.holds import FoundHold, find_holds, held_or_straight, over_open_holds, with_holds
from trueplant.identify.loads import FoundLoad, cost_of_loads, found_loads
from trueplant.identify.longest_noise import estimate_beside_longest_noise
from trueplant.identify.matrix import Identification, identify_matrix, identify_plant, specs_of
from trueplant.identify.off_grid import as_if_sampled_on_the_grid
from trueplant.identify.open_valves import with_open_valves
from trueplant.identify.operating_points import OperatingPoints, operating_points
from trueplant.identify.output import OutputEstimate, Rejected, identify_output
from trueplant.identify.pieces import Held, pieces_of
from trueplant.identify.residual_tests import RESIDUAL_TESTS
from trueplant.identify.row import Row, Spec
from trueplant.identify.strides import Sampling, choose_stride, samples_per_update
from trueplant.identify.unanswered import Unanswered, WhyUnanswered
from trueplant.identify.validate import Validation, fit_percent, prediction_errors, simulate_piece
from trueplant.identify.valves import (
    FoundValve,
    Tried,
    behind_valves,
    over_open_valves,
    sticking,
    try_valves,
    widened_for_bands,
)

__all__ = [
    "INTEGRATING",
    "RESIDUAL_TESTS",
    "SELF_REGULATING",
    "Budget",
    "FoundHold",
    "FoundLoad",
    "FoundValve",
    "Held",
    "Identification",
    "Open",
    "OperatingPoints",
    "Options",
    "OutputEstimate",
    "Rejected",
    "Row",
    "RowFit",
    "Sampling",
    "Spec",
    "Tried",
    "Unanswered",
    "Validation",
    "WhyUnanswered",
    "Worse",
    "as_if_sampled_on_the_grid",
    "behind_valves",
    "choose_stride",
    "cost_of_loads",
    "counting_halves",
    "equation_error",
    "estimate_beside_longest_noise",
    "estimate_row",
    "find_holds",
    "fit_percent",
    "fit_row",
    "found_loads",
    "held_or_straight",
    "identify_matrix",
    "identify_output",
    "identify_plant",
    "operating_points",
    "over_open_holds",
    "over_open_valves",
    "paper_route",
    "pieces_of",
    "prediction_errors",
    "samples_per_update",
    "simulate_piece",
    "specs_of",
    "sticking",
    "try_valves",
    "unanswered",
    "widened_for_bands",
    "with_holds",
    "with_open_valves",
    "worse_than_model",
]
