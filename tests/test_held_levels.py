"""For every threshold of identify, detect and study a test fails if it is doubled, and one if it is halved."""

from __future__ import annotations

import ast
import os
import subprocess
import sys
from pathlib import Path

import pytest

import trueplant
from support import ROOT
from support.levels import NO_THRESHOLDS, no_thresholds

ROOMS = ("identify", "detect", "study")
TESTS = ROOT / "tests"


def levels() -> set[str]:
    found = set()
    for room in ROOMS:
        file = Path(trueplant.__file__).parent / room / "levels.py"
        for statement in ast.parse(file.read_text(encoding="utf-8")).body:
            targets = statement.targets if isinstance(statement, ast.Assign) else []
            found |= {f"{room}.{one.id}" for target in targets for one in ast.walk(target) if isinstance(one, ast.Name)}
    return found


def held() -> dict[Path, list[str]]:
    """By file of tests: the levels that they are marked to hold."""
    found: dict[Path, list[str]] = {}
    for file in sorted(TESTS.rglob("test_*.py")):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call) and ast.unparse(node.func) == "pytest.mark.holds":
                found.setdefault(file, []).extend(ast.literal_eval(one) for one in node.args)
    return found


HELD = held()
NAMES = {level for of in HELD.values() for level in of}


def test_every_level_is_held_or_is_no_threshold():
    """A new one is to be held by a test marked `holds("room.LEVEL")`, or to be listed in support/levels.py."""
    assert NAMES | no_thresholds() == levels()
    assert not NAMES & no_thresholds()
    kinds = [level for kind in NO_THRESHOLDS.values() for level in kind.split()]
    assert len(kinds) == len(set(kinds))


@pytest.mark.slow
def test_a_test_fails_with_either_value_of_every_threshold():
    command = [sys.executable, "-m", "pytest", "-q", "-p", "support.moved_levels", "-p", "no:cacheprovider", "--tb=no"]
    path = {"PYTHONPATH": os.pathsep.join([str(TESTS), os.environ.get("PYTHONPATH", "")])}
    done = subprocess.run([*command, *map(str, HELD)], cwd=ROOT, env=os.environ | path, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
    assert f"{len(NAMES)} levels, 0 of their values not held" in done.stdout
