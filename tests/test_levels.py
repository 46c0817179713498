"""Levels, thresholds and search ranges stand in one module a room, each with its reason."""

import ast
import re
from pathlib import Path

import pytest

import trueplant

LEVELS = sorted(Path(trueplant.__file__).parent.rglob("levels.py"))


@pytest.mark.parametrize("file", LEVELS, ids=lambda f: f.parent.name)
def test_every_level_has_its_reason(file):
    body = ast.parse(file.read_text()).body
    constants = [k for k, node in enumerate(body) if isinstance(node, ast.Assign | ast.AnnAssign)]
    assert constants
    for k in constants:
        after = body[k + 1] if k + 1 < len(body) else None
        reason = after.value if isinstance(after, ast.Expr) else None
        assert isinstance(reason, ast.Constant) and isinstance(reason.value, str), ast.unparse(body[k])
        assert len(reason.value) > 10, ast.unparse(body[k])


@pytest.mark.parametrize("file", LEVELS, ids=lambda f: f.parent.name)
def test_every_level_is_used(file):
    names = {
        name.id
        for node in ast.parse(file.read_text()).body
        if isinstance(node, ast.Assign)
        for target in node.targets
        for name in ast.walk(target)
        if isinstance(name, ast.Name)
    }
    text = "\n".join(f.read_text() for f in file.parent.rglob("*.py") if f != file)
    assert {name for name in names if not re.search(rf"\b{name}\b", text)} == set()
