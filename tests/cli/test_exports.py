"""From an export to a first model: `init`, `check` and `run` without an edit, on exports of ten shapes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from support.exports import EXPORTS, FOUND, KINDS, UNITS, Export, Signals, signals
from trueplant import Project
from trueplant.cli.data import init
from trueplant.project.controllers import layout_of
from trueplant.record import read_record
from trueplant.result import Status
from trueplant.study.check import check
from trueplant.study.pipeline import analyse


@pytest.fixture(scope="module")
def record() -> Signals:
    return signals()


def begun(export: Export, record: Signals, folder: Path) -> Project:
    """The project that `init` writes for the export."""
    export.write(folder / export.file, record)
    place = folder / "project.toml"
    assert init(folder / export.file, place, False, {}) == 0
    return Project.load(place)


@pytest.mark.parametrize("shape", EXPORTS)
def test_init_finds_the_loops(shape: str, record: Signals, tmp_path: Path):
    export = EXPORTS[shape]
    project = begun(export, record, tmp_path)
    found = [(o.pv, o.sp, i.op) for o, i in zip(project.outputs, project.inputs, strict=True)]
    assert found == [tuple(export.column(loop, s) for s in ("PV", "SP", "OP")) for loop in export.loops]
    assert [o.kind for o in project.outputs] == [KINDS[loop] for loop in export.loops]
    assert [i.mode for i in project.inputs] == [
        export.column(loop, "MODE") if export.modes else None for loop in export.loops
    ]
    assert [o.status for o in project.outputs] == [
        export.column(loop, "STATUS") if export.status else None for loop in export.loops
    ]
    if export.units:
        assert [(o.unit, i.unit) for o, i in zip(project.outputs, project.inputs, strict=True)] == [
            (UNITS[loop], "%") for loop in export.loops
        ]
    assert (project.time_unit, project.model, project.controllers) == (export.time_unit, [], [])
    text = (tmp_path / "project.toml").read_text(encoding="utf-8")
    assert (f'# column = "{export.feed}"' in text) == bool(export.feed)
    assert "automatic_values" not in text


@pytest.mark.parametrize("shape", EXPORTS)
def test_check_reads_what_was_written(shape: str, record: Signals, tmp_path: Path):
    export = EXPORTS[shape]
    project = begun(export, record, tmp_path)
    assert check(project).status is Status.OK
    read = read_record(tmp_path / export.file, layout_of(project))
    for k, loop in enumerate(export.loops):
        bad = (np.array(record.status[loop]) != "Good") & (export.status or export.bad)
        np.testing.assert_allclose(read.y[:, k], np.where(bad, np.nan, record.values[loop, "PV"]))
        np.testing.assert_allclose(read.r[:, k], record.values[loop, "SP"])
        np.testing.assert_allclose(read.u[:, k], record.values[loop, "OP"])
        automatic = np.array(record.modes[loop]) != "MAN" if export.modes else np.ones(read.t.size, bool)
        np.testing.assert_array_equal(read.automatic[:, k], automatic)
    np.testing.assert_allclose(np.diff(read.t), 0.5)


@pytest.mark.slow
@pytest.mark.parametrize("shape", EXPORTS)
def test_the_first_run_finds_the_plant(shape: str, record: Signals, tmp_path: Path):
    export = EXPORTS[shape]
    project = begun(export, record, tmp_path)
    result = analyse(project)
    loops = dict(zip(project.output_names, export.loops, strict=True))
    inputs = dict(zip(project.input_names, export.loops, strict=True))
    found = {(loops[e.output], inputs[e.input]): e.structure for e in result.elements if e.verdict == "found"}
    assert found == {place: said for place, said in FOUND.items() if set(place) <= set(export.loops)}
    assert {str(e.verdict) for e in result.elements} <= {"found", "none found"}
