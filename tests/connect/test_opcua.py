"""OPC UA: pages and continuation points, security, and servers that are slow, stuck, killed or restarted."""

from __future__ import annotations

import subprocess
import sys
import threading
import time
from datetime import timedelta
from pathlib import Path
from typing import Any

import polars as pl
import pytest

from support import certificates, historians, servers
from support.command import ENVIRONMENT
from trueplant import connect
from trueplant.cli import main
from trueplant.connect import levels
from trueplant.errors import DataError, ProjectError, SourceError
from trueplant.project import Project

EVENTS = historians.events().filter(pl.col("time") < historians.START + timedelta(minutes=60))
EXPECTED = EVENTS.sort("tag", "time")


@pytest.fixture(autouse=True)
def _here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    servers.imported("asyncua")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(levels, "PAUSE", 0.01)


def fetched(folder: Path, source: dict[str, Any]) -> pl.DataFrame:
    connect.fetch(Project.load(historians.written(folder, source)), refresh=True)
    return pl.read_parquet(folder / "project-snapshot.parquet")


def test_pages_of_many_sizes_and_a_server_that_gives_less(tmp_path: Path):
    with servers.opcua(tmp_path, EVENTS, most=250) as served:
        for page in (100, 600, 5000):
            assert fetched(tmp_path, served.source | {"page": page}).drop("quality").equals(EXPECTED)
        told = connect.fetch(Project.load("project.toml")).about
        assert {(tag["unit"], tuple(tag["span"])) for tag in told["tags"]} == {("degC", (0.0, 400.0))}


@pytest.mark.slow
def test_many_nodes_are_asked_for_in_groups(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(levels, "NODE_VALUES", 2000)
    with servers.opcua(tmp_path, EVENTS) as served:
        assert fetched(tmp_path, served.source | {"page": 1000}).drop("quality").equals(EXPECTED)


def test_a_continuation_point_that_repeats_is_no_endless_loop(tmp_path: Path, capsys):
    with servers.opcua(tmp_path, EVENTS, stuck=True) as served:
        historians.written(tmp_path, served.source)
        before = historians.leaves(tmp_path)
        assert main(["fetch", "project.toml"]) == 4
    err = capsys.readouterr().err
    assert "again and again" in err and err.count("\n") == 1 and historians.leaves(tmp_path) == before


@pytest.mark.parametrize(
    ("policy", "security"),
    [
        ("Aes256Sha256RsaPss", "sign and encrypt"),
        pytest.param("Aes256Sha256RsaPss", "sign", marks=pytest.mark.slow),
        pytest.param("Basic256Sha256", "sign and encrypt", marks=pytest.mark.slow),
        pytest.param("Basic256Sha256", "sign", marks=pytest.mark.slow),
    ],
)
def test_signed_and_encrypted_with_a_password(tmp_path: Path, monkeypatch, capsys, policy: str, security: str):
    server, server_key = certificates.make(tmp_path, "server", "urn:test:server")
    certificates.make(tmp_path, "client", "urn:test:client")
    monkeypatch.setenv("TRUEPLANT_TEST_UA", historians.SECRET)
    name = f"{policy}_{'Sign' if security == 'sign' else 'SignAndEncrypt'}"
    said = {"certificate": str(server), "private_key": str(server_key), "policies": [name]}
    with servers.opcua(tmp_path, EVENTS, user=("reader", historians.SECRET), **said) as served:
        source = served.source | {
            "security": security, "policy": policy, "certificate": "client.der", "private_key": "client-key.pem",
            "server_certificate": "server.der", "user": "reader", "password_env": "TRUEPLANT_TEST_UA",
        }  # fmt: skip
        assert fetched(tmp_path, source).drop("quality").equals(EXPECTED)
        assert historians.SECRET.encode() not in (tmp_path / "project-snapshot.parquet.json").read_bytes()
        with pytest.raises(SourceError):  # unsigned is not served
            fetched(tmp_path, served.source)
        monkeypatch.setenv("TRUEPLANT_TEST_UA", "wr0ng-secret")
        historians.written(tmp_path, source)
        assert main(["fetch", "project.toml", "--refresh"]) == 4
        err = capsys.readouterr().err
        assert "wr0ng" not in err and err.count("\n") == 1


@pytest.mark.slow
def test_a_server_that_is_slow_is_waited_for(tmp_path: Path):
    with servers.opcua(tmp_path, EVENTS, delay=0.2) as served:
        assert fetched(tmp_path, served.source).drop("quality").equals(EXPECTED)
        with pytest.raises(SourceError, match="does not answer"):
            fetched(tmp_path, served.source | {"timeout": 0.1})


@pytest.mark.slow
def test_a_server_that_is_killed_while_it_is_read_leaves_nothing(tmp_path: Path, capsys):
    with servers.opcua(tmp_path, EVENTS, dies_at=12) as served:
        historians.written(tmp_path, served.source | {"page": 100})
        before = historians.leaves(tmp_path)
        assert main(["run", "project.toml"]) == 4
        assert served.more.wait(10) == 1
    err = capsys.readouterr().err
    assert "does not answer" in err and err.count("\n") == 1
    assert historians.leaves(tmp_path) == before


@pytest.mark.slow
def test_the_command_says_one_thing_and_its_libraries_nothing(tmp_path: Path):
    """In a process of its own, where nobody collects what asyncua logs."""
    line = [sys.executable, "-m", "trueplant", "fetch", "project.toml", "--refresh"]
    with servers.opcua(tmp_path, EVENTS, dies_at=40) as served:
        historians.written(tmp_path, served.source)
        done = subprocess.run(line, env=ENVIRONMENT, capture_output=True, text=True, check=False)
        assert (done.returncode, done.stderr) == (0, "")
        assert done.stdout.count("\n") == 1 + len(historians.TAGS)
        historians.written(tmp_path, served.source | {"page": 10})
        done = subprocess.run(line, env=ENVIRONMENT, capture_output=True, text=True, check=False)
        assert done.returncode == 4 and done.stdout == ""
        assert done.stderr.startswith("trueplant: opc.tcp://127.0.0.1") and done.stderr.count("\n") == 1


@pytest.mark.slow
def test_a_server_that_comes_back_is_read_to_the_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    # a busy machine takes its time to start a server
    monkeypatch.setattr(levels, "PAUSE", 2.0)
    monkeypatch.setattr(levels, "ATTEMPTS", 7)
    port = servers.free_port()
    back = threading.Event()

    def restart() -> None:
        assert first.more.wait(30) == 1
        with servers.opcua_process(tmp_path, EVENTS, port=port):
            back.wait(120)

    with servers.opcua(tmp_path, EVENTS, port=port, dies_at=12) as first:
        again = threading.Thread(target=restart)
        again.start()
        began = time.monotonic()
        try:
            found = fetched(tmp_path, first.source | {"page": 100})
        finally:
            back.set()
            again.join()
    assert found.drop("quality").equals(EXPECTED) and time.monotonic() - began > 1


@pytest.mark.slow
def test_mistakes_in_addresses_are_named(tmp_path: Path):
    with servers.opcua(tmp_path, EVENTS) as served:
        with pytest.raises(DataError, match="no node 'ns=2;s=plant.pv1'"):
            fetched(tmp_path, served.source | {"tag": "ns=2;s=plant.{}"})
        with pytest.raises(ProjectError, match="is no node"):
            fetched(tmp_path, served.source | {"tag": "{}"})
        (tmp_path / "c.der").write_text("none")
        secure = {"security": "sign", "certificate": "c.der", "private_key": "c.der"}
        with pytest.raises(ProjectError, match="holds no certificate"):
            fetched(tmp_path, served.source | secure)
    with pytest.raises(SourceError, match="does not answer"):
        fetched(tmp_path, served.source | {"timeout": 2.0})
