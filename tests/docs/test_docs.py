"""The documentation says what the code does. Its examples run when it is built; its tables and links are held here."""

from __future__ import annotations

import dataclasses
import re
import tomllib
import typing
from pathlib import Path
from typing import Any

import pytest
from pydantic import TypeAdapter
from pydantic.fields import FieldInfo

import trueplant as tp
from support import ROOT
from trueplant import Project, detect, errors
from trueplant.cli.entry import INTERNAL_ERROR, INTERRUPTED
from trueplant.loop import PID, Controller, alternating_steps, simulate
from trueplant.project.fields import Table
from trueplant.result import ExperimentData, Reason

DOCS = ROOT / "docs"
PAGES = sorted(p for p in DOCS.rglob("*.md") if not {"_build", "jupyter_execute"} & set(p.parts))


def outside_code(page: Path) -> str:
    return re.sub(r"^(`{3,})(?!\{toctree).*?^\1$", "", page.read_text("utf-8"), flags=re.S | re.M)


def sections(page: str) -> dict[str, str]:
    """Heading (without its marks) to the text below it, up to the next heading of any level."""
    parts = re.split(r"^#+ (.+)$", outside_code(DOCS / page), flags=re.M)
    return dict(zip(parts[1::2], parts[2::2], strict=True))


def rows(text: str) -> list[list[str]]:
    """The cells of the rows of a table, without its head."""
    lines = [line for line in text.splitlines() if line.startswith("|")]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines[2:]]


def names(text: str) -> set[str]:
    """All names in the first column of a table."""
    return {name for row in rows(text) for name in re.findall(r"`([^`]+)`", row[0])}


# -- links and pages ------------------------------------------------------------------------------------------


def anchors(page: Path) -> set[str]:
    text = outside_code(page)
    slugs = {
        re.sub(r"[^\w\- ]", "", heading.lower()).strip().replace(" ", "-")
        for heading in re.findall(r"^#+ (.+)$", text, flags=re.M)
    }
    return slugs | set(re.findall(r"^\(([\w-]+)\)=$", text, flags=re.M))


def test_links_lead_somewhere() -> None:
    links = [(page, target) for page in PAGES for target in re.findall(r"\]\(([^)\s]+)\)", outside_code(page))]
    inside = [(page, target) for page, target in links if "://" not in target]
    assert len(inside) > len(PAGES)
    for page, target in inside:
        name, _, anchor = target.partition("#")
        goal = (page.parent / name).resolve() if name else page
        assert goal.is_file(), f"{page.name} links to {target}"
        assert not anchor or anchor in anchors(goal), f"{page.name} links to {target}"


def test_every_page_is_in_the_table_of_contents() -> None:
    index = (DOCS / "index.md").read_text("utf-8")
    listed = {
        line.strip()
        for tree in re.findall(r"^```\{toctree\}\n(.*?)^```", index, flags=re.S | re.M)
        for line in tree.splitlines()
        if line.strip() and not line.startswith(":")
    }
    assert listed == {p.relative_to(DOCS).with_suffix("").as_posix() for p in PAGES} - {"index"}


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.relative_to(DOCS).as_posix())
def test_pages_with_code_cells_are_executed(page: Path) -> None:
    """Without its head a page with code cells would be built without running them."""
    text = page.read_text("utf-8")
    assert ("{code-cell}" in text) == text.startswith("---\njupytext:")


def test_commands_shown_are_the_ones_that_run() -> None:
    text = (DOCS / "quickstart.md").read_text("utf-8")
    shown = re.findall(r"^\$ trueplant (.+)$", text, flags=re.M)
    ran = re.findall(r'^trueplant\("([^"]+)"', text, flags=re.M)
    assert shown == ran and len(shown) > 3


# -- verdicts -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("row", rows(sections("verdicts.md")["The grade"]), ids=lambda row: " ".join(row))
def test_grade_table(row: list[str]) -> None:
    widest, answered, sound, expected = row
    width = float(widest.removesuffix(" %")) / 100
    told = {"all": [True, True], "not all": [True, False], "none": [False, False]}[answered]
    assert detect.grade([width, width / 2], told, {"yes": True, "no": False}[sound]) == expected


def test_grade_table_has_every_grade_and_both_sides_of_each_boundary() -> None:
    table = rows(sections("verdicts.md")["The grade"])
    assert {row[3] for row in table} == set("ABCD")
    assert {"10 %", "10.1 %", "25 %", "25.1 %"} <= {row[0] for row in table}


# -- the project file -----------------------------------------------------------------------------------------


def inner_tables(annotation: Any) -> set[type[Table]]:
    if isinstance(annotation, type) and issubclass(annotation, Table):
        return {annotation}
    return {table for part in typing.get_args(annotation) for table in inner_tables(part)}


def tables(model: type[Table], path: str = "") -> dict[str, type[Table]]:
    """Dotted key to the table found there."""
    found = {path: model}
    for name, field in model.model_fields.items():
        key = f"{path}.{field.alias or name}".strip(".")
        # of two tables at one place, one an entry and one for all, that with more keys is described
        for table in sorted(inner_tables(field.annotation), key=lambda table: len(table.model_fields)):
            found |= tables(table, key)
    return found


def described() -> dict[str, dict[str, list[str]]]:
    """Dotted key of each table described to its rows, by key."""
    out = {}
    for heading, text in sections("project.md").items():
        for place in [""] if heading == "Top level" else re.findall(r"`\[+([\w.]+)\]+`", heading):
            out[place] = {row[0].strip("`"): row for row in rows(text)}
    return out


TABLES = tables(Project)


def is_table(field: FieldInfo) -> bool:
    return bool(inner_tables(field.annotation))


@pytest.mark.parametrize("place", TABLES, ids=lambda place: place or "top level")
def test_every_key_of_the_project_file_is_described(place: str) -> None:
    fields = {field.alias or name: field for name, field in TABLES[place].model_fields.items()}
    if place == "":
        # the tables themselves have sections of their own
        assert {key for key, field in fields.items() if is_table(field)} <= described().keys()
        fields = {key: field for key, field in fields.items() if not is_table(field)}
    told = described()[place]
    assert told.keys() == fields.keys()
    for key, field in fields.items():
        _, meaning, _, default, example = told[key]
        assert meaning
        assert (default == "needed") == field.is_required(), f"{place}.{key}"
        if isinstance(field.default, (str, float, bool)) and field.default != "":
            expected = str(field.default).lower() if isinstance(field.default, bool) else field.default
            shown = f'"{expected}"' if isinstance(field.default, str) else str(expected)
            assert default == f"`{shown}`", f"{place}.{key}"
        value = tomllib.loads(example.strip("`"))
        assert value.keys() == {key}
        TypeAdapter(field.rebuild_annotation()).validate_python(value[key])


def test_no_table_is_described_that_does_not_exist() -> None:
    assert described().keys() <= TABLES.keys()


def test_toml_shown_is_toml() -> None:
    shown = [
        b for page in PAGES for b in re.findall(r"^```toml\n(.*?)^```", page.read_text("utf-8"), flags=re.S | re.M)
    ]
    assert shown
    for block in shown:
        assert tomllib.loads(block)


# -- the result -----------------------------------------------------------------------------------------------


def fields_of(kind: type) -> set[str]:
    return {field.name for field in dataclasses.fields(kind)}


@pytest.fixture(scope="module")
def body(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """result.json of a small simulated record."""
    import polars as pl

    folder = tmp_path_factory.mktemp("record")
    plant = tp.TransferMatrix.of([["2 exp(-2 s)/(10 s + 1)"]], "min")
    law = Controller.diagonal([PID(Kc=1.0, Ti=10.0, sample_time=1.0)])
    sim = simulate(plant, law, alternating_steps(300, 1.0, 60.0, [1.0]), 1.0, noise=0.02, seed=1)
    columns = {"t": sim.t, "sp": sim.r[:, 0], "op": sim.u[:, 0], "pv": sim.y[:, 0]}
    pl.DataFrame(columns).write_csv(folder / "record.csv")
    project = """
        time_unit = "min"
        data = {files = ["record.csv"]}
        output = [{name = "y", pv = "pv", sp = "sp"}]
        input = [{name = "u", op = "op"}]
        model = [{output = "y", input = "u", tf = "2 exp(-2 s)/(10 s + 1)"}]
    """
    return tp.run(Project.from_toml(project, folder)).to_dict()


def test_every_field_of_the_result_is_described(body: dict[str, Any]) -> None:
    told = sections("result.md")
    assert body["status"] == "ok"
    assert names(told["result.json, schema 1"]) == body.keys() | {"files"}
    assert names(told["`provenance`"]) == body["provenance"].keys()
    assert names(told["Each of `data`"]) == fields_of(ExperimentData)  # some stand there only with time stamps
    assert names(told["Each of `fit`"]) == body["fit"][0].keys()
    assert names(told["Each of `elements`"]) == body["elements"][0].keys()
    assert names(told["Each of `parameters`"]) == body["elements"][0]["parameters"][0].keys()
    assert fields_of(Reason) <= set(re.findall(r"`(\w+)`", told["result.json, schema 1"]))


def test_every_exit_status_is_described() -> None:
    told = {int(row[0]) for row in rows(sections("result.md")["Exit status"])}
    raised = {kind.exit_status for kind in vars(errors).values() if isinstance(kind, type)}
    assert told == raised | {0, 1, INTERNAL_ERROR, INTERRUPTED}
