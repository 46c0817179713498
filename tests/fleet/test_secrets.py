"""Nothing that a command prints or writes holds a password, a token, a webhook's address or a key of a certificate."""

from __future__ import annotations

import base64
import gzip
import html
import json
import re
import subprocess
import sys
from collections.abc import Iterator
from datetime import timedelta
from pathlib import Path
from urllib.parse import quote, quote_plus

import polars as pl
import pytest

from fleet.conftest import CHANGED, SITE, loop_text, write_loop
from support import certificates, historians, servers
from support.command import ENVIRONMENT
from trueplant.project.document import to_toml

PASSWORD, TOKEN, OTHER, HOOK = historians.SECRET, "t0ken-<&>-äöü", "p&ss'w\"rd%/+x", "h00k=secret/path"
WINDOW = f"from = {historians.START.isoformat()}\nto = {(historians.START + timedelta(minutes=301)).isoformat()}\n"
SECRET_FILES = {"token", "client.key", "client-key.pem", "pi-key.pem"}
"""What the test itself wrote."""


def spellings(secret: str) -> set[bytes]:
    """A secret in every writing that a page, a log, a URL or a library may give it."""
    plain = {
        *(secret, quote(secret), quote(secret, safe=""), quote_plus(secret), html.escape(secret), repr(secret)[1:-1]),
        *(json.dumps(secret)[1:-1], json.dumps(secret, ensure_ascii=False)[1:-1]),
    }
    coded = {base64.b64encode(text.encode()) for text in (secret, f"reader:{secret}")}
    return {text.encode() for text in plain} | coded | {secret.encode("utf-16-le")}


def unpacked(content: bytes) -> Iterator[bytes]:
    """What base64 in a page holds, unzipped where it was zipped."""
    for packed in re.findall(rb"[A-Za-z0-9+/]{60,}={0,2}", content):
        try:
            raw = base64.b64decode(packed)
            yield gzip.decompress(raw) if raw[:2] == b"\x1f\x8b" else raw
        except (ValueError, OSError, EOFError):
            continue


def contents(folder: Path) -> Iterator[tuple[str, bytes]]:
    """Name and bytes of every file that a command wrote; of tables their cells too."""
    for file in sorted(folder.rglob("*")):
        if not file.is_file() or file.name in SECRET_FILES:
            continue
        whole = file.read_bytes()
        yield str(file), whole
        yield from ((f"packed in {file}", one) for one in unpacked(whole) if file.suffix == ".html")
        if file.suffix == ".parquet":
            cells = pl.read_parquet(file, hive_partitioning=False).select(pl.col(pl.String)).write_csv()
            yield f"cells of {file}", cells.encode()


def leaks(secrets: dict[str, set[bytes]], folder: Path, printed: dict[str, bytes]) -> list[str]:
    everything = [*contents(folder), *printed.items()]
    return [
        f"{name} in {where}"
        for where, text in everything
        for name, all_ in secrets.items()
        if any(s in text for s in all_)
    ]


def sourced(name: str, source: dict[str, object]) -> str:
    """The project of a quick loop that reads a historian."""
    text = loop_text(name, CHANGED, 3)
    own = f"[data]\n{WINDOW}{to_toml({'data': {'source': source}})}"
    return text.replace(f'[data]\nfiles = ["{name}.csv"]\ntime = "t"\n', own)


@pytest.fixture
def site(tmp_path: Path) -> Iterator[Path]:
    """Loops whose historians ask for secrets: one that answers, and others that do not let us in or are gone."""
    units = tmp_path / "units"
    write_loop(tmp_path / "made", "good", CHANGED, 3)
    wide = pl.read_csv(tmp_path / "made" / "good.csv")
    stamps = pl.lit(historians.START).dt.cast_time_unit("us") + pl.duration(microseconds=pl.col("t") * 60e6)
    long = wide.with_columns(stamps.alias("time")).drop("t").unpivot(index="time", variable_name="tag")
    events = long.select("tag", "time", pl.col("value").cast(pl.Float64)).sort("time", "tag")
    units.mkdir()
    _, key = certificates.make(units, "client", "urn:test:client")
    (units / "token").write_text(TOKEN, encoding="utf-8")
    with servers.pi(units, events) as served:
        url = served.source["url"]
        bearer = {"kind": "pi", "url": url, "server": "PISRV", "auth": "bearer", "token_file": "token", "ca": "pi.pem"}
        opcua = {
            "kind": "opcua", "url": "opc.tcp://127.0.0.1:1/", "security": "sign and encrypt", "user": "reader",
            "certificate": "client.der", "private_key": key.name, "password_env": "OTHER_PASSWORD",
        }  # fmt: skip
        sql = {"kind": "postgresql", "url_env": "DATABASE", "query": "select :tags, :from, :to"}
        sources = {
            "good": served.source,
            "wrong": served.source | {"password_env": "OTHER_PASSWORD"},
            "bearer": bearer,
            "opcua": opcua,
            "sql": sql,
        }
        for name, source in sources.items():
            (units / f"{name}.toml").write_text(sourced(name, source), encoding="utf-8")
        cluster = '[cluster]\naddress = "tls://127.0.0.1:1"\nca = "units/pi.pem"\n'
        cluster += f'certificate = "units/client.pem"\nkey = "units/{key.name}"\n'
        (tmp_path / "site.toml").write_text(f'{SITE}[alarm]\nwebhook_env = "WEBHOOK"\n', encoding="utf-8")
        (tmp_path / "clustered.toml").write_text(SITE + cluster, encoding="utf-8")
        yield tmp_path


@pytest.mark.slow
def test_no_secret_in_any_output_log_error_snapshot_or_page(site: Path) -> None:
    said = {
        "TRUEPLANT_TEST_PI": PASSWORD,
        "OTHER_PASSWORD": OTHER,
        "DATABASE": f"postgresql://reader:{quote(OTHER, safe='')}@127.0.0.1:1/plant",
        "WEBHOOK": f"https://127.0.0.1:1/{quote(HOOK)}",
        "PYTHONWARNINGS": "always",
    }
    commands = [
        ["audit", "site.toml", "--out", "out", "--workers", "0", "--pages"],
        ["audit", "clustered.toml", "--out", "clustered"],
        *(["fetch", f"units/{name}.toml", "--refresh"] for name in ("good", "wrong", "bearer", "opcua", "sql")),
        ["run", "units/good.toml", "--out", "run"],
        ["bundle", "units/good.toml"],
    ]
    printed, status = {}, {}
    for command in commands:
        line = [sys.executable, "-m", "trueplant", *command]
        ran = subprocess.run(line, cwd=site, env=ENVIRONMENT | said, capture_output=True)
        printed[" ".join(command)] = ran.stdout + ran.stderr
        status[" ".join(command)] = ran.returncode
    # every way was gone: what let us in was read, and what did not was said
    assert list(status.values()) == [0, 2, 0, 4, 4, 4, 4, 0, 0], (status, printed)
    rows = pl.read_parquet(next((site / "out").glob("run=*/audit.parquet")), hive_partitioning=False)
    found = dict(rows.select("loop", "status").rows())
    failed = dict.fromkeys((f"units/{name}" for name in ("wrong", "bearer", "opcua", "sql")), "failed")
    assert found == {"units/good": "analysed"} | failed
    assert b"the alarm" in printed[" ".join(commands[0])] or b"webhook" in printed[" ".join(commands[0])]
    key = max((site / "units" / "client-key.pem").read_text().splitlines(), key=len)
    secrets = {"password": PASSWORD, "other password": OTHER, "token": TOKEN, "webhook": HOOK, "key": key}
    known = {name: spellings(secret) for name, secret in secrets.items()}
    assert leaks(known, site, printed) == []
    # the search finds what is there: in a page's packed figures, in a table's cells, and as the server was sent it
    assert leaks({"page": {b"plotly"}}, site / "run", {})
    for name, secret in secrets.items():
        pl.DataFrame({"cell": [f"user:{secret}"]}).write_parquet(site / "planted.parquet", compression="zstd")
        assert leaks({name: spellings(secret)}, site, {})
    (site / "planted.parquet").unlink()
    coded = base64.b64encode(f"reader:{PASSWORD}".encode())
    assert leaks({"header": spellings(PASSWORD)}, site, {"log": b"Authorization: Basic " + coded})
