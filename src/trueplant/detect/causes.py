"""Instruments or the plant: the explanations of changed gains with the fewest faults, compared with each other.

A sensor whose span is off multiplies the gains of its row, a valve or the sensor of a measured disturbance those of its
column, and the plant itself can move any gain by itself. One set of such faults is named only where no other of as few
explains the gains as well.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components
from scipy.stats import chi2, norm

from trueplant.arrays import Array, BoolArray

Cause = tuple[str, int] | tuple[str, int, int]
"""("row", output), ("column", input), or ("element", output, input): the plant itself."""


@dataclass(frozen=True)
class CommonFactor:
    """All gains of a row or a column have changed by the same factor."""

    kind: str
    """"row" (one output: its sensor) or "column" (one input: its actuator)."""
    index: int
    factor: float
    std_error: float

    @property
    def cause(self) -> Cause:
        return self.kind, self.index


@dataclass(frozen=True)
class Explanation:
    """Faults that together explain the elements that changed."""

    factors: tuple[CommonFactor, ...]
    elements: tuple[tuple[int, int], ...]
    """The changed ones that no factor explains: the plant itself."""
    p_value: float
    """That the gains are as the factors say (Wald's test); 1 where nothing tests it."""

    @property
    def causes(self) -> frozenset[Cause]:
        own: list[Cause] = [("element", *place) for place in self.elements]
        return frozenset([*(factor.cause for factor in self.factors), *own])


def blocks(known: BoolArray, changed: BoolArray, moved: BoolArray) -> list[BoolArray]:
    """The `changed` elements that `explanations` has to take together: no fault of one block touches another's gains.

    known: the gains that are; those of one row are of one estimate. An instrument touches all gains of its line.
    Several blocks would otherwise be as many explanations as the product of theirs.
    """
    suspect = changed.any(axis=0) & ~moved.any(axis=0)
    n_y, n_u = changed.shape
    touching = np.zeros((n_y + n_u, n_y + n_u), dtype=bool)
    touching[:n_y, n_y:] = (known | changed) & suspect
    _, label = connected_components(touching, directed=False)
    own = [changed & (label[:n_y] == one)[:, None] for one in np.unique(label[:n_y])]
    return [block for block in own if block.any()]


def explanations(
    ratio: Array, covariance: Array, present: BoolArray, changed: BoolArray, moved: BoolArray, level: float
) -> list[Explanation]:
    """All explanations of the `changed` elements with the fewest faults that are not rejected at `level`.

    ratio (n_y, n_u): plant over model of each gain, NaN where it is not known; covariance (n_y n_u, n_y n_u) of them,
    row after row; present: the elements that there are; moved: those whose dynamics have changed. These are the plant,
    and no instrument of their row and column is a suspect. Changed elements are explained by the factors of their row
    and column, or each by a fault of the plant; what a factor touches has to have it, changed or not.

    An instrument counts as one fault only where every gain of its row or column has changed by itself (at `level`,
    two-sided, Bonferroni over the elements). Otherwise it counts as many as the changes that it explains, so that it is
    a rival of the plant and no better: one gain alone can come from anywhere.
    """
    search = _Search(ratio, covariance, present, changed & ~moved, moved, level, int((changed & ~moved).sum()))
    search.through(np.where(search.suspects[0], -1, 0), np.where(search.suspects[1], -1, 0))
    return search.best


@dataclass(eq=False)
class _Search:
    """Branch and bound over the instruments: in, out or (-1) not decided."""

    ratio: Array
    covariance: Array
    present: BoolArray
    changed: BoolArray
    moved: BoolArray
    level: float
    fewest: int
    """Faults that are enough: at first the plant in every changed element."""
    best: list[Explanation] = field(default_factory=list)

    @cached_property
    def known(self) -> BoolArray:
        return self.present & np.isfinite(self.ratio)

    @cached_property
    def suspects(self) -> tuple[BoolArray, BoolArray]:
        """Rows and columns with a change to explain and no changed dynamics."""
        row, column = (np.asarray(self.changed.any(axis=k) & ~self.moved.any(axis=k)) for k in (1, 0))
        return row, column

    @cached_property
    def cost(self) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Faults that each row and column counts for."""
        limit = norm.isf(self.level / (2 * max(int(self.present.sum()), 1)))
        sigma = np.sqrt(np.diag(self.covariance)).reshape(self.ratio.shape)
        alone = self.known & (np.abs(np.where(self.known, self.ratio, 1.0) - 1) >= limit * sigma)
        row, column = (np.where((alone | ~self.present).all(axis=k), 1, self.changed.sum(axis=k)) for k in (1, 0))
        return row, column

    def through(self, rows: NDArray[np.intp], columns: NDArray[np.intp]) -> None:
        """All decisions that are left, unless they need more faults than known already or contradict the gains."""
        decided = (rows >= 0)[:, None] & (columns >= 0)
        touched = (rows == 1)[:, None] | (columns == 1)
        rest = self.changed & decided & ~touched
        faults = int(self.cost[0][rows == 1].sum() + self.cost[1][columns == 1].sum() + rest.sum())
        # what an instrument that is out leaves to lines that are open needs one more fault in each of them at least
        more = np.any(self.changed[rows == 0], axis=0) & (columns < 0)
        others = np.any(self.changed[:, columns == 0], axis=1) & (rows < 0)
        if faults + int(np.sum(more) + np.sum(others)) > self.fewest:
            return
        fit = _fitted(self, rows == 1, columns == 1, self.known & decided & touched)
        # what more gains would add to the distance, and to its degrees of freedom, is not known yet
        touchable = self.known & ((rows != 0)[:, None] | (columns != 0))
        if fit.distance > chi2.isf(self.level, max(int(touchable.sum()), 1)):
            return
        open_ones = [(k, lines) for lines in (rows, columns) for k in np.flatnonzero(lines < 0)]
        if open_ones:
            k, lines = min(open_ones, key=lambda one: int(one[0]))  # rows and columns by turns: gains are met early
            for choice in (1, 0):
                lines[k] = choice
                self.through(rows, columns)
            lines[k] = -1
            return
        p_value = float(chi2.sf(fit.distance, fit.freedom)) if fit.freedom > 0 else 1.0
        if p_value < self.level:
            return
        if faults < self.fewest:
            self.fewest, self.best = faults, []
        places = tuple((int(i), int(j)) for i, j in np.argwhere(rest))
        self.best.append(Explanation(tuple(fit.factors(rows == 1, columns == 1)), places, p_value))


@dataclass(frozen=True, eq=False)
class _Fit:
    """Factors of rows and columns by least squares."""

    row: Array
    column: Array
    errors: Array
    """Standard errors: of the rows' that are free, then of the columns'."""
    distance: float
    """Chi-square."""
    freedom: int

    def factors(self, rows: BoolArray, columns: BoolArray) -> Iterator[CommonFactor]:
        places = [("row", k, self.row[k]) for k in np.flatnonzero(rows)]
        places += [("column", k, self.column[k]) for k in np.flatnonzero(columns)]
        for (kind, k, factor), error in zip(places, self.errors, strict=True):
            yield CommonFactor(kind, int(k), float(factor), float(error))


def _fitted(search: _Search, rows: BoolArray, columns: BoolArray, members: BoolArray) -> _Fit:
    """ratio = row factor x column factor over the members; the factors of the others are 1.

    By turns over rows and columns, each a linear problem; where all of one kind are free this ends with the first turn.
    """
    i, j = np.nonzero(members)
    index = np.ravel_multi_index((i, j), members.shape)
    values, vectors = np.linalg.eigh(search.covariance[np.ix_(index, index)])
    root = vectors.T / np.sqrt(np.maximum(values, np.finfo(float).eps * np.max(values, initial=0.0)))[:, None]
    of_row, of_column = (i[:, None] == np.flatnonzero(rows)) * 1.0, (j[:, None] == np.flatnonzero(columns)) * 1.0
    row, column, target = np.ones(rows.size), np.ones(columns.size), search.ratio[i, j]

    def solved(design: Array, fixed: Array) -> Array:
        return np.asarray(np.linalg.lstsq(root @ design, root @ (target - fixed), rcond=None)[0])

    distance = np.inf
    while True:
        row[rows] = solved(of_row * column[j, None], np.where(rows[i], 0.0, column[j]))
        column[columns] = solved(of_column * row[i, None], np.where(columns[j], 0.0, row[i]))
        before, distance = distance, float(np.sum((root @ (target - row[i] * column[j])) ** 2))
        if not distance < before - search.level**2:  # no more to gain than no test would notice
            break
    jacobian = root @ np.hstack([of_row * column[j, None], of_column * row[i, None]])
    errors = np.linalg.norm(np.linalg.pinv(jacobian), axis=1)
    return _Fit(row, column, errors, distance, int(index.size - np.linalg.matrix_rank(jacobian)))
