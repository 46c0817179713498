"""A small site: quick loops whose records are simulated once."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from trueplant.project import Project
from trueplant.project.simulation import as_file, simulate_record

MODEL, CHANGED = "2 exp(-1 s)/(6 s + 1)", "3 exp(-1 s)/(6 s + 1)"
LOOP = """
time_unit = "min"
[data]
files = ["{name}.csv"]
time = "t"
[[output]]
name = "y"
pv = "pv"
sp = "sp"
[[input]]
name = "u"
op = "op"
[[model]]
output = "y"
input = "u"
tf = "{model}"
[[controller]]
input = "u"
output = "y"
form = "ideal"
Kc = 1.0
Ti = 6.0
sample_time = 0.5
[simulate]
plant = [{{output = "y", input = "u", tf = "{plant}"}}]
duration = {duration}
sample_time = 0.5
seed = {seed}
noise = 0.05
setpoints = [{setpoints}]
"""
SITE = """
name = "Test site"
[[loops]]
projects = "units/*.toml"
"""


def loop_text(name: str, plant: str = MODEL, seed: int = 1, duration: int = 300) -> str:
    """A project whose record is simulated for so many minutes; its set-point steps every 100 min."""
    steps = ((start + 20, 1 - 2 * (start // 100 % 2)) for start in range(0, duration, 100))
    setpoints = ", ".join(f'{{output = "y", time = {time}, value = {value}}}' for time, value in steps)
    return LOOP.format(name=name, model=MODEL, plant=plant, seed=seed, duration=duration, setpoints=setpoints)


def write_loop(folder: Path, name: str, plant: str = MODEL, seed: int = 1, duration: int = 300) -> Path:
    """That project and its record."""
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / f"{name}.toml"
    file.write_text(loop_text(name, plant, seed, duration), encoding="utf-8")
    project = Project.load(file)
    (folder / f"{name}.csv").write_bytes(as_file(simulate_record(project), f"{name}.csv"))
    return file


@pytest.fixture(scope="session")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two loops: `same`, whose plant is its model, and `other`, whose gain is half as large again."""
    folder = tmp_path_factory.mktemp("site")
    write_loop(folder / "units", "same", seed=1)
    write_loop(folder / "units", "other", CHANGED, seed=2)
    (folder / "site.toml").write_text(SITE, encoding="utf-8")
    return folder


@pytest.fixture
def site(made: Path, tmp_path: Path) -> Path:
    """The site file of a copy that a test may change."""
    shutil.copytree(made, tmp_path / "site")
    return tmp_path / "site" / "site.toml"


@pytest.fixture
def add() -> Callable[[Path, str], None]:
    """Add lines to a file."""

    def put(file: Path, text: str) -> None:
        file.write_text(f"{file.read_text(encoding='utf-8')}\n{text}\n", encoding="utf-8")

    return put
