"""What the pages on historians and audits show can be used as it stands, and names what there is."""

from __future__ import annotations

import configparser
import re
import tomllib
from pathlib import Path

from support import ROOT
from trueplant.fleet import Site
from trueplant.fleet.rank import COLUMNS
from trueplant.fleet.row import Finding, Outcome
from trueplant.fleet.site import Acknowledged, Alarm, Audit, Cluster, Loops
from trueplant.project.source_table import Historian

AUDITS, HISTORIANS = ((ROOT / "docs" / name).read_text("utf-8") for name in ("audits.md", "historians.md"))


def indented(page: str, first: str) -> str:
    """The block of code that begins with a line, without its indentation."""
    after = page[page.index(f"    {first}") :]
    lines = re.match(r"(?:(?: {4}.*)?\n)+", after)
    assert lines is not None
    return "\n".join(line[4:] for line in lines[0].splitlines())


def cells(head: str) -> set[str]:
    """Every name in the first column of the table with this head."""
    table = AUDITS[AUDITS.index(head) :].split("\n\n")[0]
    return {name for line in table.splitlines()[2:] for name in re.findall(r"`([^`]+)`", line.split("|")[1])}


def test_the_site_files_shown_are_site_files(tmp_path: Path) -> None:
    whole = indented(AUDITS, 'name = "Refinery 2"')
    (tmp_path / "site.toml").write_text(f"{whole}\n{indented(AUDITS, '[cluster]')}", encoding="utf-8")
    site = Site.load(tmp_path / "site.toml")
    assert [one.projects or one.template for one in site.loops] == ["units/*/*.toml", "pid.toml"]
    assert (site.audit.workers, site.audit.window, site.audit.deadline) == (4, "30 d", "10 min")
    assert site.alarm is not None and site.acknowledged and site.cluster is not None


def test_every_key_of_a_site_file_is_described() -> None:
    told = {name.rpartition("] ")[2] for name in cells("| key | what it is | default |")}
    keys = {
        field.alias or name
        for table in (Loops, Audit, Cluster, Alarm, Acknowledged)
        for name, field in table.model_fields.items()
    }
    assert keys | {"name"} == told


def test_every_column_of_the_table_is_described() -> None:
    assert cells("| column | what it holds |") == set(COLUMNS)
    assert all(f"`{word}`" in AUDITS for word in (*Outcome, *Finding))


def test_the_timer_shown_is_one() -> None:
    units = configparser.ConfigParser(strict=True)
    units.optionxform = str  # type: ignore[assignment,method-assign]
    units.read_string(indented(AUDITS, "[Service]"))
    assert {"Service", "Timer", "Install"} == set(units.sections())
    assert units["Service"]["ExecStart"].split()[1:] == ["audit", "site.toml"] and units["Service"]["Type"] == "oneshot"
    assert "systemctl enable --now trueplant-audit.timer" in AUDITS


def test_the_sources_shown_are_sources() -> None:
    shown = [
        tomllib.loads(block) for block in re.findall(r"```toml\n(.*?)```", HISTORIANS.replace("\n   ", "\n"), re.S)
    ]
    kinds = [Historian(**one["data"]["source"]).kind for one in shown]
    assert set(kinds) == {"opcua", "parquet", "postgresql", "sqlite", "pi"}
