"""Which elements changed, and whether it matters."""

from trueplant.detect.causes import CommonFactor, Explanation, blocks, explanations
from trueplant.detect.correlation import cross_correlation, partial_correlation
from trueplant.detect.detectable import detectable_change, least_known
from trueplant.detect.elements import Found, elements_found, judge_elements, verdicts
from trueplant.detect.one_class import one_class
from trueplant.detect.published import DETECTORS, published
from trueplant.detect.ratio import plant_model_ratio
from trueplant.detect.sensitivity import nominal_sensitivity
from trueplant.detect.signals import Detection, Signals, signals_of
from trueplant.detect.stepwise import stepwise
from trueplant.detect.stretches import Moved, TwoFits, likeliest_change
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
    "DETECTORS",
    "CommonFactor",
    "Detection",
    "Evidence",
    "Explanation",
    "Found",
    "Moved",
    "ParameterVerdict",
    "Signals",
    "TwoFits",
    "Verdict",
    "blocks",
    "cross_correlation",
    "detectable_change",
    "elements_found",
    "explanations",
    "grade",
    "holm",
    "importance_in_loop",
    "importance_open_loop",
    "judge",
    "judge_elements",
    "least_known",
    "likeliest_change",
    "nominal_sensitivity",
    "one_class",
    "partial_correlation",
    "plant_model_ratio",
    "published",
    "signals_of",
    "stepwise",
    "verdicts",
]
