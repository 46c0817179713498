"""Which elements changed, and whether it matters."""

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
    "ParameterVerdict",
    "Verdict",
    "grade",
    "holm",
    "importance_in_loop",
    "importance_open_loop",
    "judge",
]
