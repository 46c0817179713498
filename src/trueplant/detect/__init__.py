"""Which elements changed, and whether it matters."""

from trueplant.detect.elements import Found, elements_found, judge_elements, verdicts
from trueplant.detect.verdict import (
    Evidence,
    ParameterVerdict,
    Verdict,
    grade,
    holm,
    importance_in_loop,
    importance_open_loop,
    judge,
)

__all__ = [
    "Evidence",
    "Found",
    "ParameterVerdict",
    "Verdict",
    "elements_found",
    "grade",
    "holm",
    "importance_in_loop",
    "importance_open_loop",
    "judge",
    "judge_elements",
    "verdicts",
]
