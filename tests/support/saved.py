"""Saved results of one simulated loop, analysed once for all tests that do something with them."""

from __future__ import annotations

import atexit
import shutil
import tempfile
from functools import cache
from pathlib import Path

from support.command import PROJECT
from trueplant.cli import main

STEPS = 'noise = 0.02\nsetpoints = [{time = 5, output = "y", value = 1}, {time = 60, output = "y", value = -1}, '
TEXT = PROJECT.replace("noise = 0.02\nsetpoints = [{", STEPS + "{")
"""The plant is the model; comments are added where a test needs them."""


def project(gain: float = 2.0, dead_time: float = 2.0, seed: int = 1) -> str:
    """The project file of a plant with this gain and dead time, whose model says 2 and 2."""
    plant = f'plant = [{{output = "y", input = "u", tf = "{gain} exp(-{dead_time} s)/(10 s + 1)"}}]'
    return TEXT.replace("[simulate]\n", f"[simulate]\n{plant}\nseed = {seed}\n")


@cache
def _made(text: str) -> Path:
    folder = Path(tempfile.mkdtemp(prefix="trueplant-saved-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    (folder / "project.toml").write_text(text)
    assert main(["simulate", str(folder / "project.toml"), "--out", str(folder / "record.csv")]) == 0
    assert main(["run", str(folder / "project.toml"), "--out", str(folder / "out")]) == 0
    return folder


def saved(folder: Path, text: str) -> Path:
    """A folder with project.toml, record.csv and the results of that in out/."""
    return Path(shutil.copytree(_made(text), folder, dirs_exist_ok=True))
