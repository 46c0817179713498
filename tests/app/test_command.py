"""The command ``app``: what it opens, and one message for what it cannot."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from trueplant.app.vendor import VENDOR, vendored
from trueplant.cli import main
from trueplant.errors import UsageError

KEY = "0123456789abcdef0123456789abcdef"


def refused(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    assert main(["app", *arguments]) == 2
    said = capsys.readouterr()
    assert said.out == "" and said.err.count("\n") == 1
    return said.err


def test_it_opens_folders_and_projects_only(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "record.csv").write_text("t,y\n")
    for place in (tmp_path / "nothing", tmp_path / "record.csv"):
        assert "neither a folder nor a project file" in refused(capsys, str(place))


@pytest.mark.parametrize(
    "address",
    ["plant.example.com", "ftp://plant.example.com", "https://plant.example.com/app", "https://a b", "https://"],
)
def test_an_address_is_that_of_a_proxy(tmp_path: Path, capsys: pytest.CaptureFixture[str], address: str) -> None:
    assert "https://trueplant.example.com" in refused(capsys, str(tmp_path), "--address", address)


@pytest.mark.parametrize("key", ["", "geheim", "\u00e9" * 40, "a b\n" * 3], ids=["empty", "short", "foreign", "lines"])
def test_a_key_is_long(tmp_path: Path, capsys: pytest.CaptureFixture[str], key: str) -> None:
    file = tmp_path / "proxy.key"
    file.write_text(key)
    said = refused(capsys, str(tmp_path), "--address", "https://a.example", "--proxy-key", str(file))
    assert "32 characters" in said and not (key and key in said)


def test_a_key_goes_with_an_address(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "proxy.key").write_text(KEY)
    assert "--address" in refused(capsys, str(tmp_path), "--proxy-key", str(tmp_path / "proxy.key"))
    said = refused(capsys, str(tmp_path), "--address", "https://a.example", "--proxy-key", str(tmp_path / "none"))
    assert "does not exist" in said


@pytest.mark.parametrize("missing", ["starlette", "uvicorn"])
def test_without_the_extra_it_says_what_to_install(tmp_path: Path, missing: str) -> None:
    script = (
        f"import sys; sys.modules[{missing!r}] = None\n"
        "from trueplant.cli import main; sys.exit(main(['app', sys.argv[1]]))"
    )
    done = subprocess.run([sys.executable, "-c", script, str(tmp_path)], capture_output=True, text=True, timeout=60)
    assert done.returncode == 2 and "pip install 'trueplant[app]'" in done.stderr
    assert done.stderr.count("\n") == 1


def test_without_the_libraries_of_the_pages_it_says_so(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr("trueplant.app.vendor.ROOM", tmp_path / "src" / "trueplant" / "app")
    with pytest.raises(UsageError, match=r"plotly-basic.min.js.*npm ci"):
        vendored("plotly-basic.min.js")


@pytest.mark.slow
def test_the_wheel_has_them_and_their_licences(tmp_path: Path) -> None:
    from zipfile import ZipFile

    root = Path(__file__).parents[2]
    subprocess.run(
        [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(tmp_path)],
        cwd=root,
        check=True,
        capture_output=True,
        timeout=300,
    )
    (wheel,) = tmp_path.glob("*.whl")
    with ZipFile(wheel) as packed:
        for name in VENDOR:
            assert packed.read(f"trueplant/app/vendor/{name}") == vendored(name).read_bytes()
        inside = packed.namelist()
    assert {"trueplant/app/vendor/uPlot.LICENSE", "trueplant/app/vendor/plotly-basic.LICENSE"} <= set(inside)
    assert "trueplant/app/templates/base.html.j2" in inside and "trueplant/app/static/app.js" in inside


def test_the_lock_has_hashes_and_no_addresses() -> None:
    import json

    root = Path(__file__).parents[2]
    lock = json.loads((root / "package-lock.json").read_text())
    libraries = {name: entry for name, entry in lock["packages"].items() if name}
    assert len(libraries) == 2
    for entry in libraries.values():
        assert entry["integrity"].startswith("sha512-") and "resolved" not in entry
    for file in ("package.json", "package-lock.json", *(path.name for path in root.glob("requirements*.txt"))):
        assert "://" not in (root / file).read_text(), file


def test_the_figures_fit_the_library_that_draws_them() -> None:
    import json
    import re

    from plotly.offline import get_plotlyjs

    root = Path(__file__).parents[2]
    own = json.loads((root / "package.json").read_text())["dependencies"]["plotly.js-basic-dist-min"]
    made_for = re.search(r"plotly\.js v([\d.]+)", get_plotlyjs()[:400])
    assert made_for is not None and own.split(".")[0] == made_for[1].split(".")[0]
