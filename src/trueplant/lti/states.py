"""State space: its elements as transfer functions, or, where it is discrete, as step responses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trueplant.arrays import Array, ComplexArray
from trueplant.errors import FormulaError
from trueplant.lti import levels
from trueplant.lti.measured import MeasuredStep
from trueplant.lti.reduce import simplified
from trueplant.lti.transfer import TransferFunction


@dataclass(frozen=True, eq=False)
class StateSpace:
    """dx/dt = A x + B u, y = C x + D u, or x[k+1] = A x[k] + B u[k]; the input of each element comes late.

    Raises FormulaError for matrices that do not go together.
    """

    A: Array
    """(n, n)"""
    B: Array
    """(n, n_u)"""
    C: Array
    """(n_y, n)"""
    D: Array
    """(n_y, n_u)"""
    dead_times: Array
    """(n_y, n_u) in time units; of a discrete system whole samples."""
    sample_time: float = 0.0
    """0: continuous."""

    def __post_init__(self) -> None:
        n, (n_y, n_u) = len(self.A), np.shape(self.D)
        for name, given, needed in (
            ("A", self.A, (n, n)),
            ("B", self.B, (n, n_u)),
            ("C", self.C, (n_y, n)),
            ("the dead times", self.dead_times, (n_y, n_u)),
        ):
            if np.shape(given) != needed:
                raise FormulaError(
                    f"{name} must be {needed[0]} by {needed[1]}, not {' by '.join(map(str, given.shape))}"
                )
        for name, given in (("A", self.A), ("B", self.B), ("C", self.C), ("D", self.D)):
            if not np.all(np.isfinite(given)):
                raise FormulaError(f"{name} holds what is no finite number: correct it")
        if not (np.all(np.isfinite(self.dead_times)) and np.all(self.dead_times >= 0)):
            raise FormulaError("dead times must be numbers of 0 or more")
        late = self.dead_times / self.sample_time if self.sample_time > 0 else np.zeros(1)
        if np.any(np.abs(late - np.rint(late)) > levels.WHOLE_SAMPLE * np.maximum(late, 1.0)):
            raise FormulaError(
                "dead times of a discrete system must be whole samples: round them, or give it continuous"
            )
        if not (np.isfinite(self.sample_time) and self.sample_time >= 0):
            raise FormulaError(f"the sample time must be 0 (continuous) or more, not {self.sample_time:g}")

    @classmethod
    def of_fraction(cls, num: Array, den: Array, dead_time: float, sample_time: float) -> StateSpace:
        """One discrete element num(z)/den(z), coefficients in descending powers. Raises FormulaError if improper."""
        from scipy.signal import tf2ss

        num, den = (np.trim_zeros(np.asarray(p, dtype=float), "f") for p in (num, den))
        if not den.size:
            raise FormulaError("division by zero: the denominator is 0")
        if num.size > den.size:
            raise FormulaError("a discrete fraction is improper: it would answer before it is asked")
        A, B, C, D = tf2ss(num if num.size else np.zeros(1), den)
        return cls(A, B, C, D, np.array([[dead_time]]), sample_time)

    @property
    def shape(self) -> tuple[int, int]:
        return int(self.D.shape[0]), int(self.D.shape[1])

    @property
    def poles(self) -> ComplexArray:
        return np.asarray(np.linalg.eigvals(self.A), dtype=complex)

    def transfer(self, i: int, j: int) -> TransferFunction:
        """Element i, j of a continuous system, common roots cancelled where they agree to rounding.

        C (sI - A)^-1 B + D = (det(sI - A + k b c) - det(sI - A))/(k det(sI - A)) + d for any k: one that makes k b c as
        large as A, so that the difference keeps its digits.
        """
        product = np.outer(self.B[:, j], self.C[i, :])
        dead_time = float(self.dead_times[i, j])
        direct = TransferFunction.rational([self.D[i, j]], 1.0, dead_time)
        if not product.any():
            return direct
        k = (np.linalg.norm(self.A) or 1.0) / np.linalg.norm(product)
        den, moved = np.poly(self.A).real, np.poly(self.A - k * product).real
        num = np.where(np.abs(moved - den) <= 1e-13 * (np.abs(moved) + np.abs(den)), 0.0, moved - den) / k
        return simplified(direct + TransferFunction.rational(num, den, dead_time))

    def step(self, i: int, j: int) -> MeasuredStep:
        """Element i, j of a discrete system, exact, until it has settled (or runs on with one slope).

        Raises FormulaError where it is unstable, or takes too many samples.
        """
        size = np.abs(self.poles)
        if np.any(size > 1 + levels.AT_ONE):
            raise FormulaError(
                f"a pole at |z| = {size.max():.6g} is unstable: only stable or integrating models are taken"
            )
        slowest = max((r for r in size if 0 < r < 1 - levels.AT_ONE), default=0.1)
        late = round(float(self.dead_times[i, j]) / self.sample_time)
        count = max(int(np.ceil(np.log(levels.REST) / np.log(slowest))), 1) + len(self.A) + levels.LEAST_COEFFICIENTS
        if count + late > levels.MOST_COEFFICIENTS:
            raise FormulaError(
                f"it takes {count + late:,} samples to settle, and {levels.MOST_COEFFICIENTS:,} are the most: give it "
                "with a longer sample time, or continuous"
            )
        values, x = np.zeros(count + late), np.zeros(len(self.A))
        for k in range(late, count + late):
            values[k] = self.C[i] @ x + self.D[i, j]
            x = self.A @ x + self.B[:, j]
        step = MeasuredStep(values, self.sample_time)
        return step if step.settled else MeasuredStep(values, self.sample_time, integrating=True)
