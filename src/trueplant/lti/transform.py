"""Formulas in pv: the declared transform from the recorded PV to what the controller acts on."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from trueplant.arrays import Array
from trueplant.lti.grammar import Call, Name, Node, Number, fail, parse

_FUNCTIONS: dict[str, Callable[[Array], Array]] = {
    "sqrt": np.sqrt,
    "exp": np.exp,
    "log": lambda x: np.where(x == 0, np.nan, np.log(x)),
    "abs": np.abs,
}
_OPERATIONS: dict[str, Callable[[Array, Array], Array]] = {
    "+": np.add,
    "-": np.subtract,
    "*": np.multiply,
    "/": lambda a, b: np.where(b == 0, np.nan, a / b),
    "^": lambda a, b: np.where((a == 0) & (b < 0), np.nan, np.power(a, b)),
}


@dataclass(frozen=True)
class Transform:
    """A formula in ``pv`` with ``+ - * / ^``, parentheses, sqrt, exp, log (natural) and abs.

    Called with an array it gives an array of the same shape; where the formula has no finite real
    value (division by zero, root or logarithm of a negative number, overflow) the result is NaN.
    Raises FormulaError when built from text outside the grammar.
    """

    text: str
    _tree: Node = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        tree = parse(self.text, "pv", _FUNCTIONS)
        if not _mentions_pv(tree):
            fail(self.text, 0, "a PV transform must contain pv")
        object.__setattr__(self, "_tree", tree)

    def __call__(self, pv: ArrayLike) -> Array:
        values = np.asarray(pv, dtype=float)
        with np.errstate(all="ignore"):
            result = np.asarray(_value(self._tree, values), dtype=float)
        return np.where(np.isfinite(result), result, np.nan)

    def __str__(self) -> str:
        return self.text


def parse_pv(text: str) -> Transform:
    """The transform written as ``text``; see `Transform`."""
    return Transform(text)


def _mentions_pv(node: Node) -> bool:
    if isinstance(node, Call):
        return _mentions_pv(node.argument)
    if isinstance(node, Number):
        return False
    return isinstance(node, Name) or _mentions_pv(node.left) or _mentions_pv(node.right)


def _value(node: Node, pv: Array) -> Array:
    if isinstance(node, Number):
        return np.full(pv.shape, node.value)
    if isinstance(node, Name):
        return pv
    if isinstance(node, Call):
        return _FUNCTIONS[node.function](_value(node.argument, pv))
    return _OPERATIONS[node.sign](_value(node.left, pv), _value(node.right, pv))
