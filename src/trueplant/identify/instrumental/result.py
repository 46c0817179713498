"""What every continuous-time estimator returns: coefficients, covariance, and what to know about them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trueplant.arrays import Array, ComplexArray
from trueplant.errors import FormulaError
from trueplant.identify.instrumental.noise import ArmaNoise, coloured_moment
from trueplant.identify.instrumental.order import Order, slices
from trueplant.identify.instrumental.refine import Refined
from trueplant.identify.instrumental.samples import Samples
from trueplant.lti.structure import Structure, structure_of
from trueplant.lti.transfer import TransferFunction


@dataclass(frozen=True, eq=False)
class PolynomialFit:
    """Estimate of one output: y = sum_j B_j(s)/A_j(s) e^(-theta_j s) u_j + v."""

    method: str
    orders: tuple[Order, ...]
    theta: Array
    """(n,) coefficients of all elements, in the order of `names`."""
    covariance: Array
    """(n, n)."""
    variance: float
    """Of the output error, after the noise model where there is one."""
    cost: float
    """Sum of squares of these errors."""
    count: int
    """Output errors used."""
    noise: ArmaNoise
    converged: bool
    rounds: int
    notes: tuple[str, ...]
    """What to know before believing it, each a sentence."""
    bias: str = ""
    """That of the notes which says that the estimate is biased, if it is known to be."""

    @property
    def slices(self) -> tuple[slice, ...]:
        return slices(self.orders)

    @property
    def std(self) -> Array:
        """(n,) standard errors."""
        return np.sqrt(np.maximum(np.diag(self.covariance), 0.0))

    @property
    def names(self) -> tuple[str, ...]:
        """Of each entry of theta; the elements are numbered by their column where there are several."""
        if len(self.orders) == 1:
            return self.orders[0].names
        return tuple(f"{name} (input {order.column + 1})" for order in self.orders for name in order.names)

    def transfer(self, element: int = 0) -> TransferFunction:
        return self.orders[element].transfer(self.theta[self.slices[element]])

    def response(self, s: ComplexArray, element: int = 0) -> tuple[ComplexArray, Array]:
        """Response (n_s,) of one element at complex s and its standard error sqrt(E|dG|^2) (n_s,), to first order."""
        s = np.atleast_1d(np.asarray(s, dtype=complex))
        part = self.slices[element]
        gradient = self.response_gradient(s, element)
        covariance = self.covariance[part, part]
        std = np.sqrt(np.maximum(np.real(np.einsum("sp,pq,sq->s", gradient, covariance, gradient.conj())), 0.0))
        return self.transfer(element)(s), std

    def response_gradient(self, s: ComplexArray, element: int = 0) -> ComplexArray:
        """(n_s, n_p) derivative of the response of one element by its parameters."""
        order, p = self.orders[element], self.theta[self.slices[element]]
        den, delay = np.polyval(order.den(p), s), np.exp(-order.delay(p) * s)
        g = np.polyval(order.num(p), s) / den * delay
        columns = [-g / den * s ** (order.poles - k) for k in range(1, order.lags + 1)]
        columns += [delay / den * s ** (order.zeros - k) for k in range(order.zeros + 1)]
        if not order.keeps_dead_time:
            columns.append(-s * g)
        return np.stack(columns, axis=1)

    def as_structure(self, structure: Structure, element: int = 0) -> tuple[Array, Array]:
        """Gain, time constants, leads and dead time of one element, with their covariance to first order.

        A dead time that was not estimated has no variance. Raises FormulaError where the poles or zeros found are not
        of that kind (a pair where two lags are wanted).
        """
        order, part = self.orders[element], self.slices[element]
        p = self.theta[part]
        found, value = structure_of(order.transfer(p))
        if found != structure:
            raise FormulaError(
                f"what was found has the structure {found}, not {structure}: its poles are of another kind"
            )
        # the coefficients as functions of the named parameters, inverted: exact derivatives
        kept = len(structure.names) - int(order.keeps_dead_time and structure.has_dead_time)
        w = np.geomspace(0.05, 20, 4 * len(p)) * _typical(order.den(p), order.num(p))
        s = 1j * w
        left = structure.gradient(value, s)[:, :kept]
        right = self.response_gradient(s, element)
        stacked_left = np.vstack([left.real, left.imag])
        stacked_right = np.vstack([right.real, right.imag])
        level = 1 / np.tile(np.abs(np.polyval(order.num(p), s) / np.polyval(order.den(p), s)), 2)
        scale = np.linalg.norm(level[:, None] * stacked_left, axis=0)
        jacobian = np.linalg.lstsq(level[:, None] * stacked_left / scale, level[:, None] * stacked_right, rcond=1e-13)[
            0
        ]
        jacobian /= scale[:, None]
        covariance = np.zeros((value.size, value.size))
        covariance[:kept, :kept] = jacobian @ self.covariance[part, part] @ jacobian.T
        return value, covariance

    def __str__(self) -> str:
        lines = [f"{self.method}, {self.count} samples, noise {self.noise}"]
        lines += [f"  {n} = {v:.5g} ± {e:.2g}" for n, v, e in zip(self.names, self.theta, self.std, strict=True)]
        return "\n".join([*lines, *(f"  {note}" for note in self.notes)])


def _typical(den: Array, num: Array) -> float:
    """Geometric mean of the poles and zeros that are not at 0, in rad per time unit."""
    roots = np.abs(np.concatenate([np.roots(den), np.roots(num)]))
    roots = roots[roots > 1e-9 * max(roots.max(), 1e-300)] if roots.size else roots
    return float(np.exp(np.mean(np.log(roots)))) if roots.size else 1.0


def finished(
    method: str,
    orders: Sequence[Order],
    samples: Sequence[Samples],
    refined: Refined,
    noise: ArmaNoise | None = None,
    notes: Sequence[str] = (),
    bias: str = "",
) -> PolynomialFit:
    """The result of an iteration, with the covariance M^-1 (Z' R Z) M^-T, M = sum zeta psi'.

    Where the errors are white and the instrument is built on the recorded inputs this is s2 (sum zeta zeta')^-1.
    """
    point, said = refined.point, [*notes, *filter(None, [bias])]
    moment, order = coloured_moment(point.instruments, point.errors, point.usable)
    covariance = instrument_covariance(point.cross, moment, point.power)
    if order:
        said.append(f"the errors are coloured (autoregressive of order {order}): the standard errors count that")
    if not refined.converged:
        said.append(f"the iteration did not settle in {refined.rounds} rounds: a lower order, or another start, may")
    if not all(s.at_rest for s in samples):
        said.append("records start in motion: their free responses were estimated along")
    return PolynomialFit(
        method,
        tuple(orders),
        refined.theta,
        covariance,
        point.variance,
        point.cost,
        point.count,
        noise or ArmaNoise(),
        refined.converged,
        refined.rounds,
        tuple(said),
        bias,
    )


def instrument_covariance(cross: Array, moment: Array, power: Array) -> Array:
    """cross^-1 moment cross^-T, rows and columns levelled by the power (n, n) of the instruments."""
    scale = np.sqrt(np.maximum(np.diag(power), 1e-300))
    level = np.outer(scale, scale)
    inverse = np.linalg.pinv(cross / level, rcond=1e-12)
    spread: Array = (inverse @ (moment / level) @ inverse.T) / level
    return 0.5 * (spread + spread.T)
