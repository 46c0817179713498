"""The published detectors by name."""

from __future__ import annotations

from collections.abc import Sequence

from trueplant.detect.correlation import cross_correlation, partial_correlation
from trueplant.detect.one_class import one_class
from trueplant.detect.ratio import plant_model_ratio
from trueplant.detect.sensitivity import nominal_sensitivity
from trueplant.detect.signals import Detection, NotApplicable, refused, signals_of
from trueplant.detect.stepwise import stepwise
from trueplant.errors import UsageError
from trueplant.loop import Controller
from trueplant.lti import TransferMatrix
from trueplant.record import Segment

DETECTORS = (
    "partial-correlation",
    "cross-correlation",
    "stepwise",
    "plant-model-ratio",
    "nominal-sensitivity",
    "one-class",
)


def published(
    name: str,
    segments: Sequence[Segment],
    model: TransferMatrix,
    controller: Controller | None = None,
    confidence: float = 0.95,
) -> Detection:
    """One of DETECTORS on these data: statistic, threshold and flag of each element (n_y, n_u).

    `model` (n_y, n_u + n_d) is in the segments' time unit; only nominal-sensitivity needs the controller, which is
    without a pv_transform. What does not apply comes back as a refusal with its reason. Raises UsageError for another
    name.
    """
    if name not in DETECTORS:
        raise UsageError(f'no detector is called "{name}": use one of {", ".join(DETECTORS)}')
    shape = (model.shape[0], segments[0].u.shape[1])
    level = 1 - confidence
    try:
        if name == "one-class":
            return one_class(segments, model, level)
        signals = signals_of(segments, model)
        if name == "partial-correlation":
            return partial_correlation(signals, level)
        if name == "cross-correlation":
            return cross_correlation(signals, level)
        if name == "stepwise":
            return stepwise(signals, level)
        if name == "plant-model-ratio":
            return plant_model_ratio(signals, model, level)
        if controller is None:
            raise NotApplicable("the nominal loop needs a declared controller")
        return nominal_sensitivity(signals, model, controller, level)
    except NotApplicable as problem:
        return refused(name, shape, str(problem))
