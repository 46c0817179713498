"""The results on disk: each file is written beside its place and then renamed, so none is ever half there."""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import NoReturn

from trueplant.errors import OutputError
from trueplant.project.project import Project
from trueplant.result import Result

RESULT, REPORT, PLANT = "result.json", "report.html", "plant.toml"


def prepare_output(path: str | os.PathLike[str]) -> Path:
    """The folder for results, found to be one that can be written to; nothing is left behind by the check.

    Raises OutputError if the path is a file, lies below one, or cannot be written to.
    """
    folder = Path(path)
    made = [p for p in (folder, *folder.parents) if not p.exists()]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=folder):
            pass
    except OSError as error:
        _raise(folder, error)
    finally:
        for parent in made:
            if parent.is_dir():
                parent.rmdir()
    return folder


def write_results(
    result: Result, path: str | os.PathLike[str], report: str | None = None, origin: str | os.PathLike[str] = "."
) -> dict[str, Path]:
    """Write result.json, plant.toml and, given its text, report.html; what of them is not there now is removed.

    ``origin`` is the folder at which relative paths of ``result.plant_toml`` start: in the file they start at ``path``.
    A refusal has no plant.toml. Files of an earlier analysis that this one has no successor for would be taken for this
    one's. Returns the paths by file name. Raises OutputError.
    """
    texts = {RESULT: to_json(result)}
    folder = Path(path)
    if result.plant_toml and result.status != "refused":
        texts[PLANT] = Project.from_toml(result.plant_toml, origin).to_toml(folder)
    if report is not None:
        texts[REPORT] = report
    written = write_files(folder, texts)
    for name in (RESULT, REPORT, PLANT):
        if name not in texts:
            (folder / name).unlink(missing_ok=True)
    return written


def to_json(result: Result) -> str:
    """result.json as text."""
    return json.dumps(result.to_dict(), indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def write_files(folder: Path, contents: Mapping[str, str | bytes]) -> dict[str, Path]:
    """Write all files or none: first beside their places, then renamed."""
    waiting: dict[Path, Path] = {}
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name, content in contents.items():
            handle, temporary = tempfile.mkstemp(prefix=f".{name}.", suffix=".part", dir=folder)
            waiting[Path(temporary)] = folder / name
            with os.fdopen(handle, "wb") as file:
                file.write(content.encode("utf-8") if isinstance(content, str) else content)
                os.fchmod(file.fileno(), 0o644)
        for beside, place in waiting.items():
            beside.replace(place)
    except OSError as error:
        _raise(folder, error)
    finally:
        for beside in waiting:
            beside.unlink(missing_ok=True)
    return {place.name: place for place in waiting.values()}


def _raise(folder: Path, error: OSError) -> NoReturn:
    blocking = next((p for p in (folder, *folder.parents) if p.exists() and not p.is_dir()), None)
    if blocking is not None:
        text = f"{folder} cannot be the output folder: {blocking} is a file; name another with --out"
        raise OutputError(text) from None
    reason = error.strerror or str(error)
    raise OutputError(f"cannot write to {folder} ({reason}): name another folder with --out") from None
