"""Formula text to a syntax tree: one small recursive-descent parser for all formulas.

    sum      =  product { ("+" | "-") product }
    product  =  factor { ["*" | "/"] factor }          a missing sign means multiplication
    factor   =  ("+" | "-") factor  |  atom [ ("^" | "**") factor ]
    atom     =  number  |  name  |  function "(" sum ")"  |  "(" sum ")"

Text is data here and is never executed. What a name means is decided by whoever walks the tree.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from dataclasses import dataclass
from typing import NoReturn

from trueplant.errors import FormulaError
from trueplant.lti import levels
from trueplant.printable import SHOWN, around

_TOKEN = re.compile(
    r"\s*(?:(?P<number>(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?)|(?P<name>[^\W\d]\w*)|(?P<sign>\*\*|[-+*/^()]))"
)
# Signs that arrive when a formula is pasted from a document.
_PASTED = str.maketrans({"\u2212": "-", "\u00b7": "*", "\u00d7": "*", "\u22c5": "*"})


@dataclass(frozen=True)
class Number:
    value: float
    at: int


@dataclass(frozen=True)
class Name:
    text: str
    at: int


@dataclass(frozen=True)
class Call:
    function: str
    argument: Node
    at: int


@dataclass(frozen=True)
class Operation:
    """``sign`` is one of ``+ - * / ^``."""

    sign: str
    left: Node
    right: Node
    at: int


Node = Number | Name | Call | Operation


def fail(text: str, at: int, what: str) -> NoReturn:
    """Raise FormulaError saying ``what``, with a caret under character ``at`` of the formula."""
    shown, below = around(text, at)
    raise FormulaError(f"formula, column {at + 1}: {what}{SHOWN}{shown}{SHOWN}{' ' * below}^")


def parse(text: str, variable: str, functions: Iterable[str]) -> Node:
    """Syntax tree of a formula in ``variable`` that may call ``functions``; FormulaError if there is none."""
    if not isinstance(text, str):
        raise FormulaError(f"a formula is text or a number, not {type(text).__name__}")
    if not text.strip():
        raise FormulaError(f"the formula is empty; write one in {variable}, or 0 for none")
    if len(text) > levels.LONGEST_FORMULA:
        raise FormulaError(f"the formula has {len(text)} characters; {levels.LONGEST_FORMULA} is the most that is read")
    return _Parser(text, variable, tuple(functions)).whole()


class _Parser:
    def __init__(self, text: str, variable: str, functions: tuple[str, ...]) -> None:
        self.text, self.variable, self.functions = text, variable, functions
        self.tokens = self._tokens(text.translate(_PASTED))
        self.position, self.depth = 0, 0

    def _tokens(self, text: str) -> list[tuple[str, str, int]]:
        tokens, at = [], 0
        end = len(text.rstrip())
        while at < end:
            match = _TOKEN.match(text, at)
            if match is None:
                at += len(text[at:]) - len(text[at:].lstrip())
                if text[at] == ",":
                    fail(self.text, at, "',' is not in the grammar; write decimals with a point, as in 0.5")
                fail(
                    self.text, at, f"unexpected character {text[at]!r}; use numbers, {self._known()}, + - * / ^ and ( )"
                )
            kind = match.lastgroup or ""
            tokens.append((kind, match.group(kind), match.start(kind)))
            at = match.end()
        return [*tokens, ("end", "", end)]

    def _known(self) -> str:
        return ", ".join((self.variable, *(f"{f}(...)" for f in self.functions)))

    def _take(self, *signs: str) -> tuple[str, int] | None:
        """The next token if it is one of these signs."""
        kind, token, at = self.tokens[self.position]
        if kind != "sign" or token not in signs:
            return None
        self.position += 1
        return token, at

    def _deeper(self, at: int) -> None:
        self.depth += 1
        if self.depth > levels.DEEPEST_NESTING:
            fail(self.text, at, f"nested deeper than {levels.DEEPEST_NESTING} levels; write the formula flatter")

    def whole(self) -> Node:
        tree = self._sum()
        kind, token, at = self.tokens[self.position]
        if kind != "end":
            fail(self.text, at, f"unexpected {token!r}; a parenthesis is missing or left over")
        return tree

    def _sum(self) -> Node:
        tree = self._product()
        while taken := self._take("+", "-"):
            tree = Operation(taken[0], tree, self._product(), taken[1])
        return tree

    def _product(self) -> Node:
        tree, divided = self._factor(), False
        while True:
            kind, token, at = self.tokens[self.position]
            if taken := self._take("*", "/"):
                divided = taken[0] == "/"
                tree = Operation(taken[0], tree, self._factor(), at)
            elif kind in ("number", "name") or token == "(":
                # 1/2 s means s/2 to some and 1/(2 s) to others; a dead time can only be meant as a factor.
                if divided and token not in ("exp", "e"):
                    fail(self.text, at, "is this still divided by? write a/(b c), or (a/b)*c, to make it clear")
                if kind == "number":
                    fail(
                        self.text,
                        at,
                        f"number {token!r} follows without a sign; write * between, or correct the number",
                    )
                tree = Operation("*", tree, self._factor(), at)
            else:
                return tree

    def _factor(self) -> Node:
        if sign := self._take("+", "-"):
            self._deeper(sign[1])
            tree = self._factor()
            self.depth -= 1
            return tree if sign[0] == "+" else Operation("*", Number(-1.0, sign[1]), tree, sign[1])
        tree = self._atom()
        if power := self._take("^", "**"):
            self._deeper(power[1])
            tree = Operation("^", tree, self._factor(), power[1])
            self.depth -= 1
        return tree

    def _atom(self) -> Node:
        kind, token, at = self.tokens[self.position]
        self.position += 1
        if kind == "number":
            if not math.isfinite(float(token)):
                fail(self.text, at, f"{token} is too large a number; give a finite one")
            return Number(float(token), at)
        if token == "(":
            return self._parenthesised(at)
        if kind == "name":
            return self._named(token, at)
        if kind == "end":
            fail(self.text, at, "the formula ends too early; a number, a name or '(' is missing")
        fail(self.text, at, f"unexpected {token!r}; a number, {self.variable} or '(' belongs here")

    def _named(self, token: str, at: int) -> Node:
        following = self.tokens[self.position]
        if token in self.functions:
            if following[1] != "(":
                fail(self.text, at, f"{token} needs its argument in parentheses: {token}(...)")
            self.position += 1
            return Call(token, self._parenthesised(following[2]), at)
        if token == "e" and "exp" in self.functions:
            if not self._take("^", "**"):
                fail(self.text, at, "e stands only before a power, as in e^(...); a number such as 2e-3 has no spaces")
            self._deeper(at)
            exponent = self._atom() if self.tokens[self.position][1] == "(" else self._factor()
            self.depth -= 1
            return Call("exp", exponent, at)
        if token != self.variable:
            fail(self.text, at, f"unknown name {token!r}; the names known here are {self._known()}")
        return Name(token, at)

    def _parenthesised(self, opened: int) -> Node:
        self._deeper(opened)
        tree = self._sum()
        if not self._take(")"):
            fail(self.text, opened, "this parenthesis is never closed; add ')'")
        self.depth -= 1
        return tree
