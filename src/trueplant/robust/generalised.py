"""The generalised plant N of an uncertain loop, for named structures of the uncertainty.

N takes the perturbation's outputs and a disturbance at the plant's output to the perturbation's inputs and the
weighted control error. With u = -Q y, S = (I + G Q)^-1 and T = G Q S:

    input     G (I + wI Delta)    N = [[-wI Q S G, -wI Q S], [wP S G, wP S]]
    output    (I + wO Delta) G    N = [[-wO T, -wO T], [wP S, wP S]]
    additive  G + wA Delta        N = [[-wA Q S, -wA Q S], [wP S, wP S]]
    elements  G_ij + w_ij delta_ij: as additive, with a row and a column of N for each element

"input" and "output" take an independent Delta in each channel, "input full" and "output full" any matrix. The weights
of "elements" are ordered row by row.
(Skogestad and Postlethwaite 2005, chapter 8.)
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike

from trueplant.arrays import Array, ComplexArray
from trueplant.errors import UsageError
from trueplant.loop import Controller, loop_functions
from trueplant.lti import TransferFunction, TransferMatrix, tf
from trueplant.robust import levels
from trueplant.robust.blocks import Block, Full, diagonal

STRUCTURES = ("input", "input full", "output", "output full", "additive", "elements")

Response = Callable[[ComplexArray], ComplexArray | Array]
Weight = TransferFunction | Response | str | float
Weights = Weight | Sequence[Weight]
"""One for all channels, or one a channel: formulas, numbers, or any function of s of which only the size matters."""


def channels(weight: Weights, count: int, name: str) -> tuple[Response, ...]:
    """The weight of each channel. Raises UsageError for a wrong number of them, or an unstable one."""
    given = [weight] if isinstance(weight, (str, float, int)) or callable(weight) else list(weight)
    functions = tuple(w if callable(w) else tf(w) for w in given)
    if len(functions) == 1:
        functions *= count
    if len(functions) != count:
        raise UsageError(
            f"{name} has {len(functions)} weights for {count} channels: give one for all, or one a channel"
        )
    if any(isinstance(function, TransferFunction) and np.any(function.poles.real > 0) for function in functions):
        raise UsageError(f"{name} has a weight with an unstable pole: only its size matters, mirror the pole")
    return functions


def weighted_channels(plant: TransferMatrix, structure: str) -> int:
    """How many channels the uncertainty weight has."""
    if structure not in STRUCTURES:
        raise UsageError(f"the structure must be one of {', '.join(STRUCTURES)}, not {structure!r}")
    n_y, n_u = plant.shape
    if structure == "elements":
        return n_y * n_u
    return n_y if structure.startswith("output") else n_u


def uncertainty_blocks(shape: tuple[int, int], structure: str) -> tuple[Block, ...]:
    """Delta of the named structure for a plant of shape (n_y, n_u)."""
    n_y, n_u = shape
    blocks: dict[str, tuple[Block, ...]] = {
        "input": diagonal(n_u),
        "input full": (Full(n_u),),
        "output": diagonal(n_y),
        "output full": (Full(n_y),),
        "additive": (Full(n_y, n_u),),
        "elements": diagonal(n_y * n_u),
    }
    return blocks[structure]


def generalised_plant(
    plant: TransferMatrix,
    controller: Controller,
    uncertainty: Weights,
    performance: Weights,
    s: ArrayLike,
    structure: str = "input",
) -> ComplexArray:
    """N (n_s, n_z + n_y, n_w + n_y) at the points s (n_s,); its blocks are uncertainty_blocks and Full(n_y)."""
    z = np.atleast_1d(np.asarray(s, dtype=np.complex128))
    own = channels(uncertainty, weighted_channels(plant, structure), "the uncertainty")
    asked = channels(performance, plant.shape[0], "the performance")
    w_error = np.stack([w(z) for w in own], axis=1)[:, :, None]
    w_performance = np.stack([w(z) for w in asked], axis=1)[:, :, None]
    G = plant(z)
    loop = loop_functions(G, controller(z))
    if structure.startswith("input"):
        to_error, disturbed = [loop.QS @ G, loop.QS], [loop.SG, loop.S]
    elif structure.startswith("output"):
        to_error, disturbed = [loop.T, loop.T], [loop.S, loop.S]
    elif structure == "additive":
        to_error, disturbed = [loop.QS, loop.QS], [loop.S, loop.S]
    else:
        output, input_ = (index.ravel() for index in np.indices(plant.shape))
        to_error = [loop.QS[:, input_][:, :, output], loop.QS[:, input_]]
        disturbed = [loop.S[:, :, output], loop.S]
    upper = -w_error * np.concatenate(to_error, axis=2)
    lower = w_performance * np.concatenate(disturbed, axis=2)
    return np.asarray(np.concatenate([upper, lower], axis=1), dtype=np.complex128)


def perturbed_plant(
    plant: TransferMatrix, uncertainty: Weights, delta: ArrayLike, frequency: float, structure: str = "input"
) -> TransferMatrix:
    """The plant under a stable, real-rational Delta(s) with the value delta at the frequency, its size the same at all.

    delta: the uncertainty's part of a worst case, (n_u, n_u), (n_y, n_y), for "additive" (n_y, n_u) and for "elements"
    (n_y n_u, n_y n_u); each of its blocks of rank 1, as mu returns them. The angle of each factor comes from an
    all-pass of first order.
    """
    count = weighted_channels(plant, structure)
    weights = [w for w in channels(uncertainty, count, "the uncertainty") if isinstance(w, TransferFunction)]
    if len(weights) < count:
        raise UsageError("a perturbed plant needs weights that are transfer functions: see covering_weight")
    value = np.asarray(delta, dtype=np.complex128)
    n_y, n_u = plant.shape
    expected = (n_y, n_u) if structure == "additive" else (count, count)
    if value.shape != expected:
        raise UsageError(f"this perturbation must have the shape {expected}, not {value.shape}")
    if not (np.all(np.isfinite(value)) and np.isfinite(frequency) and frequency > 0):
        raise UsageError("a perturbed plant needs a finite Delta and the frequency above 0 at which it was found")
    if structure in ("input", "output", "elements"):
        change = [[_turned(value[i, j], frequency) for j in range(count)] for i in range(count)]
    else:
        u, sigma, vh = np.linalg.svd(value)
        rows = [_turned(x * sigma[0], frequency) for x in u[:, 0]]
        columns = [_turned(x, frequency) for x in vh[0]]
        change = [[row * column for column in columns] for row in rows]
    # the weight stands at the input of Delta for an additive error and at either side of it otherwise
    change = [[cell * weights[j] for j, cell in enumerate(row)] for row in change]
    if structure == "elements":
        moved = [[plant[i, j] + change[i * n_u + j][i * n_u + j] for j in range(n_u)] for i in range(n_y)]
    elif structure == "additive":
        moved = [[plant[i, j] + change[i][j] for j in range(n_u)] for i in range(n_y)]
    elif structure.startswith("input"):
        moved = [
            [plant[i, j] + _sum(plant[i, k] * change[k][j] for k in range(n_u)) for j in range(n_u)] for i in range(n_y)
        ]
    else:
        moved = [
            [plant[i, j] + _sum(change[i][k] * plant[k, j] for k in range(n_y)) for j in range(n_u)] for i in range(n_y)
        ]
    return TransferMatrix(tuple(map(tuple, moved)), plant.time_unit)


def _sum(parts: object) -> TransferFunction:
    return sum(parts, TransferFunction())  # type: ignore[call-overload,no-any-return]


def _turned(value: complex, frequency: float) -> TransferFunction:
    """A real all-pass times a gain that has this value at the frequency."""
    size, angle = abs(value), float(np.angle(value))
    if size == 0:
        return TransferFunction()
    sign = 1.0
    if angle > 0:
        sign, angle = -1.0, angle - np.pi
    if abs(angle) < levels.REAL_ANGLE or abs(angle + np.pi) < levels.REAL_ANGLE:
        return TransferFunction.rational([size * sign * (1 if abs(angle) < levels.REAL_ANGLE else -1)])
    lag = np.tan(-angle / 2) / frequency
    return TransferFunction.rational([-size * sign * lag, size * sign], [lag, 1.0])
