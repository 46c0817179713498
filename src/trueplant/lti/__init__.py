"""Transfer functions and matrices with exact dead time, and their formulas."""

from trueplant.lti.bridge import from_control, to_control
from trueplant.lti.formula import Transform, parse_pv, require_proper, tf, to_formula
from trueplant.lti.measured import MeasuredStep, largest_difference
from trueplant.lti.reduce import simplified, simplified_matrix
from trueplant.lti.sampled import sampled_response
from trueplant.lti.states import StateSpace
from trueplant.lti.structure import Structure, structure_of
from trueplant.lti.transfer import Term, TransferFunction, TransferMatrix
from trueplant.lti.uncertain import DrawnPlants, KnownRow, UncertainPlant

__all__ = [
    "DrawnPlants",
    "KnownRow",
    "MeasuredStep",
    "StateSpace",
    "Structure",
    "Term",
    "TransferFunction",
    "TransferMatrix",
    "Transform",
    "UncertainPlant",
    "from_control",
    "largest_difference",
    "parse_pv",
    "require_proper",
    "sampled_response",
    "simplified",
    "simplified_matrix",
    "structure_of",
    "tf",
    "to_control",
    "to_formula",
]
