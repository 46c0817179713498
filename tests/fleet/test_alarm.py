"""A webhook is told once of what is new; no trouble with it is trouble for the audit, and no secret gets out."""

from __future__ import annotations

import json
import ssl
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path
from typing import Any

import pytest

from trueplant.fleet import Site
from trueplant.fleet.alarm import STATE, acknowledged, sound
from trueplant.fleet.rank import Ranked
from trueplant.fleet.row import ElementRow, LoopRow, Outcome
from trueplant.fleet.store import Store
from trueplant.result import ElementVerdict

TODAY = "2026-10-05T01-00-00Z"
SECRET = "t0ps3cret"


@dataclass
class Receiver:
    """A web server that keeps what is sent to it."""

    url: str
    got: list[dict[str, Any]] = field(default_factory=list)
    answer: int = 204


@pytest.fixture(params=["http", "https"])
def receiver(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Receiver]:
    kept = Receiver("")

    class Handler(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            body = self.rfile.read(int(self.headers["Content-Length"]))
            if kept.answer < 300:
                kept.got.append(json.loads(body))
            self.send_response(kept.answer)
            if kept.answer in (301, 302, 307):
                self.send_header("Location", f"{kept.url}/elsewhere")
            self.end_headers()

        def log_message(self, *_: object) -> None:
            pass

    server = HTTPServer(("127.0.0.1", 0), Handler)
    if request.param == "https":
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        context.load_cert_chain(*certificate(tmp_path))
        server.socket = context.wrap_socket(server.socket, server_side=True)
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    kept.url = f"{request.param}://127.0.0.1:{server.server_port}/hook/{SECRET}"
    yield kept
    server.shutdown()
    thread.join()
    server.server_close()


def certificate(folder: Path) -> tuple[Path, Path]:
    """A certificate of its own for 127.0.0.1, and its key."""
    import ipaddress
    from datetime import UTC, datetime, timedelta

    x509 = pytest.importorskip("cryptography.x509", reason="certificates are made with cryptography: install it")
    from cryptography.hazmat.primitives import hashes, serialization
    from cryptography.hazmat.primitives.asymmetric import ec

    key, now = ec.generate_private_key(ec.SECP256R1()), datetime.now(UTC)
    name = x509.Name([x509.NameAttribute(x509.oid.NameOID.COMMON_NAME, "webhook")])
    address = x509.SubjectAlternativeName([x509.IPAddress(ipaddress.ip_address("127.0.0.1"))])
    made = x509.CertificateBuilder().subject_name(name).issuer_name(name).public_key(key.public_key())
    made = made.serial_number(x509.random_serial_number()).not_valid_before(now - timedelta(days=1))
    made = made.not_valid_after(now + timedelta(days=1)).add_extension(address, critical=False)
    made = made.add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
    (folder / "hook.pem").write_bytes(made.sign(key, hashes.SHA256()).public_bytes(serialization.Encoding.PEM))
    private = key.private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    )
    (folder / "hook.key").write_bytes(private)
    return folder / "hook.pem", folder / "hook.key"


def loop(
    name: str, changed: bool = True, outcome: Outcome = Outcome.ANALYSED, elements: tuple[ElementRow, ...] | None = None
) -> Ranked:
    verdict = ElementVerdict.CHANGED if changed else ElementVerdict.UNCHANGED
    element = ElementRow("y", "u", verdict, "A", 0.5, "loop", "gain +50 %", 0.0, 0.1)
    row = LoopRow(
        "k", outcome, "0", 1.0, 1.0, 60.0, "what is known", elements=(element,) if elements is None else elements
    )
    return Ranked(name, f"{name}.toml", row)


@pytest.fixture
def audited(tmp_path: Path, receiver: Receiver, monkeypatch: pytest.MonkeyPatch) -> Callable[..., list[str]]:
    """Sound the alarm of an audit with these loops; what could not be done."""
    monkeypatch.setenv("HOOK", receiver.url)
    ca = 'ca = "hook.pem"\n' if receiver.url.startswith("https") else ""

    def ring(*loops: Ranked, more: str = "", hook: str = "HOOK", time: str = TODAY) -> list[str]:
        file = tmp_path / "site.toml"
        alarm = f'[alarm]\nwebhook_env = "{hook}"\n{ca}'
        file.write_text(f'name = "Site"\n[[loops]]\nprojects = "*.toml"\n{alarm}{more}', encoding="utf-8")
        site = Site.load(file)
        from datetime import date

        known = acknowledged(site, loops, date.fromisoformat(time[:10]))
        return sound(site, Store(tmp_path / "out"), loops, known, time)

    return ring


def told(receiver: Receiver) -> list[list[tuple[str, str]]]:
    return [[(one["what"], one["loop"]) for one in message["findings"]] for message in receiver.got]


def test_once_per_change(audited: Callable[..., list[str]], receiver: Receiver) -> None:
    assert audited(loop("A"), loop("B", changed=False)) == []
    assert audited(loop("A"), loop("B", changed=False)) == []
    assert told(receiver) == [[("newly changed", "A")]]
    assert receiver.got[0]["text"] == "Site: newly changed: A: u → y" and receiver.got[0]["site"] == "Site"
    audited(loop("A"), loop("B"))
    audited(loop("A", changed=False), loop("B"))
    audited(loop("A"), loop("B"))
    assert told(receiver)[1:] == [[("newly changed", "B")], [("newly changed", "A")]]


def test_failures_are_told_where_wanted(audited: Callable[..., list[str]], receiver: Receiver) -> None:
    audited(loop("A", outcome=Outcome.LATE))
    assert told(receiver) == [[("newly failed", "A")]]
    audited(loop("B", outcome=Outcome.FAILED), more='on = ["newly changed"]\n')
    assert len(receiver.got) == 1


def test_loops_that_were_not_looked_at_are_not_new_again(audited: Callable[..., list[str]], receiver: Receiver) -> None:
    audited(loop("A"), loop("B"))
    audited(loop("B"))  # --only B
    audited(loop("A"), loop("B"))
    assert len(receiver.got) == 1


def test_a_night_without_an_answer_does_not_make_it_new(audited: Callable[..., list[str]], receiver: Receiver) -> None:
    audited(loop("A"))
    audited(loop("A", outcome=Outcome.REFUSED, elements=()))
    audited(loop("A"))
    assert told(receiver) == [[("newly changed", "A")]]


def test_what_is_acknowledged_waits_for_its_date(audited: Callable[..., list[str]], receiver: Receiver) -> None:
    known = '[[acknowledged]]\nloop = "A*"\nuntil = 2026-10-06\n'
    audited(loop("A1"), loop("B"), more=known)
    assert told(receiver) == [[("newly changed", "B")]]
    audited(loop("A1"), loop("B"), more=known, time="2026-10-06T01-00-00Z")
    assert len(receiver.got) == 1
    audited(loop("A1"), loop("B"), more=known, time="2026-10-07T01-00-00Z")
    assert told(receiver)[1:] == [[("newly changed", "A1")]]


@pytest.mark.parametrize("answer", [500, 302])
def test_what_was_not_sent_is_sent_with_the_next(
    audited: Callable[..., list[str]], receiver: Receiver, answer: int
) -> None:
    receiver.answer = answer
    (note,) = audited(loop("A"))
    assert str(answer) in note and "next audit tries again" in note and not receiver.got
    receiver.answer = 204
    assert audited(loop("A")) == []
    assert told(receiver) == [[("newly changed", "A")]]


def test_no_trouble_says_the_secret(
    audited: Callable[..., list[str]], receiver: Receiver, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (unset,) = audited(loop("A"), hook="NOT_SET")
    assert "NOT_SET is not set" in unset
    notes = [unset]
    unusable = (
        f"https://127.0.0.1:1/{SECRET}",
        f"ftp://x/{SECRET}",
        f"https://[broken/{SECRET}",
        f"https://user:{SECRET}@127.0.0.1/",  # urllib takes the password for a port, and quotes it
        f"https://127.0.0.1:1/a {SECRET}",  # http.client quotes a path with a space
        f"http://10.0.0.1/{SECRET}",  # in clear over a network
    )
    for address in unusable:
        monkeypatch.setenv("HOOK", address)
        notes += audited(loop("A"))
    assert len(notes) == 7 and not any(SECRET in note for note in notes), notes
    monkeypatch.setenv("HOOK", receiver.url)
    audited(loop("A"))
    written = [file.read_text() for file in (tmp_path / "out").rglob("*") if file.is_file()]
    assert written and not any(SECRET in text for text in written)
    assert SECRET not in json.dumps(receiver.got)


def test_a_state_that_is_damaged_tells_again(
    audited: Callable[..., list[str]], receiver: Receiver, tmp_path: Path
) -> None:
    audited(loop("A"))
    (tmp_path / "out" / STATE).write_text("{")
    audited(loop("A"))
    assert len(receiver.got) == 2
