"""A project made from the columns of a frame: loops, a model by the loops' names, and their controllers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from trueplant.errors import UsageError
from trueplant.loop import PID
from trueplant.lti import MeasuredStep, TransferFunction, TransferMatrix, from_control, to_formula
from trueplant.lti.bridge import is_discrete, step_responses
from trueplant.project import Project

LAW_KEYS = {
    "form": "ideal",
    "Kc": None,
    "Ti": None,
    "Td": 0.0,
    "alpha": 0.1,
    "Kp": None,
    "Ki": 0.0,
    "Kd": 0.0,
    "Tf": 0.0,
    "action": None,
    "gain_unit": "engineering",
    "setpoint_weight": 1.0,
    "derivative_on": "error",
    "sample_time": None,
}
"""Keys of a [[controller]] table that a `PID` has by the same name, with what they are where it says nothing."""


@dataclass(frozen=True)
class Loop:
    """One control loop: its columns in the frame, and what is known of it. The OP of loop TIC101 is "TIC101 OP".

    kind: flow, pressure, level, temperature or other, from which a first model starts; limits: instrument range of PV;
    op_limits: of OP, at which its samples are saturated; span, span_of_op: what 100 % of PV and OP are; controller: the
    law from this loop's PV to its OP, as a `PID` or as the keys of a [[controller]] table.
    """

    name: str
    pv: str
    op: str
    sp: str | None = None
    unit: str = ""
    op_unit: str = ""
    limits: tuple[float, float] | None = None
    op_limits: tuple[float, float] | None = None
    controller: PID | Mapping[str, Any] | None = None
    kind: str | None = None
    span: tuple[float, float] | None = None
    span_of_op: tuple[float, float] | None = None

    @property
    def pv_span(self) -> tuple[float, float] | None:
        """The declared span, or one as wide as the law's."""
        return self.span or _wide(self.controller, "pv_span")

    @property
    def op_span(self) -> tuple[float, float] | None:
        """The same of OP."""
        return self.span_of_op or _wide(self.controller, "op_span")

    @property
    def input(self) -> str:
        """Name of the input in the project."""
        return f"{self.name} OP"


def _wide(law: PID | Mapping[str, Any] | None, name: str) -> tuple[float, float] | None:
    width = getattr(law, name) if isinstance(law, PID) else None
    return None if width is None else (0.0, float(width))


Model = Mapping[tuple[str, str], Any] | TransferMatrix | Any
"""By (output, input), both named by their loops: a formula, a number, a `TransferFunction`, a `MeasuredStep` or a
python-control system; or a whole matrix, of ours or of python-control, rows and columns in the order of the loops. What
is discrete counts as the step response that it has."""


def project_of(
    files: Sequence[str],
    loops: Sequence[Loop],
    model: Model | None,
    time: str | None,
    time_unit: str,
    tables: Mapping[str, Any],
) -> Project:
    """The project for frames called `files`; `tables` are further tables and keys of a project file.

    Raises UsageError for loops that are none and for a model that names none, ProjectError for what a project file
    could not say either.
    """
    if not loops or not all(isinstance(loop, Loop) for loop in loops):
        raise UsageError('name the loops as a list: loops=[tp.Loop("TIC101", pv="...", sp="...", op="...")]')
    data = {"files": list(files), "time": time, "time_unit": time_unit} | tables.get("data", {})
    outputs = [
        _given(name=p.name, pv=p.pv, sp=p.sp, unit=p.unit, kind=p.kind, limits=p.limits, span=p.pv_span) for p in loops
    ]
    inputs = [_given(name=p.input, op=p.op, unit=p.op_unit, limits=p.op_limits, span=p.op_span) for p in loops]
    laws = [_law(loop) for loop in loops if loop.controller is not None]
    own = {"data": _given(**data), "output": outputs, "input": inputs, "model": _elements(loops, model)}
    own |= {"controller": laws} if laws else {}
    return Project(**({"time_unit": time_unit} | {k: v for k, v in tables.items() if k != "data"} | own))


def _given(**keys: Any) -> dict[str, Any]:
    return {key: value for key, value in keys.items() if value is not None and value != ""}


def _elements(loops: Sequence[Loop], model: Model | None) -> list[dict[str, Any]]:
    if model is None:
        return []  # the first one is found
    given = model if isinstance(model, Mapping) else _of_matrix(loops, model)
    inputs = {loop.name: loop.input for loop in loops}
    found = []
    for place, system in given.items():
        if not (isinstance(place, tuple) and len(place) == 2 and inputs.keys() >= set(place)):
            raise UsageError(
                f"the model names the element {place!r}, and the loops are {', '.join(inputs)}: name output and input "
                "by their loops, (output, input)"
            )
        output, source = place
        element = dict(system) if isinstance(system, Mapping) else _element(system)
        found.append({"output": output, "input": inputs[source]} | element)
    return found


def _of_matrix(loops: Sequence[Loop], model: Any) -> dict[tuple[str, str], Any]:
    matrix = _matrix(model)
    shape = len(matrix), len(matrix[0])
    if shape != (len(loops), len(loops)):
        raise UsageError(f"the model is {shape[0]} by {shape[1]}, and there are {len(loops)} loops")
    return {
        (row.name, column.name): matrix[i][j]
        for i, row in enumerate(loops)
        for j, column in enumerate(loops)
        if isinstance(matrix[i][j], MeasuredStep) or not matrix[i][j].is_zero
    }


def _matrix(model: Any) -> Sequence[Sequence[Any]]:
    """The elements of a matrix: transfer functions, or step responses where it is discrete."""
    if isinstance(model, TransferMatrix):
        return model.elements
    return step_responses(model) if is_discrete(model) else from_control(model).elements


def _element(system: Any) -> dict[str, Any]:
    """The keys that say one element."""
    if isinstance(system, str | int | float):
        return {"tf": system if isinstance(system, str) else float(system)}
    if not isinstance(system, TransferFunction | MeasuredStep):
        matrix = _matrix(system)
        if (len(matrix), len(matrix[0])) != (1, 1):
            raise UsageError(
                f"an element of the model is {len(matrix)} by {len(matrix[0])}: give the one that is meant"
            )
        system = matrix[0][0]
    if isinstance(system, TransferFunction):
        return {"tf": to_formula(system, 17)}
    if system.values[0] != 0.0:
        raise UsageError(
            "an element of the model answers in the very sample of its input: give it as a transfer function"
        )
    steps = {"step": system.values[1:].tolist(), "sample_time": system.sample_time}
    return steps | ({"ramp": True} if system.integrating else {})


def _law(loop: Loop) -> dict[str, Any]:
    place = {"input": loop.input, "output": loop.name}
    law = loop.controller
    if isinstance(law, Mapping):
        return place | dict(law)
    if not isinstance(law, PID):
        raise UsageError(
            f"the controller of {loop.name} is a PID or the keys of [[controller]], as in "
            f'{{"Kc": 1.5, "Ti": 8}}, and not {law!r}'
        )
    if law.pv_transform is not None:
        raise UsageError(f"the controller of {loop.name} has a pv_transform: give its keys, with pv_transform as text")
    keys = {key: getattr(law, key) for key, usual in LAW_KEYS.items() if getattr(law, key) != usual}
    if law.setpoint_filter is not None:
        keys["setpoint_filter"] = to_formula(law.setpoint_filter, 17)
    if loop.op_limits is not None or law.limits is not None:
        keys["anti_windup"] = law.anti_windup
    return place | {"form": law.form} | keys
