"""A plugin of pytest that asks whether levels are held: each test that names one runs with it doubled, then halved.

    PYTHONPATH=tests python -m pytest -p support.moved_levels tests

Of the tests marked with `holds("room.LEVEL", ...)` at least one has to fail with either value of each level; the others
are listed at the end, and the status is 1. Shares of more than half are moved in odds, whole numbers rounded.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Generator, Iterator
from types import FunctionType
from typing import Any

import pytest

MARK = "holds"
FACTORS = {"doubled": 2.0, "halved": 0.5}


def moved(value: Any, factor: float) -> Any:
    """A level, or each member of one, doubled or halved: a share of more than half in odds, a whole number rounded."""
    if isinstance(value, tuple):
        return tuple(moved(member, factor) for member in value)
    if isinstance(value, int):
        return round(factor * value)
    if 0.5 < value < 1:
        odds = factor * value / (1 - value)
        return odds / (1 + odds)
    return factor * value


def home(level: str) -> tuple[Any, str]:
    room, name = level.split(".")
    return importlib.import_module(f"trueplant.{room}.levels"), name


def defaults_of(value: Any) -> Iterator[FunctionType]:
    """Functions of the package that have this very object as the default of an argument."""
    for module in [m for name, m in sys.modules.items() if name.startswith("trueplant")]:
        for function in vars(module).values():
            if isinstance(function, FunctionType) and any(d is value for d in function.__defaults__ or ()):
                yield function


class Asked:
    """Which values of which levels some test has found out."""

    def __init__(self) -> None:
        self.found: dict[tuple[str, str], str] = {}

    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        items[:] = [item for item in items if item.get_closest_marker(MARK)]

    def pytest_generate_tests(self, metafunc: pytest.Metafunc) -> None:
        levels = [level for mark in metafunc.definition.iter_markers(MARK) for level in mark.args]
        if levels:
            cases = [(level, word) for level in levels for word in FACTORS]
            metafunc.parametrize("moved_level", cases, indirect=True, ids=[f"{level} {word}" for level, word in cases])

    @pytest.fixture(autouse=True)
    def moved_level(self, request: pytest.FixtureRequest) -> Iterator[None]:
        level, word = request.param
        levels, name = home(level)
        self.found.setdefault((level, word), "")
        before = getattr(levels, name)
        after = moved(before, FACTORS[word])
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(levels, name, after)
            for function in defaults_of(before):
                own = tuple(after if d is before else d for d in function.__defaults__ or ())
                patch.setattr(function, "__defaults__", own)
            yield

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_makereport(self, item: pytest.Item) -> Generator[None, Any, Any]:
        report = yield
        if report.failed:
            self.found[item.callspec.params["moved_level"]] = item.nodeid  # type: ignore[attr-defined]
            report.outcome = "passed"
        return report

    def unheld(self) -> list[str]:
        return [f"{level} {word}" for (level, word), test in self.found.items() if not test]

    def pytest_terminal_summary(self, terminalreporter: pytest.TerminalReporter) -> None:
        for place in self.unheld():
            terminalreporter.write_line(f"{place}: no test fails")
        levels = {level for level, _ in self.found}
        terminalreporter.write_line(f"{len(levels)} levels, {len(self.unheld())} of their values not held")

    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        if self.unheld() or not self.found:
            session.exitstatus = pytest.ExitCode.TESTS_FAILED


def pytest_configure(config: pytest.Config) -> None:
    config.pluginmanager.register(Asked(), "asked")
