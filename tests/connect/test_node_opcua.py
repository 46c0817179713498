"""OPC UA once more, with the server of somebody else: node-opcua, in its own language.

Looked for in the folder TRUEPLANT_NODE_OPCUA, in which `npm install node-opcua` was run.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import polars as pl
import pytest

from support import certificates, historians, servers
from trueplant import connect
from trueplant.cli import main
from trueplant.project import Project

pytestmark = pytest.mark.slow
EXPECTED = historians.events().sort("tag", "time")


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, Any]]:
    """The server with the demo's events, and how a project names it."""
    place = Path(os.environ.get("TRUEPLANT_NODE_OPCUA", "none")) / "node_modules"
    node = shutil.which("node")
    if node is None or not (place / "node-opcua").is_dir():
        servers.unavailable("TRUEPLANT_NODE_OPCUA names no folder in which npm install node-opcua was run")
    servers.imported("asyncua")
    folder, port = tmp_path_factory.mktemp("node"), servers.free_port()
    rows = [[tag, round(1000 * stamp.timestamp()), value] for tag, stamp, value in historians.events().iter_rows()]
    (folder / "events.json").write_text(json.dumps(rows))
    said = {"port": port, "events": str(folder / "events.json"), "pki": str(folder / "pki")}
    said |= {"user": "reader", "password": historians.SECRET}
    program = Path(certificates.__file__).with_name("opcua_server.js")
    with open(folder / "log", "w") as log:
        command = [str(node), str(program), json.dumps(said)]
        environment = os.environ | {"NODE_PATH": str(place)}
        server = subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, stderr=log, text=True)
    try:
        assert server.stdout is not None
        if not any(line == "ready\n" for line in server.stdout):
            pytest.fail(f"node-opcua did not start: {(folder / 'log').read_text()[:2000]}")
        yield {"kind": "opcua", "url": f"opc.tcp://127.0.0.1:{port}/", "tag": "ns=1;s={}"}
    finally:
        server.kill()
        server.communicate()


def fetched(folder: Path, source: dict[str, Any]) -> pl.DataFrame:
    connect.fetch(Project.load(historians.written(folder, source)), refresh=True)
    return pl.read_parquet(folder / "project-snapshot.parquet")


@pytest.mark.parametrize("page", [700, 10_000])
def test_pages_that_share_one_continuation_point(source, tmp_path: Path, page: int):
    assert fetched(tmp_path, source | {"page": page}).drop("quality").equals(EXPECTED)


@pytest.mark.parametrize("policy", ["Basic256Sha256", "Aes256Sha256RsaPss"])
@pytest.mark.parametrize("security", ["sign", "sign and encrypt"])
def test_signed_and_encrypted_with_a_password(source, tmp_path, monkeypatch, capsys, policy: str, security: str):
    certificates.make(tmp_path, "client", "urn:test:client")
    monkeypatch.setenv("TRUEPLANT_TEST_UA", historians.SECRET)
    secure = {"security": security, "policy": policy, "certificate": "client.der", "private_key": "client-key.pem"}
    secure |= {"user": "reader", "password_env": "TRUEPLANT_TEST_UA"}
    assert fetched(tmp_path, source | secure).drop("quality").equals(EXPECTED)
    monkeypatch.setenv("TRUEPLANT_TEST_UA", "wr0ng-secret")
    assert main(["fetch", str(tmp_path / "project.toml"), "--refresh"]) == 4
    err = capsys.readouterr().err
    assert "wr0ng" not in err and err.count("\n") == 1
