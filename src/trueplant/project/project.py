"""The project: what is known before the analysis, as one TOML file or built in code."""

from __future__ import annotations

import hashlib
import os
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Self

from pydantic import PrivateAttr, ValidationError, model_validator

from trueplant import loop
from trueplant.errors import OutputError, ProjectError
from trueplant.files import contents
from trueplant.lti import TransferFunction, TransferMatrix, to_formula
from trueplant.printable import SHOWN
from trueplant.project.checks import check_project
from trueplant.project.controllers import controller_of, layout_of
from trueplant.project.declaration import Declaration
from trueplant.project.document import same_toml, to_toml, with_exclusions, with_formulas, with_moved_paths
from trueplant.project.messages import message
from trueplant.project.model_table import ModelElement
from trueplant.project.models import DeclaredModel, declared_models
from trueplant.project.not_toml import not_toml
from trueplant.record.layout import Layout


class Project(Declaration):
    """A project file, checked. The fields are its tables; see docs/project.md for every key.

    Built by `Project.load`, or in code with the same keys: ``Project(time_unit="min", output=[{...}], ...)``. Raises
    ProjectError with one message that names the key (and the line of the file).
    """

    _text: str = PrivateAttr(default="")
    """What the project was read from; empty where it was built in code."""
    _sha256: str = PrivateAttr(default="")
    _models: Mapping[tuple[str, str], DeclaredModel] | None = PrivateAttr(default=None)
    """Read when they are first asked for; those of a project file with it."""

    def __init__(self, /, **tables: Any) -> None:
        try:
            super().__init__(**tables)
        except ValidationError as error:
            raise ProjectError(message(error, type(self), "project")) from error

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Self:
        """Read a project file. Raises ProjectError (file, line, key, what to do)."""
        file = Path(path)
        content = contents(file, ProjectError, "correct the path, or make one with trueplant init")
        try:
            text = content.decode("utf-8-sig")
        except UnicodeDecodeError as error:
            line = content[: error.start].count(b"\n") + 1
            what = f"{file}, line {line}: is not UTF-8 text: save the project file as UTF-8"
            raise ProjectError(_if_record(file) or what) from None
        return cls._read(text, file, _sha256(content))

    @classmethod
    def from_toml(cls, text: str, folder: str | os.PathLike[str] = ".") -> Self:
        """Read a project from TOML text; relative paths in it start from ``folder``."""
        return cls._read(text, Path(folder) / "project.toml")

    @classmethod
    def _read(cls, text: str, file: Path, digest: str = "") -> Self:
        try:
            tables = tomllib.loads(text)
        except tomllib.TOMLDecodeError as error:
            raise ProjectError(_if_record(file) or not_toml(error, str(file), text)) from None
        try:
            project = cls(**tables)
        except ProjectError as error:
            if not isinstance(error.__cause__, ValidationError):
                raise
            raise ProjectError(message(error.__cause__, cls, str(file), text)) from None
        project._folder, project._source = file.parent, str(file)
        project._text, project._sha256 = text, digest or _sha256(text.encode())
        project._models = project.read_models(("model",), project.model)
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
        return self._sha256 or _sha256(self.to_toml().encode())

    @property
    def files(self) -> tuple[Path, ...]:
        """Its own, where it was read from one, and the records and models that it names."""
        own = [Path(self._source)] if self._text else []
        plant = self.simulate.plant if self.simulate is not None else []
        elements = [*self.model, *(plant if isinstance(plant, list) else [])]
        models = dict.fromkeys(entry.file for entry in elements if entry.file is not None)
        records = dict.fromkeys(plan.file for plan in self.experiments if not plan.file.startswith("dataset:"))
        return (*own, *(self._folder / name for name in (*records, *models)))

    @property
    def models(self) -> Mapping[tuple[str, str], DeclaredModel]:
        """The declared elements by (output, input), read from their files. Raises ProjectError."""
        if self._models is None:
            self._models = self.read_models(("model",), self.model)
        return self._models

    def estimate(self, i: int, j: int) -> bool:
        """Whether element i, j is to be estimated: not if it is kept, and not if it is zero without a structure."""
        element = self.element(i, j)
        if element is None or element.wanted:
            return self.wanted(i, j)
        if not element.estimate:
            return False
        return element.structure is not None or not self.models[element.output, element.input].system.is_zero

    def read_models(
        self, where: tuple[str, ...], elements: Sequence[ModelElement]
    ) -> Mapping[tuple[str, str], DeclaredModel]:
        """Elements of a model that stand in the tables ``where``. Raises ProjectError."""
        return declared_models(self, where, elements, self._text)

    def model_matrix(self) -> TransferMatrix:
        """The model from the inputs, (n_y, n_u); zero where no element is declared."""
        return self._matrix(range(len(self.inputs)))

    def disturbance_matrix(self) -> TransferMatrix | None:
        """The model from the measured disturbances, (n_y, n_d); None without any."""
        n_u = len(self.inputs)
        return self._matrix(range(n_u, n_u + len(self.disturbances))) if self.disturbances else None

    def _matrix(self, columns: range) -> TransferMatrix:
        sources = (*self.input_names, *self.disturbance_names)
        models = {place: one.system for place, one in self.models.items()}
        rows = [[models.get((output, sources[j]), 0.0) for j in columns] for output in self.output_names]
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

    def with_model(self, elements: Mapping[tuple[int, int], TransferFunction]) -> Self:
        """This project with other transfer functions at the elements (i, j); j counts inputs, then disturbances.

        The text of a project that was read from a file stays, but for the formulas that differ.
        """
        sources = (*self.input_names, *self.disturbance_names)
        formulas = {}
        for (i, j), system in elements.items():
            place, formula = (self.output_names[i], sources[j]), to_formula(system)
            declared = self.models.get(place)
            if declared is None or declared.source or to_formula(declared.system) != formula:
                formulas[place] = formula
        return self._read(with_formulas(self.to_toml(), formulas), Path(self._source))

    def with_exclusions(self, entries: Sequence[Mapping[str, Any]]) -> Self:
        """This project with more entries in data.exclude; nothing else of its text changes.

        Raises ProjectError where the form of its text does not allow that.
        """
        before = self.to_toml()
        wanted = tomllib.loads(before)
        data = wanted.setdefault("data", {})
        data["exclude"] = [*data.get("exclude", []), *map(dict, entries)]
        text = with_exclusions(before, entries)
        if not same_toml(text, wanted):
            lines = to_toml({"data": {"exclude": [dict(entry) for entry in entries]}}).strip().split("\n")
            said = f"{self._source}: data.exclude cannot be written into this file; do it by hand:"
            raise ProjectError(SHOWN.join([said, *lines]))
        return self._read(text, Path(self._source))

    def to_toml(self, folder: str | os.PathLike[str] | None = None) -> str:
        """The project as TOML text; with ``folder``, relative paths are written so that they hold from there.

        A project that was read from TOML keeps its comments, order and formatting. Raises OutputError where a path
        from there is not Unicode, as TOML must be.
        """
        text = self._text or to_toml(self.model_dump(by_alias=True, exclude_unset=True))
        named = self.data.source is None or self.data.source.snapshot is not None
        if folder is None or (named and os.path.relpath(self._folder, folder) == os.curdir):
            return text
        return with_moved_paths(text, lambda name: self._moved(name, folder), self.snapshot)

    def model_copy(self, *, update: Mapping[str, Any] | None = None, deep: bool = False) -> Self:
        """A copy, with ``update`` put in unchecked; it is then no longer the project of the file."""
        copy = super().model_copy(update=update, deep=deep)
        if update:
            copy._text = copy._sha256 = ""
            copy._models = None
        return copy

    def _moved(self, name: str, folder: str | os.PathLike[str]) -> str:
        if name.startswith("dataset:") or os.path.isabs(name):
            return name
        place = Path(os.path.relpath(self._folder / name, folder)).as_posix()
        if any("\ud800" <= character <= "\udfff" for character in place):
            raise OutputError(
                f"plant.toml in {folder} would have to name {place}, and what is not Unicode cannot stand in a project "
                "file: rename the folder, or keep the results in the project's own (--out)"
            )
        return place


def plant_project(
    project: Project, elements: Mapping[tuple[int, int], TransferFunction], folder: str | os.PathLike[str] | None = None
) -> str:
    """The text of plant.toml in ``folder``: the project with the updated plant as its model.

    ``elements`` are the updated transfer functions at (i, j), j counting inputs, then disturbances. Without ``folder``
    relative paths start where those of the project do.
    """
    return project.with_model(elements).to_toml(folder)


def _sha256(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def _if_record(file: Path) -> str:
    """What to say of a file without TOML whose name does not claim it either."""
    if file.suffix.lower() == ".toml":
        return ""
    return f"{file} is not a project file: if it is a record, write a project file for it with: trueplant init {file}"
