"""Significance levels, thresholds and search ranges of a room stand in its levels.py, each with its reason.

Run as a script, or with `pytest -s`, it prints how many each room has.
"""

from __future__ import annotations

import ast
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest

import trueplant

ROOT = Path(trueplant.__file__).parent
LEVELS = "levels.py"
NOT_YET: set[str] = set()
"""Rooms that may still lack a levels.py; one that has it is held to it whatever stands here. This list only shrinks."""
LEFT_BEHIND: set[str] = set()
"""Single numbers that have to follow; this list only shrinks as well."""
ELSEWHERE = {
    "exit statuses of the commands": {
        "cli/analyse.py:MISMATCH",
        "cli/analyse.py:REFUSED",
        "cli/entry.py:INTERNAL_ERROR",
        "cli/entry.py:INTERRUPTED",
        "cli/data.py:REFUSED",
        "app/server.py:INTERRUPTED",
    },
    "layout of figures and tables, in pixels or characters": {
        "app/behind.py:ROWS",
        "app/checked.py:MOST",
        "app/downloads.py:_LONGEST",
        "app/element_view.py:TRENDS",
        "app/saved.py:_SUM",
        "app/screens/columns.py:MOST_COLUMNS",
        "app/screens/columns.py:POINTS",
        "app/screens/model.py:SHOWN",
        "app/screens/preview.py:CELL",
        "app/screens/preview.py:COLUMNS",
        "app/screens/preview.py:ROWS",
        "app/screens/struck.py:SHOWN",
        "app/screens/trends.py:POINTS",
        "app/svg.py:EDGE",
        "app/svg.py:HEIGHT",
        "app/svg.py:POINTS",
        "app/svg.py:WIDE",
        "app/svg.py:WIDTH",
        "app/whatif_answers.py:DIGITS",
        "printable.py:_WINDOW",
        "paper/figures.py:GAP",
        "paper/figures.py:PANEL",
        "report/figures.py:GAP",
        "report/figures.py:PANEL",
        "report/matrices.py:PANEL",
        "report/matrices.py:SPACING",
        "report/style.py:BOTTOM",
        "report/style.py:_LINE",
        "report/style.py:LEFT",
        "report/style.py:RIGHT",
        "report/style.py:TOP",
        "cli/data.py:SHOWN",
        "report/tables.py:HALF",
        "report/tables.py:WIDTH",
    },
    "what the paper prints, and the records that are simulated after it": {
        "paper/equations.py:POINTS",
        "paper/equations.py:SEED",
        "paper/figures.py:POINTS",
        "paper/mill.py:DURATION",
        "paper/mill.py:H",
        "paper/mill.py:SIGMA",
        "paper/mill.py:W_I",
        "paper/mill.py:W_P",
        "paper/records.py:ELEMENTS",
        "paper/records.py:H",
        "paper/records.py:LEVELS",
        "paper/records.py:LONG",
        "paper/records.py:OWN_FIT",
        "paper/records.py:SAMPLES",
        "paper/records.py:SLOW_TIME",
        "paper/records.py:STEP_TIMES",
        "paper/splitter.py:FINE",
        "paper/splitter.py:LONG",
        "paper/splitter.py:TOP",
        "paper/splitter.py:VAPORISATION",
        "paper/tables.py:SEEDS",
        "paper/tables.py:SHOWN_SEED",
        "paper/tables.py:WINDOW",
    },
    "what the pages keep at hand, which no answer depends on": {
        "app/saved.py:KEPT",
        "app/screens/aside.py:KEPT",
        "app/screens/columns.py:KEPT",
        "app/screens/records.py:KEPT",
        "app/screens/start.py:MOST_PREVIEWS",
        "app/whatif_answers.py:KEPT",
        "app/whatif_answers.py:KEPT_CURVES",
    },
    "what the command line has by default": {"app/screens/track.py:PRECISION"},
    "a controller to begin from": {"app/faceplates.py:_BARE"},
    "mathematical constants, and numbers that formulas were derived for": {
        "lti/formula.py:_ONE",
        "mismatch/polynomial.py:NODES",
        "mismatch/polynomial.py:TERMS",
    },
    "the calendar": {
        "calendar.py:_NEAR_ZONE",
        "calendar.py:_QUARTER",
        "fleet/demo/site.py:END",
        "fleet/demo/site.py:START",
        "project/bundle.py:EPOCH",
        "record/stamps.py:_DAY",
        "record/stamps.py:_EPOCH",
        "record/stamps.py:_LENGTHS",
        "record/times.py:_YEAR_1",
        "record/times.py:_YEAR_10000",
    },
    "versions of file formats": {"result/schema.py:VERSION"},
    "sizes of files": {"output.py:MOST_SAMPLES"},
    "sizes of arrays held at once, which no result depends on": {
        "identify/initial_state.py:RUN",
        "identify/noise.py:BLOCK",
        "identify/valve_effects.py:BATCH",
        "record/laplace.py:_CHUNK",
        "record/spectra.py:BATCH",
    },
}
"""Numbers that are no thresholds, by the reason why they stand where they do."""
KNOWN = set().union(*ELSEWHERE.values())


def is_numeric(value: ast.expr) -> bool:
    """Made of numbers alone: a literal, arithmetic, a tuple, an array of them."""
    parts = list(ast.walk(value))
    constants = [part.value for part in parts if isinstance(part, ast.Constant)]
    collected = any(isinstance(part, (ast.Dict, ast.Lambda, ast.comprehension)) for part in parts)
    return bool(constants) and not collected and all(type(c) in (int, float, complex) for c in constants)


def assigned(statement: ast.stmt) -> list[str]:
    """Upper-case names that a statement gives a value to."""
    targets = statement.targets if isinstance(statement, ast.Assign) else []
    if isinstance(statement, ast.AnnAssign) and statement.value is not None:
        targets = [statement.target]
    names = [part.id for target in targets for part in ast.walk(target) if isinstance(part, ast.Name)]
    return [name for name in names if name.isupper()]


def statements(file: Path) -> list[ast.stmt]:
    return ast.parse(file.read_text(encoding="utf-8")).body


def room_of(file: Path) -> str:
    return file.relative_to(ROOT).parts[0]


def strays() -> Iterator[tuple[str, str]]:
    """Room and place of every numeric constant of a module outside levels.py."""
    for file in sorted(ROOT.rglob("*.py")):
        for statement in statements(file):
            if file.name != LEVELS and isinstance(statement, (ast.Assign, ast.AnnAssign)):
                for name in assigned(statement):
                    if is_numeric(statement.value):
                        yield room_of(file), f"{file.relative_to(ROOT).as_posix()}:{name}"


def levels_of(file: Path) -> list[str]:
    return [name for statement in statements(file) for name in assigned(statement)]


def table() -> str:
    """Thresholds and levels by room."""
    homes = {room_of(file): len(levels_of(file)) for file in sorted(ROOT.rglob(LEVELS))}
    others = Counter(room for room, place in strays() if place not in KNOWN)
    lines = [f"{'room':14}{'in levels.py':>14}{'elsewhere':>12}"]
    lines += [f"{room:14}{homes.get(room, 0):14}{others[room]:12}" for room in sorted({*homes, *others})]
    return "\n".join([*lines, f"{'all':14}{sum(homes.values()):14}{sum(others.values()):12}"])


def test_the_numbers_of_a_room_stand_in_its_levels():
    print("\n" + table())
    done = {room_of(file) for file in ROOT.rglob(LEVELS)}
    places = {place for room, place in strays() if room in done or room not in NOT_YET}
    assert places <= KNOWN | LEFT_BEHIND


def test_the_lists_name_nothing_that_is_gone():
    assert {place for _, place in strays()} >= KNOWN | LEFT_BEHIND
    assert {file.name for file in ROOT.iterdir() if file.is_dir()} >= NOT_YET


def test_a_room_has_one_home_of_its_levels():
    homes = [room_of(file) for file in ROOT.rglob(LEVELS)]
    assert len(homes) == len(set(homes))


@pytest.mark.parametrize("file", sorted(ROOT.rglob(LEVELS)), ids=room_of)
def test_every_level_says_what_set_it(file):
    body = statements(file)
    for statement, after in zip(body, [*body[1:], None], strict=True):
        if names := assigned(statement):
            said = isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant) and after.value.value
            assert isinstance(said, str) and len(said.split()) > 1, f"{file.relative_to(ROOT)}: {names}"


def test_constants_are_told_apart():
    text = "A = -1.5\nB, C = 1, np.array([0.5, 2])\nD: float = 2**3\nE = 'x'\nF = {1: 2}\nG = True\nh = 3\nI = A"
    made = [s for s in ast.parse(text).body if isinstance(s, (ast.Assign, ast.AnnAssign))]
    assert [name for s in made for name in assigned(s) if is_numeric(s.value)] == ["A", "B", "C", "D"]


if __name__ == "__main__":
    print(table())
