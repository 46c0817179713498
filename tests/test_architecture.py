"""The house keeps its plan: no circle of files, no room above another, files and functions one can read."""

import ast
from collections.abc import Iterator
from pathlib import Path

import grimp
import pytest

import trueplant

ROOT = Path(trueplant.__file__).parent
FILES = sorted(ROOT.rglob("*.py"))
LONGEST_FILE, LONGEST_FUNCTION, MOST_PARAMETERS = 400, 60, 8
ALLOWED_CIRCLE = frozenset({"trueplant.lti.formula", "trueplant.lti.printing", "trueplant.lti.transfer"})
"""A transfer function prints itself as a formula, and a formula is read into a transfer function."""

LONG_FUNCTIONS: dict[str, str] = {}
MANY_PARAMETERS: dict[str, str] = {
    "loop/kernel.py:_term_output": "compiled code takes arrays, not classes",
    "loop/kernel.py:run_loop": "compiled code takes arrays, not classes",
    "loop/law.py:entry_output": "compiled code takes arrays, not classes",
    "loop/simulate.py:simulate": "called from notebooks: each is a signal or setting that most calls leave out",
    "tune/propose.py:propose": "called from notebooks: what is promised is given by name, and mostly left as it is",
}
"""Exceptions by "file:function", each with its reason."""


@pytest.fixture(scope="module")
def graph() -> grimp.ImportGraph:
    """Every import counts: those inside functions and under TYPE_CHECKING too."""
    return grimp.build_graph("trueplant", cache_dir=None, exclude_type_checking_imports=False)


def circles(graph: grimp.ImportGraph) -> list[frozenset[str]]:
    """Strongly connected components of more than one module (Tarjan, without recursion)."""
    order: dict[str, int] = {}
    low: dict[str, int] = {}
    stack: list[str] = []
    found = []
    for root in sorted(graph.modules):
        if root in order:
            continue
        work: list[tuple[str, Iterator[str]]] = []

        def enter(module: str) -> None:
            order[module] = low[module] = len(order)
            stack.append(module)
            work.append((module, iter(sorted(graph.find_modules_directly_imported_by(module)))))  # noqa: B023

        enter(root)
        while work:
            module, rest = work[-1]
            for imported in rest:
                if imported not in order:
                    enter(imported)
                    break
                if imported in stack:
                    low[module] = min(low[module], order[imported])
            else:
                work.pop()
                if work:
                    low[work[-1][0]] = min(low[work[-1][0]], low[module])
                if low[module] == order[module]:
                    component = set()
                    while module not in component:
                        component.add(stack.pop())
                    if len(component) > 1:
                        found.append(frozenset(component))
    return found


def test_a_circle_is_found():
    graph = grimp.ImportGraph()
    for name in "abcde":
        graph.add_module(name)
    for importer, imported in ("ab", "bc", "ca", "cd", "de"):
        graph.add_import(importer=importer, imported=imported)
    assert circles(graph) == [frozenset("abc")]


def test_no_circle_of_files_but_that_of_formulas(graph):
    assert len(graph.modules) == len(FILES)
    assert circles(graph) == [ALLOWED_CIRCLE]


def test_no_room_imports_the_root(graph):
    assert graph.find_modules_that_directly_import("trueplant") == set()


def test_files_can_be_read_in_one_sitting():
    long = {f.relative_to(ROOT).as_posix(): n for f in FILES if (n := len(f.read_text().splitlines())) > LONGEST_FILE}
    assert long == {}


def functions() -> Iterator[tuple[str, ast.FunctionDef, bool]]:
    """Every function with its place, and whether it is a method."""
    for file in FILES:
        tree = ast.parse(file.read_text())
        methods = {f for c in ast.walk(tree) if isinstance(c, ast.ClassDef) for f in c.body}
        for node in ast.walk(tree):
            if isinstance(node, ast.FunctionDef):
                yield f"{file.relative_to(ROOT).as_posix()}:{node.name}", node, node in methods


def code_lines(node: ast.FunctionDef) -> int:
    """Lines of a function without its docstring."""
    body = node.body[1:] if ast.get_docstring(node) is not None and len(node.body) > 1 else node.body
    assert node.end_lineno is not None
    return node.end_lineno - body[0].lineno + 1 + (body[0].lineno > node.lineno)


def test_functions_can_be_seen_at_once():
    long = {place for place, node, _ in functions() if code_lines(node) > LONGEST_FUNCTION}
    assert long == set(LONG_FUNCTIONS)


def test_functions_take_few_parameters():
    many = {
        place
        for place, node, method in functions()
        if len(node.args.posonlyargs) + len(node.args.args) + len(node.args.kwonlyargs) - method > MOST_PARAMETERS
    }
    assert many == set(MANY_PARAMETERS)
