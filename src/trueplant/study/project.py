"""The project: what is known before the analysis, as one TOML file or built in code."""

from __future__ import annotations

import hashlib
import os
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

from pydantic import Field, PrivateAttr, ValidationError, model_validator

from trueplant.errors import ProjectError
from trueplant.study.project_checks import check_controllers, check_project
from trueplant.study.project_errors import message
from trueplant.study.project_parts import (
    Analysis,
    Controller,
    Data,
    Disturbance,
    Exclude,
    Experiment,
    Input,
    Limits,
    ModelElement,
    Output,
    Robustness,
    Simulate,
    Table,
    TimeUnit,
    Tuning,
    Unmeasured,
    problem,
)

if TYPE_CHECKING:
    from trueplant import loop
    from trueplant.lti import TransferFunction, TransferMatrix
    from trueplant.record.layout import Layout


@dataclass(frozen=True)
class ExperimentPlan:
    """One experiment with everything that the project says about it put together."""

    name: str
    """The file as the project names it."""
    closed: bool
    exclude: tuple[Exclude, ...]
    limits: tuple[Limits | None, ...]
    """Of OP, one for each input."""
    controllers: tuple[Controller, ...]
    folder: Path

    @property
    def path(self) -> Path:
        """Where the file is; an example record is fetched if it is not at hand (SourceError where it cannot be)."""
        if self.name.startswith("dataset:"):
            from trueplant import datasets

            return datasets.path(self.name.removeprefix("dataset:"))
        return self.folder / self.name


class Project(Table):
    """A project file, checked. The fields are its tables; see docs/project.md for every key.

    Built by `Project.load`, or in code with the same keys: ``Project(time_unit="min", output=[{...}], ...)``. Raises
    ProjectError with one message that names the key (and the line of the file).
    """

    time_unit: TimeUnit
    data: Data = Data()
    declared_experiments: list[Experiment] = Field(default_factory=list, alias="experiment")
    outputs: list[Output] = Field(min_length=1, alias="output")
    inputs: list[Input] = Field(min_length=1, alias="input")
    disturbances: list[Disturbance] = Field(default_factory=list, alias="disturbance")
    unmeasured: list[Unmeasured] = Field(default_factory=list)
    model: list[ModelElement] = Field(default_factory=list)
    controllers: list[Controller] = Field(default_factory=list, alias="controller")
    analysis: Analysis = Analysis()
    robustness: Robustness | None = None
    tuning: Tuning | None = None
    simulate: Simulate | None = None

    _folder: Path = PrivateAttr(default=Path())
    _source: str = PrivateAttr(default="project")
    _sha256: str = PrivateAttr(default="")

    def __init__(self, /, **tables: Any) -> None:
        try:
            super().__init__(**tables)
        except ValidationError as error:
            raise ProjectError(message(error, type(self), "project")) from error

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Self:
        """Read a project file. Raises ProjectError (file, line, key, what to do)."""
        file = Path(path)
        try:
            content = file.read_bytes()
        except FileNotFoundError:
            raise ProjectError(f"{file} does not exist: correct the path, or make one with trueplant init") from None
        except OSError as error:
            raise ProjectError(f"{file} cannot be read ({error.strerror}): name a project file in TOML") from None
        try:
            text = content.decode("utf-8-sig")
        except UnicodeDecodeError as error:
            line = content[: error.start].count(b"\n") + 1
            what = f"{file}, line {line}: is not UTF-8 text: save the project file as UTF-8"
            raise ProjectError(_if_record(file) or what) from None
        return cls._read(text, file, hashlib.sha256(content).hexdigest())

    @classmethod
    def from_toml(cls, text: str, folder: str | os.PathLike[str] = ".") -> Self:
        """Read a project from TOML text; relative paths in it start from ``folder``."""
        return cls._read(text, Path(folder) / "project.toml", hashlib.sha256(text.encode()).hexdigest())

    @classmethod
    def _read(cls, text: str, file: Path, digest: str) -> Self:
        try:
            tables = tomllib.loads(text)
        except tomllib.TOMLDecodeError as error:
            raise ProjectError(_if_record(file) or f"{file}: is not valid TOML: {error}") from None
        try:
            project = cls(**tables)
        except ProjectError as error:
            if not isinstance(error.__cause__, ValidationError):
                raise
            raise ProjectError(message(error.__cause__, cls, str(file), text)) from None
        project._folder, project._source, project._sha256 = file.parent, str(file), digest
        return project

    # -- what the tables say together -------------------------------------------------------------------

    @model_validator(mode="after")
    def _holds_together(self) -> Self:
        check_project(self)
        return self

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
        check_controllers(self, merged, where)
        return merged

    # -- what other rooms ask for -----------------------------------------------------------------------

    @property
    def source(self) -> str:
        """The file that the project was read from."""
        return self._source

    @property
    def folder(self) -> Path:
        """Relative paths start here."""
        return self._folder

    @property
    def sha256(self) -> str:
        """Of the project file, or of the TOML text of a project built in code."""
        return self._sha256 or hashlib.sha256(self.to_toml().encode()).hexdigest()

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
    def experiments(self) -> tuple[ExperimentPlan, ...]:
        """One plan a file, in order."""
        entries = self.declared_experiments or [Experiment(file=name) for name in self.data.files]
        return tuple(
            ExperimentPlan(
                name=entry.file,
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

    def estimate(self, i: int, j: int) -> bool:
        """Whether element i, j is to be estimated: not if it is kept, and not if it is zero without a structure."""
        from trueplant.lti import tf

        element = self.element(i, j)
        if element is None or not element.estimate:
            return False
        return element.structure is not None or not tf(element.tf).is_zero

    def structure(self, i: int, j: int) -> str | None:
        """The declared structure of element i, j; None where it is the model's own."""
        element = self.element(i, j)
        return None if element is None else element.structure

    def model_matrix(self) -> TransferMatrix:
        """The model from the inputs, (n_y, n_u); zero where no element is declared."""
        return self._matrix(range(len(self.inputs)))

    def disturbance_matrix(self) -> TransferMatrix | None:
        """The model from the measured disturbances, (n_y, n_d); None without any."""
        n_u = len(self.inputs)
        return self._matrix(range(n_u, n_u + len(self.disturbances))) if self.disturbances else None

    def _matrix(self, columns: range) -> TransferMatrix:
        from trueplant.lti import TransferMatrix

        rows = []
        for i in range(len(self.outputs)):
            row = [self.element(i, j) for j in columns]
            rows.append([0.0 if element is None else element.tf for element in row])
        return TransferMatrix.of(rows, self.time_unit)

    def controller(self, experiment: int = 0) -> loop.Controller | None:
        """The controllers of one experiment as one law u = Q(r, y); None if none is declared."""
        from trueplant.study.project_loop import controller_of

        plans = self.experiments
        laws = plans[experiment].controllers if plans else tuple(self.controllers)
        limits = plans[experiment].limits if plans else tuple(entry.limits for entry in self.inputs)
        return controller_of(self, laws, limits)

    def layout(self) -> Layout:
        """Which column is what, for the readers of `record`."""
        from trueplant.study.project_loop import layout_of

        return layout_of(self)

    def with_model(self, elements: Mapping[tuple[int, int], TransferFunction]) -> Project:
        """This project with other transfer functions at the elements (i, j); j counts inputs, then disturbances."""
        from trueplant.lti import to_formula

        sources = (*self.input_names, *self.disturbance_names)
        model = {(e.output, e.input): e.model_dump(by_alias=True, exclude_unset=True) for e in self.model}
        for (i, j), system in elements.items():
            pair = (self.output_names[i], sources[j])
            model.setdefault(pair, {"output": pair[0], "input": pair[1]})["tf"] = to_formula(system)
        tables = self.model_dump(by_alias=True, exclude_unset=True) | {"model": list(model.values())}
        project = Project(**tables)
        project._folder = self._folder
        return project

    def to_toml(self, folder: str | os.PathLike[str] | None = None) -> str:
        """The project as TOML text; with ``folder``, relative paths are written so that they hold from there."""
        from trueplant.study.project_toml import to_toml

        tables = self.model_dump(by_alias=True, exclude_unset=True)
        if folder is not None:
            for entry, key in [(tables.get("data", {}), "files"), *((e, "file") for e in tables.get("experiment", []))]:
                if key in entry:
                    names = entry[key]
                    moved = [self._moved(n, folder) for n in ([names] if isinstance(names, str) else names)]
                    entry[key] = moved[0] if isinstance(names, str) else moved
            for exclude in tables.get("data", {}).get("exclude", []):
                if exclude.get("file"):
                    exclude["file"] = self._moved(exclude["file"], folder)
            plant = tables.get("simulate", {}).get("plant", "model")
            if isinstance(plant, str) and plant != "model":
                tables["simulate"]["plant"] = self._moved(plant, folder)
        return to_toml(tables)

    def _moved(self, name: str, folder: str | os.PathLike[str]) -> str:
        if name.startswith("dataset:") or os.path.isabs(name):
            return name
        return Path(os.path.relpath(self._folder / name, folder)).as_posix()


def _if_record(file: Path) -> str:
    """What to say of a file without TOML whose name does not claim it either."""
    if file.suffix.lower() == ".toml":
        return ""
    return f"{file} is not a project file: if it is a record, write a project file for it with: trueplant init {file}"
