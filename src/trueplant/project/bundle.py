"""A project and its records under neutral names, for someone who is to help and need not know the plant."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from typing import Any

from trueplant.calendar import Calendar, unit_seconds
from trueplant.errors import ProjectError
from trueplant.lti import to_formula
from trueplant.project.document import to_toml
from trueplant.project.model_table import FORMS, OF_STEP, ModelElement
from trueplant.project.models import DeclaredModel
from trueplant.project.project import Project
from trueplant.record.anonymous import TIME, PlainRecord, plain_record

EPOCH = datetime(2000, 1, 1)
"""The first time stamp of a bundle."""
PROJECT = "project.toml"
_HEAD = "# An anonymised project: names, units, comments and dates are not those of the plant.\n"
_OF_FILES = (
    *("separator", "encoding", "sheet", "tag", "value", "quality", "time_zone", "time_format", "time", "files"),
    *("source", "from", "to", "sample_time", "max_gap"),
)
"""Keys of [data] that say how the original files are to be read."""


@dataclass(frozen=True)
class Names:
    """New names by the original ones."""

    outputs: Mapping[str, str]
    inputs: Mapping[str, str]
    disturbances: Mapping[str, str]
    columns: Mapping[str, str]
    """Of numbers."""
    units: Mapping[str, str]
    files: Mapping[str, str]

    @property
    def sources(self) -> Mapping[str, str]:
        return {**self.disturbances, **self.inputs}

    def rows(self) -> Iterable[tuple[str, str, str]]:
        """What it is, its name in the bundle, the original one."""
        for kind, names in (
            ("file", self.files),
            ("output", self.outputs),
            ("input", self.inputs),
            ("disturbance", self.disturbances),
            ("column", self.columns),
            ("unit", self.units),
        ):
            yield from ((kind, new, old) for old, new in names.items())


@dataclass(frozen=True)
class Bundle:
    """The files of a bundle by name, and what must not go with them."""

    files: Mapping[str, str]
    names: Names
    first: datetime | None
    """The moment that the first time stamp stands for; None where all records have numbers for their time."""


@dataclass
class _Clock:
    """The records as they were read, by file, and the shift of their time stamps."""

    records: dict[str, PlainRecord] = field(default_factory=dict)
    unit: str = "min"
    """Of the records' times, and ..."""
    data_unit: str = "min"
    """... of numbers in files and in excluded stretches."""

    @property
    def first(self) -> datetime | None:
        moments = [self.moment(one, float(one.t[0])) for one in self.records.values() if one.start is not None]
        return min(moments, default=None)

    def moment(self, one: PlainRecord, t: float) -> datetime:
        assert one.start is not None
        return one.start + timedelta(microseconds=round(t * unit_seconds(self.unit) * 1e6))

    def shifted(self, moment: Any, file: str | None) -> Any:
        """A moment of the project by the clock of the bundle; numbers stay."""
        first = self.first
        stamped = [one for name, one in self.records.items() if one.start is not None and file in (None, name)]
        if not isinstance(moment, datetime) or first is None or not stamped:
            return moment
        calendar = Calendar(self.unit, stamped[0].start, stamped[0].zone)
        return EPOCH + (self.moment(stamped[0], calendar.time(moment)) - first)

    def cells(self, one: PlainRecord) -> list[str]:
        """The column of the time."""
        first = self.first
        if one.start is None or first is None:
            scale = unit_seconds(self.unit) / unit_seconds(self.data_unit)
            return [repr(t) for t in (one.t * scale if scale != 1 else one.t).tolist()]
        return [(EPOCH + (self.moment(one, t) - first)).isoformat() for t in one.t.tolist()]


def bundle(project: Project) -> Bundle:
    """The project and its records with neutral names, units and dates; what they hold is the same.

    Raises ProjectError where records with time stamps in a known zone stand beside others, DataError as reading does.
    """
    names = _names(project)
    clock = _Clock(unit=project.time_unit, data_unit=project.data.time_unit or project.time_unit)
    for plan in project.experiments:
        if plan.file not in clock.records:
            clock.records[plan.file] = plain_record(plan.path, project.layout(), names.columns)
    stamped = {one.start.tzinfo is not None for one in clock.records.values() if one.start is not None}
    if len(stamped) > 1:
        raise ProjectError(
            f"{project.source}: some records have time stamps with a known zone and others without: set data.time_zone"
        )
    files = {PROJECT: _HEAD + to_toml(_tables(project, names, clock))}
    for name, one in clock.records.items():
        files[names.files[name]] = one.frame(clock.cells(one)).write_csv()
    return Bundle(files, names, _in_utc(clock.first))


def _in_utc(moment: datetime | None) -> datetime | None:
    return moment if moment is None or moment.tzinfo is None else moment.astimezone(UTC)


def _names(project: Project) -> Names:
    columns: dict[str, str] = {}
    for i, output in enumerate(project.outputs, start=1):
        columns.setdefault(output.pv, f"PV{i}")
        if output.sp is not None:
            columns.setdefault(output.sp, f"SP{i}")
    for j, entry in enumerate(project.inputs, start=1):
        columns.setdefault(entry.op, f"OP{j}")
        for old, new in ((entry.slave_sp, f"SLAVE_SP{j}"), (entry.slave_pv, f"SLAVE_PV{j}")):
            if old is not None:
                columns.setdefault(old, new)
    for k, disturbance in enumerate(project.disturbances, start=1):
        columns.setdefault(disturbance.column, f"DV{k}")
    of_outputs, of_inputs = [e.unit for e in project.outputs], [e.unit for e in project.inputs]
    of_disturbances = [e.unit for e in project.disturbances]
    units = dict.fromkeys(unit for unit in (*of_outputs, *of_inputs, *of_disturbances) if unit)
    files = dict.fromkeys(plan.file for plan in project.experiments)
    return Names(
        outputs={name: f"y{i}" for i, name in enumerate(project.output_names, start=1)},
        inputs={name: f"u{j}" for j, name in enumerate(project.input_names, start=1)},
        disturbances={name: f"d{k}" for k, name in enumerate(project.disturbance_names, start=1)},
        columns=columns,
        units={unit: f"unit{k}" for k, unit in enumerate(units, start=1)},
        files={file: f"record{k}.csv" for k, file in enumerate(files, start=1)},
    )


def _tables(project: Project, names: Names, clock: _Clock) -> dict[str, Any]:
    """The project's tables under the new names; what is only for simulating is left out."""
    said = project.model_dump(by_alias=True, exclude_unset=True)
    as_they_are = ("time_unit", "analysis", "robustness", "tuning")
    tables: dict[str, Any] = {key: said[key] for key in as_they_are if key in said}
    data = {key: value for key, value in said.get("data", {}).items() if key not in _OF_FILES}
    data |= {"time": TIME, "time_unit": clock.data_unit}
    if not project.declared_experiments:
        data["files"] = [names.files[plan.file] for plan in project.experiments]
    if project.data.exclude:
        data["exclude"] = [_stretch(entry, names, clock) for entry in said["data"]["exclude"]]
    tables["data"] = data
    tables["experiment"] = [_experiment(entry, names, clock) for entry in said.get("experiment", ())]
    tables["output"] = [
        _channel(e, names.outputs, names, f"STATUS_PV{i}") for i, e in enumerate(said["output"], start=1)
    ]
    tables["input"] = [
        _channel(e, names.inputs, names, f"STATUS_OP{j}", f"MODE{j}") for j, e in enumerate(said["input"], start=1)
    ]
    tables["disturbance"] = [_channel(e, names.disturbances, names) for e in said.get("disturbance", ())]
    tables["unmeasured"] = [e | {"output": names.outputs[e["output"]]} for e in said.get("unmeasured", ())]
    tables["model"] = [_element(e, project.models.get((e.output, e.input)), names) for e in project.model]
    tables["controller"] = [_law(entry, names) for entry in said.get("controller", ())]
    return {key: value for key, value in tables.items() if value != []}


def _channel(
    entry: dict[str, Any], own: Mapping[str, str], names: Names, status: str = "", mode: str = ""
) -> dict[str, Any]:
    made = {key: value for key, value in entry.items() if key != "automatic_values"}
    made["name"] = own[entry["name"]]
    for key in ("pv", "sp", "op", "column", "slave_sp", "slave_pv"):
        if made.get(key) is not None:
            made[key] = names.columns[made[key]]
    for key, new in (("status", status), ("mode", mode), ("unit", names.units.get(entry.get("unit", ""), ""))):
        if made.get(key) is not None:
            made[key] = new
    return made


def _stretch(entry: dict[str, Any], names: Names, clock: _Clock) -> dict[str, Any]:
    file = entry.get("file")
    made = {key: clock.shifted(value, file) for key, value in entry.items() if value is not None}
    return made if file is None else made | {"file": names.files.get(file, "none.csv")}


def _experiment(entry: dict[str, Any], names: Names, clock: _Clock) -> dict[str, Any]:
    made = _stretch(entry, names, clock)
    if "limits" in made:
        made["limits"] = {names.inputs[name]: limits for name, limits in made["limits"].items()}
    if "controllers" in made:
        made["controllers"] = [_law(law, names) for law in made["controllers"]]
    return made


def _law(entry: dict[str, Any], names: Names) -> dict[str, Any]:
    made = dict(entry)
    for key, known in (("input", names.inputs), ("output", names.outputs)):
        if key in made:
            made[key] = known[made[key]]
    if made.get("feedforward"):
        made["feedforward"] = [
            one | {"column": names.columns.get(one["column"], f"FF{k}")}
            for k, one in enumerate(made["feedforward"], start=1)
        ]
    return made


def _element(entry: ModelElement, model: DeclaredModel | None, names: Names) -> dict[str, Any]:
    """An element whose numbers stand in the project, whatever file they were in."""
    made = entry.model_dump(by_alias=True, exclude_unset=True)
    made |= {"output": names.outputs[entry.output], "input": names.sources[entry.input]}
    if model is None or entry.tf is not None:
        return made
    made = {key: value for key, value in made.items() if key not in (*FORMS, *OF_STEP, "gain_unit")}
    if model.measured is None or model.measured.values[0] != 0:
        return made | {"tf": to_formula(model.system, 17)}
    steps, measured = model.measured.values[1:].tolist(), model.measured
    return made | {"step": steps, "sample_time": measured.sample_time, "ramp": measured.integrating}
