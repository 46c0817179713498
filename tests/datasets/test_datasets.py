"""The public example records come from a folder, or from the network and then checked."""

from __future__ import annotations

import threading
from dataclasses import replace
from hashlib import sha256
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from urllib.parse import unquote

import pytest

import trueplant as tp
from trueplant import datasets

OVEN = "pid_oven/20180205-pid-oven-tuning_run2.csv"


@pytest.fixture
def cache(tmp_path, monkeypatch):
    monkeypatch.delenv(datasets.VARIABLE, raising=False)
    monkeypatch.setattr("pooch.os_cache", lambda name: tmp_path / name)
    return tmp_path / "trueplant"


@pytest.fixture
def host(monkeypatch):
    """A server that holds what is put into the dict, and what it was asked for."""
    files: dict[str, bytes] = {}
    asked: list[str] = []

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self):
            asked.append(unquote(self.path))
            body = files.get(asked[-1])
            self.send_response(200 if body is not None else 404)
            self.end_headers()
            self.wfile.write(body or b"")

        def log_message(self, *_):
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    monkeypatch.setattr(datasets, "HOST", f"http://127.0.0.1:{server.server_port}")
    yield files, asked
    server.shutdown()
    server.server_close()
    thread.join()


def _url(name: str) -> str:
    dataset = datasets.REGISTRY[name]
    return f"/{dataset.source.repository}/{dataset.source.commit}/{dataset.upstream}"


def test_folder_comes_first(tmp_path, monkeypatch):
    name = "refinery/FIC10201_1018.csv"
    (tmp_path / "refinery").mkdir()
    (tmp_path / name).write_text("t\n")
    monkeypatch.setenv(datasets.VARIABLE, str(tmp_path))
    with pytest.raises(tp.SourceError, match="not the record that was published"):
        datasets.path(name)
    published = replace(datasets.REGISTRY[name], sha256=sha256(b"t\n").hexdigest())
    monkeypatch.setitem(datasets.REGISTRY, name, published)
    assert datasets.path(name) == tmp_path / name
    with pytest.raises(tp.SourceError, match=f"{OVEN} is not in the folder"):
        datasets.path(OVEN)


def test_unknown_record_is_a_usage_error():
    with pytest.raises(tp.UsageError, match="no example record 'x.csv'"):
        datasets.path("x.csv")


def test_record_is_converted_checked_and_kept(cache, host, monkeypatch):
    files, asked = host
    files[_url(OVEN)] = b"set_c,oven_c,output,ambient_c\n25.000,24.306,55.71,20.493\n25.000,24.171,65.00,20.461\n"
    wanted = b"t,sp,pv,op,ambient\n0.0000,25.0000,24.3060,55.7100,20.4930\n1.0000,25.0000,24.1710,65.0000,20.4610\n"
    known = datasets.REGISTRY[OVEN]
    entry = datasets.Dataset(known.source, sha256(wanted).hexdigest(), known.upstream, known.convert)
    monkeypatch.setitem(datasets.REGISTRY, OVEN, entry)
    file = datasets.path(OVEN)
    assert file.read_bytes() == wanted
    assert file.is_relative_to(cache)
    datasets.path(OVEN)
    assert asked == [_url(OVEN)]
    file.write_bytes(b"damaged")
    assert datasets.path(OVEN).read_bytes() == wanted
    assert [p.name for p in file.parent.iterdir()] == [file.name]


def test_history_of_the_refinery_is_converted(cache, host, monkeypatch):
    name = "refinery/FIC10201_1018.csv"
    files, _ = host
    head = "PROCESSDATA\tx\n8\t10\t2024-10-17 21:55:00\t751\ntagname\ta\tb\tc\td\te\tf\tg\th\n"
    rows = "2024-10-17 21:55:00\t9.11355\t48.1348\t48.0000153\t1\t0\t0\t0\t0\n"
    rows += "2024-10-17 21:55:10\t9\t48\t47\t0\t0\t0\t0\t0\n"
    files[_url(name)] = (head + rows).encode()
    wanted = (
        b"t,time,op,pv,sp,mode\n0.0,2024-10-17 21:55:00,9.11355,48.1348,48.0000153,1\n"
        b"10.0,2024-10-17 21:55:10,9.0,48.0,47.0,0\n"
    )
    known = datasets.REGISTRY[name]
    entry = datasets.Dataset(known.source, sha256(wanted).hexdigest(), known.upstream, known.convert)
    monkeypatch.setitem(datasets.REGISTRY, name, entry)
    assert datasets.path(name).read_bytes() == wanted


def test_other_content_is_never_handed_out(cache, host):
    files, _ = host
    files[_url(OVEN)] = b"25.000,24.306,55.71,20.493\n"
    with pytest.raises(tp.SourceError, match="does not hold the record"):
        datasets.path(OVEN)
    assert [p for p in cache.rglob("*") if p.is_file()] == []


@pytest.mark.usefixtures("cache")
def test_missing_file_and_silent_host_are_source_errors(host, monkeypatch):
    with pytest.raises(tp.SourceError, match="404"):
        datasets.path(OVEN)
    monkeypatch.setattr(datasets, "HOST", "http://127.0.0.1:9")
    with pytest.raises(tp.SourceError, match="try again later"):
        datasets.path(OVEN)


@pytest.mark.usefixtures("cache")
def test_record_that_was_not_published_as_text_says_so():
    with pytest.raises(tp.SourceError, match="MATLAB or Python format.*TRUEPLANT_DATA_DIR"):
        datasets.path("tclab_pid/pid_short_01.csv")


@pytest.mark.real
def test_folder_holds_what_the_checksums_say(real_data):
    for name, dataset in datasets.REGISTRY.items():
        assert sha256((real_data / name).read_bytes()).hexdigest() == dataset.sha256, name
