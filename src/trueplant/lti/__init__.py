"""Transfer functions and matrices with exact dead time, and their formulas."""

from trueplant.lti.formula import Transform, parse_pv, require_proper, tf, to_formula
from trueplant.lti.transfer import Term, TransferFunction, TransferMatrix

__all__ = [
    "Term",
    "TransferFunction",
    "TransferMatrix",
    "Transform",
    "parse_pv",
    "require_proper",
    "tf",
    "to_formula",
]
