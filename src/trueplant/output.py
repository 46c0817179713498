"""The results on disk, written as one: a kill at any moment leaves the old files, the new ones, or what `repair` mends.

Every file is first written whole beside its place. Then all are moved there, result.json last: it bears the SHA-256 of
the others. Where that was cut short, the files that wait belong to a result.json that waits with them, and are moved
when the folder is next written to or read; where result.json was not yet whole, nothing had been moved, and what waits
goes.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import re
import secrets
import signal
import tempfile
import threading
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, NoReturn

from trueplant.claims import claim, known_to
from trueplant.errors import OutputError, UsageError
from trueplant.files import runs
from trueplant.printable import escaped_json
from trueplant.project import Project, plant_project
from trueplant.result import Curves, Result, build
from trueplant.result.codec import plain

RESULT, REPORT, PLANT, CURVES, SHIFT = "result.json", "report.html", "plant.toml", "curves.json", "shift.html"
PAGES = (REPORT, SHIFT)
"""Drawn from the others, and drawn again when asked for."""
BESIDE = (*PAGES, PLANT, CURVES)
"""The files that belong to a result.json."""
MOST_SAMPLES = 4000
"""Of each trend in curves.json."""

_WAITING = re.compile(r"\.(?P<name>.+)\.(?P<process>\d+)-(?P<token>[0-9a-f]+)\.part")


def prepare_output(path: str | os.PathLike[str]) -> Path:
    """The folder for results, found to be one that can be written to; nothing is left behind by the check.

    Raises OutputError if the path is a file, lies below one, or cannot be written to.
    """
    folder = Path(path)
    made = _missing(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=folder):
            pass
    except OSError as error:
        _raise(folder, error)
    finally:
        _remove_empty(made)
    return folder


def claim_results(folder: Path, project: Project, force: bool = False) -> None:
    """Raise OutputError where results in the folder would replace a file that is not an earlier result.

    Without `force` that is every file that no earlier run wrote, and with it what the project reads. Also for a folder
    from which plant.toml cannot name the records.
    """
    repair(folder)
    project.to_toml(folder)
    claim([folder / name for name in (*BESIDE, RESULT)], project.files, force, known_to(folder / RESULT))


def write_results(
    result: Result, project: Project, path: str | os.PathLike[str], report: str | None = None
) -> dict[str, Path]:
    """Write curves.json, plant.toml and, given its text, report.html, and result.json last.

    A refusal has no plant.toml. Files of an earlier analysis that this one has no successor for would be taken for this
    one's, and go. Returns the paths by file name. Raises OutputError.
    """
    folder = Path(path)
    texts: dict[str, str] = {}
    if result.curves is not None:
        texts[CURVES] = as_json(plain(result.curves.decimated(MOST_SAMPLES)), indent=None)
    if result.plant is not None and result.status != "refused":
        plant = result.plant
        updated = {(i, j): plant.nominal[i, j] for i, row in plant.rows.items() for j in row.columns}
        texts[PLANT] = plant_project(project, updated, folder)
    if report is not None:
        texts[REPORT] = report
    texts[RESULT] = to_json(result, texts)
    return write_files(folder, texts, gone=[name for name in BESIDE if name not in texts])


def write_page(path: str | os.PathLike[str], name: str, text: str, force: bool = False) -> Path:
    """Write one of the `PAGES` of a saved result, and result.json last, which bears its SHA-256 and says else the same.

    Raises OutputError, as for a page of that name that no earlier run wrote (without `force`).
    """
    folder = results_folder(path)
    claim([folder / name], force=force, known={*known_to(folder / RESULT), _sha256(text.encode("utf-8"))})
    document = json.loads((folder / RESULT).read_text(encoding="utf-8"))
    document["files"] = dict(sorted({**document.get("files", {}), name: _sha256(text.encode("utf-8"))}.items()))
    return write_files(folder, {name: text, RESULT: as_json(document, indent=1)})[name]


def page_unchanged(path: str | os.PathLike[str], name: str, text: str) -> bool:
    """Is this the page that result.json speaks of?"""
    return (_sums(results_folder(path) / RESULT) or {}).get(name) == _sha256(text.encode("utf-8"))


def to_json(result: Result, beside: Mapping[str, str] | None = None) -> str:
    """result.json as text, with the SHA-256 of the files that go with it."""
    document = result.to_dict()
    if beside is not None:
        document["files"] = {name: _sha256(text.encode("utf-8")) for name, text in sorted(beside.items())}
    return as_json(document, indent=1)


def write_files(folder: Path, contents: Mapping[str, str | bytes], gone: list[str] | None = None) -> dict[str, Path]:
    """Write all files or none: first beside their places, then moved there in order. Those in `gone` are removed before
    the last of them."""
    repair(folder)
    token = f"{os.getpid()}-{secrets.token_hex(4)}"
    waiting: dict[Path, Path] = {}
    made = _missing(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name, content in contents.items():
            beside = folder / f".{name}.{token}.part"
            waiting[beside] = folder / name
            with open(beside, "xb") as file:
                file.write(content.encode("utf-8") if isinstance(content, str) else content)
                file.flush()
                os.fsync(file.fileno())
        _move(waiting, [folder / name for name in gone or ()])
    except OSError as error:
        _raise(folder, error)
    finally:
        for beside in waiting:
            beside.unlink(missing_ok=True)
        _remove_empty(made)
    return {place.name: place for place in waiting.values()}


def _missing(folder: Path) -> list[Path]:
    return [path for path in (folder, *folder.parents) if not path.exists()]


def _remove_empty(folders: list[Path]) -> None:
    for folder in folders:
        with contextlib.suppress(OSError):
            folder.rmdir()


def _move(waiting: Mapping[Path, Path], gone: list[Path]) -> None:
    *first, last = waiting.items()
    with _undisturbed():
        for beside, place in first:
            beside.replace(place)
        for place in gone:
            place.unlink(missing_ok=True)
        last[0].replace(last[1])


@contextlib.contextmanager
def _undisturbed() -> Iterator[None]:
    """Ctrl-C waits until this is done."""
    handler = signal.getsignal(signal.SIGINT)
    if not callable(handler) or threading.current_thread() is not threading.main_thread():
        yield
        return
    waiting: list[Any] = []
    signal.signal(signal.SIGINT, lambda *interrupt: waiting.append(interrupt))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, handler)
        for interrupt in waiting[:1]:
            handler(*interrupt)


# -- after a kill ------------------------------------------------------------------------------------------------


def repair(folder: Path) -> None:
    """Finish what an earlier process, killed while it wrote, had begun; remove what it left behind otherwise."""
    groups: dict[str, dict[Path, Path]] = {}
    for beside in folder.glob(".*.part") if folder.is_dir() else ():
        found = _WAITING.fullmatch(beside.name)
        if found and not runs(int(found["process"])):
            groups.setdefault(found["token"], {})[beside] = folder / found["name"]
    for waiting in groups.values():
        _finish(folder, waiting)
        for beside in waiting:
            beside.unlink(missing_ok=True)


def _finish(folder: Path, waiting: Mapping[Path, Path]) -> None:
    """Move what waits if a whole result.json waits with it, and its files are here or wait too."""
    own = next((beside for beside, place in waiting.items() if place.name == RESULT), None)
    sums = {} if own is None else _sums(own)
    if own is None or sums is None:
        return
    others = {beside: place for beside, place in waiting.items() if beside != own and place.name in sums}
    ready = {place.name: _sha256(beside.read_bytes()) for beside, place in others.items()}
    here = {name: ready.get(name) or _sum_of(folder / name) for name in sums}
    if here == sums:
        _move(others | {own: folder / RESULT}, [folder / name for name in BESIDE if name not in sums])


def _sums(result: Path) -> dict[str, str] | None:
    """The SHA-256 of the files that belong to a result.json; None where it is not whole."""
    try:
        return dict(json.loads(result.read_text(encoding="utf-8"))["files"])
    except (OSError, ValueError, KeyError, TypeError):
        return None


def _sum_of(path: Path) -> str | None:
    return _sha256(path.read_bytes()) if path.is_file() else None


# -- read again --------------------------------------------------------------------------------------------------


def results_folder(path: str | os.PathLike[str]) -> Path:
    """The folder of a saved result, which may be named by its result.json."""
    folder = Path(path)
    return folder.parent if folder.is_file() else folder


def read_results(path: str | os.PathLike[str]) -> Result:
    """A saved result: the folder, or its result.json. What is drawn comes from curves.json, without the data.

    Raises UsageError where there is none, it cannot be read, or its files are not of one analysis.
    """
    folder = results_folder(path)
    repair(folder)
    place = folder / RESULT
    try:
        data = json.loads(place.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise UsageError(f"{folder} holds no {RESULT}: name a folder that trueplant run has written to") from None
    except (OSError, ValueError) as error:
        raise UsageError(f"{place} cannot be read ({error}): run the analysis again") from None
    sums = data.get("files", {})
    _check_one_analysis(folder, sums)
    try:
        result = build(Result, data)
        if result.uncertainty is not None:
            result = replace(result, plant=result.uncertainty.plant(result.provenance.time_unit))
        if CURVES in sums and (folder / CURVES).is_file():
            drawn = json.loads((folder / CURVES).read_text(encoding="utf-8"))
            result = replace(result, curves=build(Curves, drawn))
    except (KeyError, TypeError, ValueError) as error:
        raise UsageError(f"{place} is not a result of this version ({error}): run the analysis again") from None
    return result


def _check_one_analysis(folder: Path, sums: Mapping[str, str]) -> None:
    others = {name: digest for name, digest in sums.items() if name not in PAGES}
    mixed = [name for name, digest in others.items() if _sum_of(folder / name) not in (digest, None)]
    if mixed:
        raise UsageError(f"{folder}: {' and '.join(mixed)} and {RESULT} are not of one analysis: run it again")


def as_json(value: Any, indent: int | None = 1) -> str:
    """Plain Python as JSON text that ends with a line end."""
    return escaped_json(json.dumps(value, indent=indent, ensure_ascii=False, allow_nan=False)) + "\n"


def _sha256(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def _raise(folder: Path, error: OSError) -> NoReturn:
    blocking = next((p for p in (folder, *folder.parents) if p.exists() and not p.is_dir()), None)
    if blocking is not None:
        text = f"{folder} cannot be the output folder: {blocking} is a file; name another with --out"
        raise OutputError(text) from None
    reason = error.strerror or str(error)
    raise OutputError(f"cannot write to {folder} ({reason}): name another folder with --out") from None
