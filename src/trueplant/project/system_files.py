"""Files of whole models as JSON: state space or fractions, by their own keys or those of MATLAB's ss and tf."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from trueplant.arrays import Array
from trueplant.calendar import unit_seconds
from trueplant.errors import DataError, FormulaError
from trueplant.files import contents
from trueplant.lti import MeasuredStep, StateSpace, TransferFunction

KEYS = {
    "sample_time": ("sample_time", "Ts"),
    "input_delays": ("input_delays", "InputDelay"),
    "output_delays": ("output_delays", "OutputDelay"),
    "delays": ("delays", "IODelay"),
    "internal": ("InternalDelay",),
    "input_names": ("input_names", "InputName"),
    "output_names": ("output_names", "OutputName"),
    "time_unit": ("time_unit", "TimeUnit"),
    "num": ("num", "Numerator"),
    "den": ("den", "Denominator"),
}
"""Our own name of each, and MATLAB's."""
UNITS = {"milliseconds": "ms", "seconds": "s", "minutes": "min", "hours": "h", "days": "d"}
"""MATLAB's words for those of a project."""


@dataclass(frozen=True)
class SystemFile:
    """What one file says, its times in the unit that was asked for."""

    source: str
    elements: tuple[tuple[TransferFunction | MeasuredStep, ...], ...]
    """[n_y][n_u]; step responses where the model is discrete."""
    outputs: tuple[str, ...]
    """Names; empty where the file has none."""
    inputs: tuple[str, ...]
    time_unit: str
    """That of all times; empty where neither the file nor who read it said one."""
    sha256: str = ""

    def element(
        self, output: str, source: str, outputs: Sequence[str], inputs: Sequence[str]
    ) -> TransferFunction | MeasuredStep:
        """By name, or, in a file without names, by the place in the project's `outputs` and `inputs`.

        `inputs` may go on with measured disturbances that the file leaves out. Raises DataError.
        """
        shape = len(self.elements), len(self.elements[0])
        if self.outputs and self.inputs:
            for name, names in ((output, self.outputs), (source, self.inputs)):
                if name not in names:
                    raise DataError(
                        f'{self.source} names no "{name}": it has the outputs {", ".join(self.outputs)} and the inputs '
                        f"{', '.join(self.inputs)}; name them there as in the project"
                    )
            return self.elements[self.outputs.index(output)][self.inputs.index(source)]
        i, j = outputs.index(output), inputs.index(source)
        if shape == (1, 1):
            return self.elements[0][0]
        if shape[0] != len(outputs) or not j < shape[1] <= len(inputs):
            raise DataError(
                f"{self.source} has {shape[0]} outputs and {shape[1]} inputs, and the project {len(outputs)} and "
                f"{len(inputs)}: add output_names and input_names to the file, so that it is known which is which"
            )
        return self.elements[i][j]


def read_system(path: Path, time_unit: str | None = None) -> SystemFile:
    """A model file, its times in `time_unit`, else in its own. Raises DataError (file, key, what to do)."""
    content = contents(path, DataError)
    try:
        said = json.loads(content.decode("utf-8-sig"))
    except (UnicodeDecodeError, ValueError, RecursionError) as error:
        raise DataError(f"{path.name} is not JSON ({error}): write it with jsonencode or json.dump") from None
    if not isinstance(said, dict):
        raise DataError(f"{path.name} must hold one object with the keys A, B, C and D, or num and den")
    try:
        return replace(_system(path.name, said, time_unit), sha256=hashlib.sha256(content).hexdigest())
    except FormulaError as error:
        raise DataError(f"{path.name}: {error}") from None


def _system(source: str, said: Mapping[str, Any], time_unit: str | None) -> SystemFile:
    if _list(said, "internal"):
        raise FormulaError(
            "InternalDelay: delays inside of the states have no place in a transfer function: give num, den and delays "
            "instead"
        )
    own = _unit(said)
    scale = unit_seconds(own) / unit_seconds(time_unit) if own and time_unit else 1.0
    h = float(_numbers(_value(said, "sample_time", 0.0), "sample_time", (1,))[0])
    if h < 0:
        raise FormulaError(f"sample_time: {h:g} leaves it open: say how long it is, in the time unit of the file")
    elements = _of_states(said, h, scale) if "A" in said else _of_fractions(said, h, scale)
    outputs, inputs = _names(said, "output_names", len(elements)), _names(said, "input_names", len(elements[0]))
    return SystemFile(source, elements, outputs, inputs, time_unit or own)


def _unit(said: Mapping[str, Any]) -> str:
    """The file's time unit in the words of a project; empty where it says none."""
    unit = str(_value(said, "time_unit", ""))
    unit = UNITS.get(unit, unit)
    if unit and unit not in UNITS.values():
        raise FormulaError(f"time_unit: {unit!r} is not known: use one of {', '.join(UNITS.values())}")
    return unit


# -- state space -------------------------------------------------------------------------------------------------


def _of_states(
    said: Mapping[str, Any], h: float, scale: float
) -> tuple[tuple[TransferFunction | MeasuredStep, ...], ...]:
    missing = [key for key in "ABCD" if key not in said]
    if missing:
        raise FormulaError(f"{missing[0]} is missing: a state space needs A, B, C and D")
    if np.size(np.array(said.get("E") or [], dtype=object)):
        raise FormulaError(
            "E: descriptor systems are not read: give the model without E (in MATLAB: ss(sys, 'explicit'))"
        )
    A = _numbers(said["A"], "A", None)
    n = int(np.sqrt(A.size))
    if A.size != n * n or (n > 1 and A.shape != (n, n)):
        raise FormulaError(f"A must be square, not of shape {A.shape}")
    B, C = _numbers(said["B"], "B", None), _numbers(said["C"], "C", None)
    # a vector has lost whether it was a row or a column: the number of states tells
    n_u = B.shape[1] if B.ndim == 2 else B.size // max(n, 1)
    n_y = C.shape[0] if C.ndim == 2 else C.size // max(n, 1)
    if n == 0:
        n_y, n_u = np.atleast_2d(_numbers(said["D"], "D", None)).shape
    D = _numbers(said["D"], "D", (n_y, n_u))
    # what is discrete counts samples
    rate, late = (1.0, h * scale) if h else (scale, scale)
    B, C = _shaped(B, "B", (n, n_u)) / rate, _shaped(C, "C", (n_y, n))
    system = StateSpace(A.reshape(n, n) / rate, B, C, D, _delays(said, n_y, n_u) * late, h * scale)
    return tuple(tuple(system.step(i, j) if h else system.transfer(i, j) for j in range(n_u)) for i in range(n_y))


def _delays(said: Mapping[str, Any], n_y: int, n_u: int) -> Array:
    """(n_y, n_u) of the inputs, the outputs and the elements together."""
    late = np.zeros((n_y, n_u))
    late = late + _numbers(_value(said, "input_delays", 0.0), "input_delays", (1, n_u))
    late = late + _numbers(_value(said, "output_delays", 0.0), "output_delays", (n_y, 1))
    return late + _numbers(_value(said, "delays", 0.0), "delays", (n_y, n_u))


# -- fractions ---------------------------------------------------------------------------------------------------


def _of_fractions(
    said: Mapping[str, Any], h: float, scale: float
) -> tuple[tuple[TransferFunction | MeasuredStep, ...], ...]:
    tables = {}
    for key in ("num", "den"):
        if (given := _value(said, key, None)) is None:
            raise FormulaError(f"{key} is missing: give A, B, C and D, or num and den")
        tables[key] = _polynomials(given, key)
    num, den = tables["num"], tables["den"]
    n_y, n_u = len(num), len(num[0])
    if (len(den), len(den[0])) != (n_y, n_u):
        raise FormulaError(f"num has {n_y} by {n_u} elements, den {len(den)} by {len(den[0])}")
    late = _delays(said, n_y, n_u)
    return tuple(
        tuple(_fraction(num[i][j], den[i][j], float(late[i, j]), h, scale) for j in range(n_u)) for i in range(n_y)
    )


def _fraction(num: Array, den: Array, late: float, h: float, scale: float) -> TransferFunction | MeasuredStep:
    if not den.any():
        raise FormulaError("den: division by zero")
    if not h:
        # s of the file is s of the project times the file's unit in the project's
        stretched = [p * scale ** np.arange(p.size - 1, -1, -1.0) for p in (num, den)]
        return TransferFunction.rational(stretched[0], stretched[1], late * scale)
    if num.size != den.size:
        raise FormulaError(
            "num and den of a discrete model must have as many coefficients (descending powers of z): add the zeros "
            "that were left out"
        )
    return StateSpace.of_fraction(num, den, late * h * scale, h * scale).step(0, 0)


def _polynomials(given: Any, key: str) -> list[list[Array]]:
    """[n_y][n_u] coefficients: of one element a list of numbers, else lists [output][input]."""

    def depth(value: Any) -> int:
        return 1 + max(map(depth, value), default=0) if isinstance(value, list) else 0

    levels = depth(given)
    rows = given
    if levels == 0:
        rows = [[[given]]]
    elif levels == 1:
        rows = [[given]]
    elif levels == 2 and len(given) == 1:
        rows = [given]
    elif levels != 3:
        raise FormulaError(
            f"{key}: it is not to be seen which element is which: give one list of coefficients for each element, "
            "[output][input]"
        )
    table = [[_numbers(one, key, None).ravel() for one in (row if isinstance(row, list) else [row])] for row in rows]
    if not table or not table[0] or len({len(row) for row in table}) > 1 or any(not p.size for r in table for p in r):
        raise FormulaError(f"{key}: every output needs coefficients for every input")
    return table


# -- single values -----------------------------------------------------------------------------------------------


def _value(said: Mapping[str, Any], key: str, default: Any) -> Any:
    """By our own name or MATLAB's; what is empty there was not said."""
    return next((said[name] for name in KEYS[key] if name in said and said[name] not in ([], "", None)), default)


def _list(said: Mapping[str, Any], key: str) -> list[Any]:
    value = _value(said, key, [])
    return value if isinstance(value, list) else [value]


def _names(said: Mapping[str, Any], key: str, count: int) -> tuple[str, ...]:
    names = tuple(str(name) for name in _list(said, key))
    if not any(names):
        return ()
    if len(names) != count or not all(names) or len(set(names)) < count:
        raise FormulaError(f"{key} must be {count} different names, one each, or be left out")
    return names


def _numbers(given: Any, key: str, shape: tuple[int, ...] | None) -> Array:
    try:
        values: Array = np.array(given, dtype=float)
    except (TypeError, ValueError):
        raise FormulaError(f"{key} must be numbers, in rows of the same length") from None
    if not np.all(np.isfinite(values)):
        raise FormulaError(f"{key} holds what is no finite number: correct it")
    return values if shape is None else _shaped(values, key, shape)


def _shaped(values: Array, key: str, shape: tuple[int, ...]) -> Array:
    """One number for all, a vector of the right length, or the shape itself."""
    if values.size == 1 and key.endswith(("delays", "sample_time")):
        return np.full(shape, float(values.ravel()[0]))
    # only a vector may have lost whether it was a row or a column
    is_vector = 1 in shape and (values.ndim < 2 or 1 in values.shape)
    if values.shape == shape or (values.size == np.prod(shape) and (is_vector or values.size == 0)):
        return values.reshape(shape)
    needed, given = (" by ".join(map(str, one)) or "one number" for one in (shape, values.shape))
    raise FormulaError(f"{key} must be {needed}, not {given}")
