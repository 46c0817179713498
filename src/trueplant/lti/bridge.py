"""To and from the systems of python-control, the field's common tongue."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from trueplant.arrays import Array
from trueplant.errors import FormulaError
from trueplant.lti.measured import MeasuredStep
from trueplant.lti.reduce import simplified
from trueplant.lti.states import StateSpace
from trueplant.lti.transfer import Term, TransferFunction, TransferMatrix

if TYPE_CHECKING:
    import control


def from_control(system: Any, dead_times: ArrayLike | None = None) -> TransferMatrix:
    """Matrix from a continuous ``control.TransferFunction`` or ``control.StateSpace``, SISO or MIMO.

    ``dead_times`` (n_y, n_u), in the time unit of the system, delays the elements; python-control
    itself knows none. A state-space system gives elements of up to its own order, common roots
    cancelled where they agree to rounding. Raises FormulaError for other systems and discrete ones.
    """
    import control

    if not isinstance(system, (control.TransferFunction, control.StateSpace)):
        raise FormulaError(
            f"a {type(system).__name__} cannot be converted; give a control.TransferFunction or control.StateSpace"
        )
    if system.dt not in (0, None):
        raise FormulaError(
            f"the system is discrete (dt = {system.dt}); give a continuous one, such as the model it was sampled from"
        )
    shape = (system.noutputs, system.ninputs)
    if 0 in shape:
        raise FormulaError("the system has no inputs or no outputs; give one that has both")
    delays = np.zeros(shape) if dead_times is None else np.asarray(dead_times, dtype=float)
    if delays.shape != shape:
        raise FormulaError(f"dead_times has shape {delays.shape}; the system needs {shape}, outputs by inputs")
    if isinstance(system, control.TransferFunction):
        elements = [
            [TransferFunction.rational(system.num[i][j], system.den[i][j], delays[i, j]) for j in range(shape[1])]
            for i in range(shape[0])
        ]
    else:
        states = _states(system, delays)
        elements = [[states.transfer(i, j) for j in range(shape[1])] for i in range(shape[0])]
    return TransferMatrix(tuple(map(tuple, elements)))


def is_discrete(system: Any) -> bool:
    """Whether a system of python-control has a sample time."""
    return getattr(system, "dt", None) not in (0, None)


def step_responses(system: Any) -> tuple[tuple[MeasuredStep, ...], ...]:
    """[n_y][n_u] of a discrete ``control.TransferFunction`` or ``control.StateSpace``, exact.

    Raises FormulaError for one that is unstable, or whose sample time is left open (dt = True).
    """
    import control

    if not isinstance(system, (control.TransferFunction, control.StateSpace)):
        raise FormulaError(
            f"a discrete {type(system).__name__} cannot be converted; give a TransferFunction or StateSpace"
        )
    if system.dt is True:
        raise FormulaError("the sample time of the system is left open (dt = True): say how long it is")
    h, places = float(system.dt), [[(i, j) for j in range(system.ninputs)] for i in range(system.noutputs)]
    if isinstance(system, control.TransferFunction):
        return tuple(
            tuple(StateSpace.of_fraction(system.num[i][j], system.den[i][j], 0.0, h).step(0, 0) for i, j in row)
            for row in places
        )
    known = _states(system, np.zeros((system.noutputs, system.ninputs)), h)
    return tuple(tuple(known.step(i, j) for i, j in row) for row in places)


def _states(system: Any, dead_times: Array, sample_time: float = 0.0) -> StateSpace:
    A, B, C, D = (np.asarray(matrix, dtype=float) for matrix in (system.A, system.B, system.C, system.D))
    return StateSpace(A, B, C, D, dead_times, sample_time)


def to_control(g: TransferMatrix | TransferFunction, pade_order: int | None = None) -> control.TransferFunction:
    """The same system for python-control; dead time becomes a Pade approximation of ``pade_order``.

    Without dead time the conversion is exact. Raises FormulaError where there is dead time and no order.
    """
    import control

    matrix = g if isinstance(g, TransferMatrix) else TransferMatrix(((g,),))
    delayed = any(term.dead_time for row in matrix.elements for element in row for term in element.terms)
    if delayed and pade_order is None:
        raise FormulaError("python-control has no dead time; give pade_order to approximate it, for example 5")
    if pade_order is not None and (not isinstance(pade_order, (int, np.integer)) or pade_order < 1):
        raise FormulaError(f"pade_order must be a whole number of 1 or more, not {pade_order!r}")
    fractions = [[_one_fraction(element, pade_order or 1) for element in row] for row in matrix.elements]
    return control.TransferFunction(
        [[np.array(term.num) for term in row] for row in fractions],
        [[np.array(term.den) for term in row] for row in fractions],
    )


def _one_fraction(g: TransferFunction, pade_order: int) -> Term:
    total = TransferFunction()
    for term in g.terms:
        num, den = _pade(term.dead_time, pade_order)
        total = total + TransferFunction.rational(np.convolve(term.num, num), np.convolve(term.den, den))
    terms = simplified(total).terms
    return terms[0] if terms else Term((0.0,))


def _pade(dead_time: float, order: int) -> tuple[Array, Array]:
    import control

    if dead_time == 0:
        return np.ones(1), np.ones(1)
    num, den = control.pade(dead_time, order)
    return np.asarray(num, dtype=float), np.asarray(den, dtype=float)
