"""The project: what is known before the analysis, as one TOML file or built in code."""

from __future__ import annotations

import hashlib
import os
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Self

from pydantic import ValidationError, model_validator

from trueplant import loop
from trueplant.errors import ProjectError
from trueplant.lti import TransferFunction, TransferMatrix, to_formula
from trueplant.project.checks import check_project
from trueplant.project.controllers import controller_of, layout_of
from trueplant.project.declaration import Declaration
from trueplant.project.messages import message
from trueplant.project.toml import to_toml
from trueplant.record.layout import Layout


class Project(Declaration):
    """A project file, checked. The fields are its tables; see docs/project.md for every key.

    Built by `Project.load`, or in code with the same keys: ``Project(time_unit="min", output=[{...}], ...)``. Raises
    ProjectError with one message that names the key (and the line of the file).
    """

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

    # -- what other rooms ask for -----------------------------------------------------------------------

    @property
    def sha256(self) -> str:
        """Of the project file, or of the TOML text of a project built in code."""
        return self._sha256 or hashlib.sha256(self.to_toml().encode()).hexdigest()

    def model_matrix(self) -> TransferMatrix:
        """The model from the inputs, (n_y, n_u); zero where no element is declared."""
        return self._matrix(range(len(self.inputs)))

    def disturbance_matrix(self) -> TransferMatrix | None:
        """The model from the measured disturbances, (n_y, n_d); None without any."""
        n_u = len(self.inputs)
        return self._matrix(range(n_u, n_u + len(self.disturbances))) if self.disturbances else None

    def _matrix(self, columns: range) -> TransferMatrix:
        rows = []
        for i in range(len(self.outputs)):
            row = [self.element(i, j) for j in columns]
            rows.append([0.0 if element is None else element.tf for element in row])
        return TransferMatrix.of(rows, self.time_unit)

    def controller(self, experiment: int = 0) -> loop.Controller | None:
        """The controllers of one experiment as one law u = Q(r, y); None if none is declared."""
        plans = self.experiments
        laws = plans[experiment].controllers if plans else tuple(self.controllers)
        limits = plans[experiment].limits if plans else tuple(entry.limits for entry in self.inputs)
        return controller_of(self, laws, limits)

    def layout(self) -> Layout:
        """Which column is what, for the readers of `record`."""
        return layout_of(self)

    def with_model(self, elements: Mapping[tuple[int, int], TransferFunction]) -> Project:
        """This project with other transfer functions at the elements (i, j); j counts inputs, then disturbances."""
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
