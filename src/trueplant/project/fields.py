"""The kinds of keys that the tables of a project file have, and what a table is."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field
from pydantic_core import PydanticCustomError

from trueplant.errors import FormulaError
from trueplant.lti import TransferFunction, parse_pv, require_proper, tf
from trueplant.lti.structure import Structure
from trueplant.project import levels

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
Name = Annotated[str, Field(min_length=1)]
TimeUnit = Literal["ms", "s", "min", "h", "d"]


def problem(message: str, *where: str | int) -> PydanticCustomError:
    """An error found by a validator; ``where`` is the path of keys below the object validated."""
    safe = message.replace("{", "(").replace("}", ")")
    return PydanticCustomError("project", safe, {"where": tuple(where)})


def _ordered(pair: tuple[float, float]) -> tuple[float, float]:
    if not pair[0] < pair[1]:
        raise problem(f"must be [low, high] with low below high, not [{pair[0]:g}, {pair[1]:g}]")
    return pair


def _as_tuple(value: Any) -> Any:
    return tuple(value) if isinstance(value, list) else value


Limits = Annotated[tuple[Finite, Finite], BeforeValidator(_as_tuple), AfterValidator(_ordered)]


def _transfer_function(text: str | float) -> str | float:
    try:
        system = tf(text)
        require_proper(system, "the transfer function")
        require_reason(system)
    except FormulaError as error:
        raise problem(str(error)) from error
    return text


def require_reason(system: TransferFunction) -> None:
    """Raise FormulaError for numbers that no plant has, and that arithmetic does not survive."""
    times = [1 / abs(pole) for pole in system.poles if pole != 0] + [t.dead_time for t in system.terms if t.dead_time]
    gains = [max(map(abs, term.num)) / max(map(abs, term.den)) for term in system.terms]
    for name, values, (least, most) in (
        ("time constant or dead time", times, levels.TIMES),
        ("gain", gains, levels.GAINS),
    ):
        for value in values:
            if not least <= value <= most:
                raise FormulaError(
                    f"a {name} of about {value:.3g} is beyond {least:g} to {most:g}: correct it, or choose other units"
                )


def _pv_formula(text: str) -> str:
    try:
        parse_pv(text)
    except FormulaError as error:
        raise problem(str(error)) from error
    return text


def _structure(text: str) -> str:
    try:
        Structure.parse(text)
    except FormulaError as error:
        raise problem(str(error)) from error
    return text


Formula = Annotated[str | float, AfterValidator(_transfer_function)]
PvFormula = Annotated[str, AfterValidator(_pv_formula)]
StructureName = Annotated[str, AfterValidator(_structure)]


class Table(BaseModel):
    """A table of the project file: unknown keys and text for numbers are mistakes."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, populate_by_name=True)
