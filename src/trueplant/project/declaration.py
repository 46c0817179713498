"""What a project declares: its tables, the names in them, and what each experiment changes."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any, Self

from pydantic import Field, PrivateAttr, ValidationError, model_validator

from trueplant import datasets
from trueplant.calendar import moment_in
from trueplant.errors import DataError
from trueplant.project.fields import Limits, Table, TimeUnit, problem
from trueplant.project.law_table import Controller
from trueplant.project.messages import message
from trueplant.project.model_table import ModelElement
from trueplant.project.simulated import Simulate
from trueplant.project.tables import (
    Analysis,
    Data,
    Disturbance,
    Exclude,
    Experiment,
    Input,
    Moment,
    Output,
    Robustness,
    Tuning,
    Unmeasured,
)


@dataclass(frozen=True)
class ExperimentPlan:
    """One experiment with everything that the project says about it put together."""

    name: str
    """The file as the project names it, and which part of it where that is said."""
    file: str
    start: Moment | None
    end: Moment | None
    closed: bool
    exclude: tuple[Exclude, ...]
    limits: tuple[Limits | None, ...]
    """Of OP, one for each input."""
    controllers: tuple[Controller, ...]
    folder: Path

    def beyond(self, input_: str | None = None) -> str:
        """What its controllers (of one input) have beyond linear PIDs of set-point and PV, in words; empty: nothing."""
        laws = [law for law in self.controllers if input_ in (None, law.input)]
        return ", ".join(dict.fromkeys(words for law in laws for words in law.beyond.values()))

    @property
    def path(self) -> Path:
        """Where the file is; an example record is fetched if it is not at hand (SourceError where it cannot be)."""
        if self.file.startswith("dataset:"):
            return datasets.path(self.file.removeprefix("dataset:"))
        return self.folder / self.file


def _part(entry: Experiment) -> str:
    both = (("from", entry.start), ("to", entry.end))
    said = [f"{word} {f'{at:.15g}' if isinstance(at, float) else at}" for word, at in both if at is not None]
    return f" ({' '.join(said)})" if said else ""


class Declaration(Table):
    """The tables of a project file, and what can be said of them alone."""

    time_unit: TimeUnit
    data: Data = Data()
    declared_experiments: list[Experiment] = Field(default_factory=list, alias="experiment")
    outputs: list[Output] = Field(min_length=1, alias="output")
    inputs: list[Input] = Field(min_length=1, alias="input")
    disturbances: list[Disturbance] = Field(default_factory=list, alias="disturbance")
    unmeasured: list[Unmeasured] = Field(default_factory=list)
    model: list[ModelElement] = Field(default_factory=list)
    controllers: list[Controller] = Field(default_factory=list, alias="controller")
    candidates: list[Controller] = Field(default_factory=list, alias="candidate")
    """Settings that somebody wants judged beside those that are proposed."""
    analysis: Analysis = Analysis()
    robustness: Robustness | None = None
    tuning: Tuning | None = None
    simulate: Simulate | None = None

    _folder: Path = PrivateAttr(default=Path())
    _source: str = PrivateAttr(default="project")

    @model_validator(mode="after")
    def _slaves_are_named(self) -> Self:
        """An OP that is the set-point of another loop of the project has that loop for a slave."""
        for j, entry in enumerate(self.inputs):
            pv = next((loop.pv for loop in self.outputs if loop.sp == entry.op), None)
            if pv is not None and entry.slave_sp is None:
                self.inputs[j] = entry.model_copy(update={"slave_sp": entry.op, "slave_pv": pv})
        return self

    @property
    def source(self) -> str:
        """The file that the project was read from."""
        return self._source

    @property
    def folder(self) -> Path:
        """Relative paths start here."""
        return self._folder

    @property
    def output_names(self) -> tuple[str, ...]:
        return tuple(entry.name for entry in self.outputs)

    @property
    def input_names(self) -> tuple[str, ...]:
        return tuple(entry.name for entry in self.inputs)

    @property
    def disturbance_names(self) -> tuple[str, ...]:
        return tuple(entry.name for entry in self.disturbances)

    @property
    def snapshot(self) -> str:
        """The file that a historian's events are kept in, as the project names it."""
        named = None if self.data.source is None else self.data.source.snapshot
        return named or f"{Path(self._source).stem}-snapshot.parquet"

    @property
    def window(self) -> tuple[datetime, datetime]:
        """The stretch of time that is read from a historian, in UTC.

        Raises DataError where its ends bear no offset and no zone is known, or where the clock skips one of them.
        """
        assert self.data.start is not None
        assert self.data.end is not None
        start, end = (moment_in(at, self.data.time_zone) for at in (self.data.start, self.data.end))
        if not start < end:
            raise DataError(
                "the clock goes back between from and to, so that to is not after from: give both an offset"
            )
        return start, end

    @property
    def experiments(self) -> tuple[ExperimentPlan, ...]:
        """One plan a file, in order."""
        files = self.data.files if self.data.source is None else [self.snapshot]
        entries = self.declared_experiments or [Experiment(file=name) for name in files]
        return tuple(
            ExperimentPlan(
                name=entry.file + _part(entry),
                file=entry.file,
                start=entry.start,
                end=entry.end,
                closed=entry.loop == "closed",
                exclude=tuple(e for e in self.data.exclude if e.file in (None, entry.file)),
                limits=tuple(entry.limits.get(i.name, i.limits) for i in self.inputs),
                controllers=self.overridden(entry.controllers, ()) if entry.controllers else tuple(self.controllers),
                folder=self._folder,
            )
            for entry in entries
        )

    def element(self, i: int, j: int) -> ModelElement | None:
        """The declared element from input j to output i; j counts the inputs, then the measured disturbances."""
        pair = (self.output_names[i], (*self.input_names, *self.disturbance_names)[j])
        return next((e for e in self.model if (e.output, e.input) == pair), None)

    def kind(self, i: int) -> str | None:
        """What output i measures, where the project says."""
        return self.outputs[i].kind

    def wanted(self, i: int, j: int) -> bool:
        """Did nobody say whether element i, j is there? So it is for all without any model."""
        element = self.element(i, j)
        return not self.model if element is None else element.wanted

    def structure(self, i: int, j: int) -> str | None:
        """The declared structure of element i, j; None where it is the model's own, or to be found."""
        element = self.element(i, j)
        return None if element is None or element.structure == "auto" else element.structure

    def overridden(self, changes: list[dict[str, Any]], where: tuple[str | int, ...]) -> tuple[Controller, ...]:
        """The controllers with the changes of one experiment put in."""
        laws = [law.model_dump(by_alias=True, exclude_unset=True) for law in self.controllers]
        for k, change in enumerate(changes):
            keys = [key for key in ("input", "output") if key in change]
            matching = [law for law in laws if keys and all(law[key] == change[key] for key in keys)]
            if len(matching) != 1:
                found = "no [[controller]]" if not matching else "more than one [[controller]]"
                text = f"fits {found}: say input (and output) of the one that differs"
                raise problem(text, *where, k)
            matching[0].update(change)
        try:
            merged = tuple(Controller.model_validate(law) for law in laws)
        except ValidationError as error:
            # the declared controllers are sound, so the mistake is in what this experiment changes
            raise problem(message(error, Controller, "the controller with this change"), *where) from None
        return merged
