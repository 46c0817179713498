"""All outputs at one set of parameters under a vector autoregression, and where a descent over these ended."""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from trueplant.arrays import Array, IntArray
from trueplant.identify import levels
from trueplant.identify.descent import Descent, Problem, descend
from trueplant.identify.joint_errors import PieceErrors, piece_errors, places_of
from trueplant.identify.linear_algebra import orthonormal
from trueplant.identify.row import Row
from trueplant.identify.valve_effects import expected, promised, responses_behind, row_behind
from trueplant.loop.valve import Valve


@dataclass(frozen=True, eq=False)
class JointPoint:
    """All rows at one set of parameters: -2 log likelihood, and its derivatives where they are asked for."""

    rows: Sequence[Row]
    theta: Array
    """(size,) row by row."""
    ar: Array
    """(order, n_y, n_y)"""
    errors: tuple[PieceErrors, ...]
    """Without derivatives."""
    unit: float = 1.0

    @classmethod
    def at(cls, rows: Sequence[Row], x: Array, order: int, root: Array) -> JointPoint:
        """x: theta and ar, one after the other. `root` weights the errors where operating points and initial states
        are taken out of them."""
        size, n = sum(row.size for row in rows), len(rows)
        theta, ar = x[:size], x[size:].reshape(order, n, n)
        return cls(rows, theta, ar, tuple(piece_errors(rows, theta, ar, root, derivatives=False)))

    @cached_property
    def count(self) -> int:
        return int(sum(piece.exist.sum() for piece in self.errors))

    @cached_property
    def sigma(self) -> Array:
        """(n_y, n_y) covariance of the prediction errors."""
        return np.asarray(sum(piece.plain.T @ piece.plain for piece in self.errors) / max(self.count, 1))

    @cached_property
    def root(self) -> Array:
        """L with L' L the inverse of sigma."""
        return np.asarray(np.linalg.inv(np.linalg.cholesky(self.sigma)))

    @cached_property
    def cost(self) -> float:
        """-2 log likelihood up to a constant."""
        prior = sum(row.prior.penalty(part) for row, part in zip(self.rows, self.parts, strict=True))
        return float(self.count * np.linalg.slogdet(self.sigma)[1] + prior)

    @property
    def parts(self) -> list[Array]:
        """theta of each row."""
        return [self.theta[place] for place in places_of(self.rows)]

    @cached_property
    def _normal_equations(self) -> tuple[Array, Array]:
        """(size, size) information and (size,) slope of theta and ar, with the prior."""
        size = self.theta.size + self.ar.size
        information, slope = np.zeros((size, size)), np.zeros(size)
        for piece in piece_errors(self.rows, self.theta, self.ar, self.root):
            information += piece.jacobian.T @ piece.jacobian
            slope += piece.jacobian.T @ piece.weighted
        for row, part, place in zip(self.rows, self.parts, places_of(self.rows), strict=True):
            diagonal, of_prior = row.prior.normal_equations(part)
            information[place, place] += np.diag(diagonal)
            slope[place] += of_prior
        return information, slope

    @property
    def information(self) -> Array:
        return self._normal_equations[0]

    @property
    def slope(self) -> Array:
        return self._normal_equations[1]


@dataclass(frozen=True, eq=False)
class JointPlant:
    """Where all rows together ended, and the problem of which that is the end."""

    problem: Problem[JointPoint]
    found: Descent[JointPoint]
    left: float
    """Degrees of freedom of the prediction errors of an output."""
    gained: dict[Hashable, float] = field(default_factory=dict)
    """By how much -2 log likelihood falls behind the likeliest of some valves (`open_valves`): sought once for all
    outputs."""

    @property
    def deviance(self) -> float:
        """-2 log likelihood up to a constant, of errors as many as are free."""
        return self.found.point.cost * self.left / self.found.point.count

    def held(self, place: IntArray, values: Array) -> JointPlant:
        """With parameters held (all rows on end), as far as bounds allow."""
        problem, x, free = self.problem, self.found.x.copy(), self.problem.free.copy()
        x[place], free[place] = np.clip(values, problem.low[place], problem.high[place]), False
        return self._from(replace(problem, free=free), x, problem.at(x, self.found.point))

    def behind(self, valves: Mapping[int, Valve]) -> JointPlant:
        """With the positions of the valves' stems for their inputs, by column; as near the end as comparisons need."""
        if not valves:
            return self
        point = self.found.point
        rows, order = [row_behind(row, valves) for row in point.rows], len(point.ar)
        problem = replace(
            self.problem,
            at=lambda x, near: JointPoint.at(rows, x, order, near.root),
            settled=levels.TRIED_SETTLED,
        )
        return self._from(problem, self.found.x, problem.at(self.found.x, point))

    def _from(self, problem: Problem[JointPoint], x: Array, point: JointPoint) -> JointPlant:
        return JointPlant(problem, descend(problem, x, point, levels.JOINT_ITERATIONS), self.left)

    def promised(self, column: int, valves: Sequence[Valve]) -> Array:
        """(m,) by how much -2 log likelihood would fall to first order behind each of these in an input."""
        errors, basis = self._linear
        left = self.left * len(self._point.rows)
        return promised(errors, basis, left, lambda batch: self._fallen(column, batch), valves)

    @property
    def _point(self) -> JointPoint:
        return self.found.point

    @cached_property
    def _pieces(self) -> tuple[PieceErrors, ...]:
        point = self._point
        return tuple(piece_errors(point.rows, point.theta, point.ar, point.root))

    @cached_property
    def _linear(self) -> tuple[Array, Array]:
        """Errors (n,) of predictions and of what is expected, and what spans (n, rank) those that may still change."""
        point, free = self._point, self.problem.free
        told = np.vstack([piece.jacobian for piece in self._pieces])
        alone = np.einsum("nk,nk->k", told, told)
        distances, slopes = np.zeros(2 * point.theta.size), np.zeros((2 * point.theta.size, free.size))
        for row, theta, place in zip(point.rows, point.parts, places_of(point.rows), strict=True):
            own = slice(2 * place.start, 2 * place.stop)
            distances[own], slopes[own, place] = expected(row, theta, alone[place], 1.0)
        errors = np.concatenate([*(piece.weighted for piece in self._pieces), distances])
        return errors, orthonormal(np.vstack([told, slopes])[:, free])

    def _fallen(self, column: int, valves: Sequence[Valve]) -> Array:
        """(m, n) by how much the errors are smaller with the positions of each stem for an input."""
        point, fallen = self._point, []
        for k, piece in enumerate(self._pieces):
            moved = np.zeros((len(valves), piece.weighted.size))
            for i, (row, theta) in enumerate(zip(point.rows, point.parts, strict=True)):
                for m, spec in enumerate(row.specs):
                    if spec.column == column:
                        moved += piece.fallen(i, responses_behind(row, theta, m, row.pieces[k], valves))
            fallen.append(moved)
        return np.hstack([*fallen, np.zeros((len(valves), 2 * point.theta.size))])
