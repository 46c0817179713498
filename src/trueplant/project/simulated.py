"""The table [simulate] of the project file: what a simulated record is made of."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from trueplant.project.fields import Finite, Formula, Name, NotNegative, Positive, Table, problem
from trueplant.project.levels import MOST_SAMPLES
from trueplant.project.model_table import ModelElement


class Move(Table):
    """A set-point that goes to a new value and stays there."""

    time: NotNegative
    output: Name
    value: Finite


_KIND_KEYS = {
    "step": {"size", "time"},
    "ramp": {"size", "time", "until"},
    "random walk": {"std", "correlation", "seed"},
    "noise": {"std", "time_constant", "c", "a", "correlation", "seed"},
}
_NEEDED = {"step": ("size",), "ramp": ("size", "until"), "random walk": ("std",), "noise": ("std",)}


class SimulatedLoad(Table):
    """What acts on the loop from outside, at inputs, at outputs, or as measured disturbances.

    `at` names the places, all of one kind; sizes are numbers for all of them, or one each. With `tf` a single source
    reaches each place through a model of its own.
    """

    at: Name | Annotated[list[Name], Field(min_length=1)]
    kind: Literal["step", "ramp", "random walk", "noise"]
    size: Finite | list[Finite] | None = None
    time: NotNegative = 0.0
    until: Positive | None = None
    std: NotNegative | list[NotNegative] | None = None
    time_constant: Positive | None = None
    c: list[Finite] = Field(default_factory=list)
    a: list[Finite] = Field(default_factory=list)
    correlation: Annotated[float, Field(ge=-1, le=1)] = 0.0
    tf: Formula | list[Formula] | None = None
    seed: Annotated[int, Field(ge=0)] | None = None

    @property
    def places(self) -> tuple[str, ...]:
        return (self.at,) if isinstance(self.at, str) else tuple(self.at)

    @model_validator(mode="after")
    def _keys_fit_the_kind(self) -> SimulatedLoad:
        for key in sorted(self.model_fields_set - {"at", "kind", "tf"} - _KIND_KEYS[self.kind]):
            listed = ", ".join(sorted(_KIND_KEYS[self.kind]))
            raise problem(f'is no key of kind = "{self.kind}", which has {listed}', key)
        for key in _NEEDED[self.kind]:
            if getattr(self, key) is None:
                raise problem(f'is needed with kind = "{self.kind}"', key)
        if self.until is not None and self.until <= self.time:
            raise problem("must come after time", "until")
        if self.time_constant is not None and (self.c or self.a):
            raise problem("says the colour, and so do c and a: keep one of them", "time_constant")
        channels = 1 if self.tf is not None else len(self.places)
        for key in ("size", "std"):
            given = getattr(self, key)
            if isinstance(given, list) and len(given) != channels:
                raise problem(f"must be a number, or {channels}: one for each source of the load", key)
        if isinstance(self.tf, list) and len(self.tf) != len(self.places):
            raise problem(f"must be one formula for each of the {len(self.places)} places of at", "tf")
        return self


class Simulate(Table):
    """What `trueplant simulate` runs: the plant, the moves, what acts on it from outside, and what the instruments add.

    Times are in the project's time unit. `start` gives the values that outputs and inputs rest at before the first
    move (0 where it names none); noise and quantisation are in the unit of each output, one number for all or a table.
    """

    plant: Name | list[ModelElement] = "model"
    duration: Positive
    sample_time: Positive
    setpoints: list[Move] = Field(default_factory=list)
    loads: list[SimulatedLoad] = Field(default_factory=list)
    start: dict[str, Finite] = Field(default_factory=dict)
    noise: NotNegative | dict[str, NotNegative] = 0.0
    quantisation: NotNegative | dict[str, NotNegative] = 0.0
    seed: Annotated[int, Field(ge=0)] = 0

    @model_validator(mode="after")
    def _has_steps(self) -> Simulate:
        if self.duration < 2 * self.sample_time:
            raise problem("must be at least two sample times", "duration")
        if self.duration / self.sample_time > MOST_SAMPLES:
            raise problem(
                f"gives more than {MOST_SAMPLES // 1_000_000} million samples: shorten it or raise sample_time",
                "duration",
            )
        return self
