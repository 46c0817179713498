"""The flat public namespace is what users rely on; it changes only on purpose."""

import subprocess
import sys

import pytest

import trueplant

PUBLIC = [
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


def test_public_names_are_exactly_these():
    assert trueplant.__all__ == PUBLIC
    assert dir(trueplant) == sorted(PUBLIC)


def test_every_public_name_can_be_had():
    for name in PUBLIC:
        assert getattr(trueplant, name) is not None, name


def test_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="no_such_name"):
        trueplant.no_such_name  # noqa: B018


def test_import_loads_nothing_heavy():
    code = "import sys, trueplant; print([m for m in ('numpy', 'pydantic', 'numba', 'polars') if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
