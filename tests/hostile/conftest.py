"""A sound project with its record, for tests to break."""

from __future__ import annotations

from pathlib import Path

import pytest

from support.command import simulated, sound


@pytest.fixture(scope="module")
def record(tmp_path_factory: pytest.TempPathFactory) -> str:
    return simulated(tmp_path_factory.mktemp("record"))


@pytest.fixture
def folder(tmp_path: Path, record: str, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return sound(tmp_path, record)
