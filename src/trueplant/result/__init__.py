"""What an analysis returns: typed, frozen, with its words and its JSON."""

from trueplant.result.changes import (
    Change,
    ChangeKind,
    ElementHistory,
    Moved,
    TrackedElement,
    TrackedExperiment,
    Window,
    WindowElement,
    WindowStatus,
)
from trueplant.result.curves import CoherenceCurves, Curves, MuCurves, Residuals, RetuningCurves, Trend
from trueplant.result.document import document, plain
from trueplant.result.element import Element, Importance, Interval, Parameter
from trueplant.result.plans import MoreData, PlannedMove, Settled
from trueplant.result.reason import Reason
from trueplant.result.result import Result
from trueplant.result.track import Track

__all__ = [
    "Change",
    "ChangeKind",
    "CoherenceCurves",
    "Curves",
    "Element",
    "ElementHistory",
    "Importance",
    "Interval",
    "MoreData",
    "Moved",
    "MuCurves",
    "Parameter",
    "PlannedMove",
    "Reason",
    "Residuals",
    "Result",
    "RetuningCurves",
    "Settled",
    "Track",
    "TrackedElement",
    "TrackedExperiment",
    "Trend",
    "Window",
    "WindowElement",
    "WindowStatus",
    "document",
    "plain",
]
