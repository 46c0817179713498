"""The structure of a perturbation: what stands on the diagonal of Delta.

Delta maps the outputs z of M (its rows) back to the inputs w of M (its columns): ``w = Delta z``.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import final

import numpy as np

from trueplant.arrays import Array, ComplexArray
from trueplant.errors import UsageError


@dataclass(frozen=True)
class Full:
    """Any complex matrix of shape (rows, columns), 1 by 1 unless told; square if columns is left out."""

    rows: int = 1
    columns: int = 0

    def __post_init__(self) -> None:
        object.__setattr__(self, "columns", self.columns or self.rows)
        if self.rows < 1 or self.columns < 1:
            raise UsageError(f"a block needs at least one row and one column, not {self.rows} by {self.columns}")

    @property
    def is_full(self) -> bool:
        return True

    @property
    def is_real(self) -> bool:
        return False


@dataclass(frozen=True)
class _TimesIdentity(ABC):
    """One number times the identity of the given size."""

    size: int

    def __post_init__(self) -> None:
        if self.size < 1:
            raise UsageError(f"a block needs a size of at least 1, not {self.size}")

    @property
    def rows(self) -> int:
        return self.size

    @property
    def columns(self) -> int:
        return self.size

    @property
    @abstractmethod
    def is_full(self) -> bool: ...

    @property
    @abstractmethod
    def is_real(self) -> bool: ...


@final
@dataclass(frozen=True)
class Repeated(_TimesIdentity):
    """One complex number times the identity of the given size."""

    @property
    def is_full(self) -> bool:
        return self.size == 1

    @property
    def is_real(self) -> bool:
        return False


@final
@dataclass(frozen=True)
class Real(_TimesIdentity):
    """One real number times the identity of the given size: a parameter."""

    size: int = 1

    @property
    def is_full(self) -> bool:
        return False

    @property
    def is_real(self) -> bool:
        return True


Block = Full | Repeated | Real


def diagonal(n: int) -> tuple[Full, ...]:
    """n independent complex numbers, one a channel."""
    return (Full(1),) * n


@dataclass(frozen=True)
class Structure:
    """The blocks in order, and where each stands."""

    blocks: tuple[Block, ...]

    @classmethod
    def of(cls, blocks: Sequence[Block], shape: tuple[int, int]) -> Structure:
        """Checked against the shape (rows z, columns w) of M. Raises UsageError."""
        structure = cls(tuple(blocks))
        if not structure.blocks:
            raise UsageError("the perturbation needs at least one block")
        if structure.shape != shape:
            z, w = structure.shape
            raise UsageError(f"the blocks fit a matrix with {z} rows and {w} columns, not {shape[0]} and {shape[1]}")
        return structure

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, columns) of the M that the blocks fit."""
        return sum(b.columns for b in self.blocks), sum(b.rows for b in self.blocks)

    @property
    def all_full(self) -> bool:
        return all(block.is_full for block in self.blocks)

    @property
    def any_real(self) -> bool:
        return any(block.is_real for block in self.blocks)

    def complex_cover(self) -> Structure:
        """The same with complex numbers in place of real ones: mu of it is never smaller."""
        return Structure(tuple(Repeated(block.rows) if block.is_real else block for block in self.blocks))

    def places(self) -> Iterator[tuple[Block, slice, slice]]:
        """Each block with its rows and its columns in M."""
        z = w = 0
        for block in self.blocks:
            yield block, slice(z, z + block.columns), slice(w, w + block.rows)
            z, w = z + block.columns, w + block.rows

    def members(self) -> tuple[Array, Array]:
        """(n_z, F) and (n_w, F): 1 where a row or column of M belongs to a block."""
        rows, columns = np.zeros((self.shape[0], len(self.blocks))), np.zeros((self.shape[1], len(self.blocks)))
        for k, (_, z, w) in enumerate(self.places()):
            rows[z, k] = columns[w, k] = 1.0
        return rows, columns

    def directions(self) -> tuple[ComplexArray, ComplexArray]:
        """Hermitian matrices that span the logarithms of the scalings which commute with Delta.

        (J, n_z, n_z) and (J, n_w, n_w): one identity for a full block, m^2 matrices for one repeated m times.
        """
        left: list[ComplexArray] = []
        right: list[ComplexArray] = []
        for block, z, w in self.places():
            parts = [np.eye(block.columns)] if block.is_full else _hermitian_basis(block.columns)
            for part in parts:
                left.append(np.zeros((self.shape[0],) * 2, dtype=complex))
                right.append(np.zeros((self.shape[1],) * 2, dtype=complex))
                left[-1][z, z] = part
                right[-1][w, w] = np.eye(block.rows) if block.is_full else part
        return np.array(left), np.array(right)

    def real_directions(self) -> ComplexArray:
        """(K, n_w, n_z): Hermitian matrices on the real blocks, m^2 for one of size m, and zero elsewhere."""
        parts: list[ComplexArray] = []
        for block, z, w in self.places():
            for part in _hermitian_basis(block.rows) if block.is_real else []:
                parts.append(np.zeros(self.shape[::-1], dtype=complex))
                parts[-1][w, z] = part
        return np.array(parts).reshape(-1, *self.shape[::-1])


def _hermitian_basis(m: int) -> list[ComplexArray]:
    basis = []
    for i in range(m):
        for j in range(m):
            part = np.zeros((m, m), dtype=complex)
            if i <= j:
                part[i, j] = part[j, i] = 1.0
            else:
                part[i, j], part[j, i] = 1j, -1j
            basis.append(part)
    return basis
