"""Shared fixtures. Real records are read from the folder named by TRUEPLANT_DATA_DIR."""

from __future__ import annotations

import os
from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def real_data() -> Path:
    """The folder of the real records; tests that need it skip only if it was never named."""
    named = os.environ.get("TRUEPLANT_DATA_DIR")
    if not named:
        pytest.skip(
            "the real records belong to others and are not part of the project: "
            "to run this test, name the folder that holds them in TRUEPLANT_DATA_DIR"
        )
    folder = Path(named)
    assert any(folder.glob("*/*.csv")), f"TRUEPLANT_DATA_DIR={named} holds no records"
    return folder
