"""Several workers: the same rows as one after the other, and a loop that kills them is one row."""

from __future__ import annotations

import contextlib
import json
import logging
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import polars as pl
import pytest

from trueplant.errors import UsageError
from trueplant.fleet import Options, Site, audit
from trueplant.fleet.cluster import on_this_machine

pytest.importorskip("distributed", reason="workers are Dask's: install trueplant[fleet] to run these tests")

KILLER = """
import multiprocessing, os, signal, sys
def look(event, arguments):
    if event == "open" and str(arguments[0]).endswith("poison.csv") and multiprocessing.parent_process():
        os.kill(os.getpid(), signal.SIGKILL)
sys.addaudithook(look)
"""
"""Put before every process: a worker that opens poison.csv is gone."""
COMPUTED = ["cpu_s", "memory_mb", "since"]
"""What two audits of the same data may differ in."""


def command(site: Path, out: str, *options: str) -> list[str]:
    return [sys.executable, "-m", "trueplant", "audit", str(site), "--out", str(site.parent / out), *options]


def environment(site: Path) -> dict[str, str]:
    (site.parent / "sitecustomize.py").write_text(KILLER, encoding="utf-8")
    source = Path(__file__).parents[2] / "src"
    return os.environ | {"PYTHONPATH": f"{site.parent}{os.pathsep}{source}"}


def rows(site: Path, out: str) -> pl.DataFrame:
    last = sorted((site.parent / out).glob("run=*/audit.parquet"))[-1]
    return pl.read_parquet(last, hive_partitioning=False).drop(COMPUTED).sort("loop")


def copies(site: Path, number: int) -> None:
    """More loops with records of their own."""
    units = site.parent / "units"
    for k in range(number):
        (units / f"more{k}.toml").write_text((units / "same.toml").read_text().replace("same.csv", f"more{k}.csv"))
        (units / f"more{k}.csv").write_bytes(b"\n".join((units / "same.csv").read_bytes().splitlines()[: -k - 1]))


@pytest.fixture
def poisoned(site: Path) -> Path:
    units = site.parent / "units"
    (units / "poison.toml").write_text((units / "same.toml").read_text().replace("same.csv", "poison.csv"))
    (units / "poison.csv").write_bytes((units / "same.csv").read_bytes())
    return site


@pytest.mark.slow
def test_workers_keep_the_memory_that_they_will_need_again() -> None:
    with on_this_machine(1) as workers:
        (found,) = workers._client.run(lambda: dict(os.environ)).values()
    assert int(found["MALLOC_TRIM_THRESHOLD_"]) >= 2 * int(found["MALLOC_MMAP_THRESHOLD_"]) >= 1 << 25
    assert found["OPENBLAS_NUM_THREADS"] == "1"


@pytest.mark.slow
def test_workers_say_nothing_that_the_row_of_a_loop_says() -> None:
    def levels() -> list[int]:
        names = (
            "distributed.worker.state_machine",
            "distributed.nanny",
            "distributed.gc",
            "tornado.general",
            "asyncio",
        )
        return [logging.getLogger(name).getEffectiveLevel() for name in names]

    with on_this_machine(1) as workers:
        (found,) = workers._client.run(levels).values()
    assert set(found) == {logging.CRITICAL}


@pytest.mark.slow
def test_the_same_rows_and_a_poison_loop_is_one(poisoned: Path) -> None:
    copies(poisoned, 3)
    both = environment(poisoned)
    run = subprocess.run(command(poisoned, "two", "--workers", "2"), env=both, capture_output=True, text=True)
    assert (run.returncode, run.stderr) == (0, "")
    two = rows(poisoned, "two")
    assert two.filter(pl.col("status") == "killed")["loop"].to_list() == ["units/poison"]
    (poisoned.parent / "units" / "poison.toml").unlink()
    subprocess.run(command(poisoned, "one", "--workers", "0"), env=both, check=True, capture_output=True)
    one = rows(poisoned, "one").drop("rank")
    assert one.equals(two.filter(pl.col("loop") != "units/poison").drop("rank"), null_equal=True)


def children(process: int) -> list[int]:
    """Processes below one, of every generation, whichever of its threads began them."""
    found = []
    for file in Path(f"/proc/{process}/task").glob("*/children"):
        try:
            own = [int(child) for child in file.read_text().split()]
        except OSError:
            continue
        found += [*own, *(below for child in own for below in children(child))]
    return found


def is_worker(process: int) -> bool:
    try:
        return b"spawn_main" in Path(f"/proc/{process}/cmdline").read_bytes()
    except OSError:
        return False


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/task").is_dir(), reason="workers are found in /proc, which only Linux has")
def test_killed_at_random_moments_it_comes_to_the_same(site: Path) -> None:
    copies(site, 6)
    both = environment(site)
    subprocess.run(command(site, "whole", "--workers", "2"), env=both, check=True, capture_output=True)
    chance, killed = random.Random(20261005), []
    for victim in ("client", "worker", "client", "worker"):
        done = sorted((site.parent / "killed" / "loops").glob("*.json"))
        for left in chance.sample(done, k=min(2, len(done))):
            left.unlink()  # so that there is work to do, however fast the machine
        process = subprocess.Popen(
            command(site, "killed", "--workers", "2"), env=both, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        while process.poll() is None and not (own := [child for child in children(process.pid) if is_worker(child)]):
            time.sleep(0.05)
        time.sleep(chance.uniform(0.0, 5.0))
        if process.poll() is None and own:
            os.kill(process.pid if victim == "client" else chance.choice(own), signal.SIGKILL)
            killed.append(victim)
        process.wait()
    assert {"client", "worker"} <= set(killed)
    subprocess.run(command(site, "killed", "--workers", "2"), env=both, check=True, capture_output=True)
    assert rows(site, "killed").equals(rows(site, "whole"), null_equal=True)
    assert not list((site.parent / "killed" / "loops").glob(".*"))


def test_a_worker_keeps_nothing_of_what_it_has_done() -> None:
    def kept(dask_worker: Any) -> int:
        return len(dask_worker.profile_history) + int(dask_worker.profile_recent["count"])

    with on_this_machine(1) as workers:
        workers._client.submit(time.sleep, 2.5).result()
        assert list(workers._client.run(kept).values()) == [0]


@pytest.mark.skipif(
    not Path("/proc/self/net/tcp").is_file(), reason="open ports are read in /proc, which only Linux has"
)
def test_nobody_beyond_this_machine_can_connect() -> None:
    with on_this_machine(1):
        own = {link for process in (os.getpid(), *children(os.getpid())) for link in sockets(process)}
        listening = [cells for name in ("tcp", "tcp6") for cells in table(name) if cells[3] == "0A"]
    places = {cells[1].split(":")[0] for cells in listening if f"socket:[{cells[9]}]" in own}
    assert places == {"0100007F"}, "the scheduler and its worker listen at 127.0.0.1 alone"


def sockets(process: int) -> list[str]:
    found = []
    for link in Path(f"/proc/{process}/fd").iterdir():
        with contextlib.suppress(OSError):
            found.append(os.readlink(link))
    return found


def table(name: str) -> list[list[str]]:
    return [line.split() for line in Path(f"/proc/net/{name}").read_text().splitlines()[1:]]


@pytest.mark.slow
def test_a_cluster_over_tls_refuses_a_plain_client(site: Path, tmp_path: Path) -> None:
    certificates(tmp_path)
    both = environment(site)
    files = ["--tls-ca-file", "ca.pem", "--tls-cert", "own.pem", "--tls-key", "own.key"]
    module = [sys.executable, "-m", "distributed.cli.dask_scheduler"]
    scheduler = subprocess.Popen(
        [*module, "--protocol", "tls", "--host", "127.0.0.1", "--port", "0", "--no-dashboard", *files,
         "--scheduler-file", "scheduler.json"], cwd=tmp_path, env=both, stderr=subprocess.DEVNULL)  # fmt: skip
    worker = subprocess.Popen(
        [sys.executable, "-m", "distributed.cli.dask_worker", "--scheduler-file", "scheduler.json", "--nthreads", "1",
         "--no-dashboard", "--host", "127.0.0.1", "--protocol", "tls", *files],
        cwd=tmp_path, env=both, stderr=subprocess.DEVNULL)  # fmt: skip
    try:
        end = time.monotonic() + 60
        while not (tmp_path / "scheduler.json").is_file() and time.monotonic() < end:
            time.sleep(0.2)
        address = json.loads((tmp_path / "scheduler.json").read_text())["address"]
        assert address.startswith("tls://")
        keys = "".join(f'{key} = "{tmp_path / name}"\n' for key, name in NAMES.items())
        text = site.read_text()
        site.write_text(f'{text}\n[cluster]\naddress = "{address}"\n{keys}')
        run = subprocess.run(command(site, "tls"), env=both, capture_output=True, text=True)
        assert run.returncode == 0, run.stderr
        assert set(rows(site, "tls")["status"]) == {"analysed"}
        site.write_text(f'{text}\n[cluster]\naddress = "{address.replace("tls://", "tcp://")}"\n')
        plain = subprocess.run(command(site, "plain"), env=both, capture_output=True, text=True)
        assert plain.returncode == 2 and "no scheduler answers" in plain.stderr
    finally:
        for process in (worker, scheduler):
            process.terminate()
            process.wait(30)


NAMES = {"ca": "ca.pem", "certificate": "own.pem", "key": "own.key"}


def certificates(folder: Path) -> None:
    """An authority, and one certificate of it for client, scheduler and worker."""
    from datetime import UTC, datetime, timedelta

    x509 = pytest.importorskip("cryptography.x509", reason="certificates are made with cryptography: install it")
    from cryptography.hazmat.primitives import hashes, serialization
    from cryptography.hazmat.primitives.asymmetric import ec

    def name(text: str) -> object:
        return x509.Name([x509.NameAttribute(x509.oid.NameOID.COMMON_NAME, text)])

    def made(subject: str, public: object, issuer: str, signer: object, ca: bool) -> bytes:
        now = datetime.now(UTC)
        builder = x509.CertificateBuilder().subject_name(name(subject)).issuer_name(name(issuer)).public_key(public)
        builder = builder.serial_number(x509.random_serial_number()).not_valid_before(now - timedelta(days=1))
        builder = builder.not_valid_after(now + timedelta(days=1))
        builder = builder.add_extension(x509.BasicConstraints(ca=ca, path_length=None), critical=True)
        return builder.sign(signer, hashes.SHA256()).public_bytes(serialization.Encoding.PEM)

    root, own = ec.generate_private_key(ec.SECP256R1()), ec.generate_private_key(ec.SECP256R1())
    (folder / "ca.pem").write_bytes(made("root", root.public_key(), "root", root, True))
    (folder / "own.pem").write_bytes(made("own", own.public_key(), "root", root, False))
    (folder / "own.key").write_bytes(
        own.private_bytes(serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption())
    )


def test_a_cluster_that_does_not_answer(site: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("trueplant.fleet.levels.CONNECT", 1.0)
    with pytest.raises(UsageError, match="no scheduler answers at tcp://127.0.0.1:9"):
        audit(Site.load(site), site.parent / "out", Options(dask="tcp://127.0.0.1:9"))
    with pytest.raises(UsageError, match="must begin with tls://"):
        audit(Site.load(site), site.parent / "out", Options(dask="tcp://10.0.0.1:8786"))
