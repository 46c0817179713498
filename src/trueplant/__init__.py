"""trueplant: closed-loop plant data in; what changed in the plant, how surely, and the updated model out.

Everything named in ``__all__`` is public and stable. Names are imported when they are first used, so that
``import trueplant`` and ``trueplant --help`` stay quick.
"""

from __future__ import annotations

from importlib import import_module

from trueplant.version import __version__

TYPE_CHECKING = False
"""That of `typing`, without what it takes to import that."""
if TYPE_CHECKING:
    from typing import Any

    from trueplant import datasets as datasets
    from trueplant.errors import (
        DataError,
        FormulaError,
        IllPosedLoop,
        LoopError,
        OutputError,
        ProjectError,
        Refused,
        SignConflict,
        SourceError,
        TrueplantError,
        UnstableLoop,
        UsageError,
    )
    from trueplant.loop import PID
    from trueplant.lti import TransferFunction, TransferMatrix, tf
    from trueplant.notebook import Analysis, Loop, check, load, run, simulate, track
    from trueplant.project import Project
    from trueplant.record.types import Record, Screened, Segment
    from trueplant.result import Check, Result, Track

_HOME = {
    "datasets": "trueplant.datasets",
    **dict.fromkeys(
        (
            "DataError",
            "FormulaError",
            "IllPosedLoop",
            "LoopError",
            "OutputError",
            "ProjectError",
            "Refused",
            "SignConflict",
            "SourceError",
            "TrueplantError",
            "UnstableLoop",
            "UsageError",
        ),
        "trueplant.errors",
    ),
    **dict.fromkeys(("TransferFunction", "TransferMatrix", "tf"), "trueplant.lti"),
    **dict.fromkeys(("Record", "Screened", "Segment"), "trueplant.record.types"),
    **dict.fromkeys(("Check", "Result", "Track"), "trueplant.result"),
    **dict.fromkeys(("Analysis", "Loop", "check", "load", "run", "simulate", "track"), "trueplant.notebook"),
    "PID": "trueplant.loop",
    "Project": "trueplant.project",
}

__all__ = [
    "PID",
    "Analysis",
    "Check",
    "DataError",
    "FormulaError",
    "IllPosedLoop",
    "Loop",
    "LoopError",
    "OutputError",
    "Project",
    "ProjectError",
    "Record",
    "Refused",
    "Result",
    "Screened",
    "Segment",
    "SignConflict",
    "SourceError",
    "Track",
    "TransferFunction",
    "TransferMatrix",
    "TrueplantError",
    "UnstableLoop",
    "UsageError",
    "__version__",
    "check",
    "datasets",
    "load",
    "run",
    "simulate",
    "tf",
    "track",
]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'trueplant' has no attribute {name!r}")
    module = import_module(_HOME[name])
    value = module if module.__name__ == f"trueplant.{name}" else getattr(module, name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
