"""The folder that the app was opened on: its projects and data, and changes to a project that can be taken back."""

from __future__ import annotations

import hashlib
import os
import secrets
import threading
import tomllib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

from trueplant.app import levels
from trueplant.errors import OutputError, ProjectError, TrueplantError, UsageError
from trueplant.files import contents
from trueplant.output import RESULT, read_results
from trueplant.project import Project
from trueplant.project.document import with_moved_paths
from trueplant.record.readers import FORMATS
from trueplant.result import Result

BOM = "\ufeff"
SUFFIXES = (".csv", ".txt", ".tsv", ".dat", *(ending for form in FORMATS.values() for ending in form.endings))


class Outside(UsageError):
    """A path that leads out of the folder, or to nothing."""


class Conflict(UsageError):
    """The project has changed since it was shown."""


@dataclass
class _History:
    """What a project was before and after each change; only as long as nobody else changed it."""

    lock: threading.RLock = field(default_factory=threading.RLock)
    back: list[bytes] = field(default_factory=list)
    forth: list[bytes] = field(default_factory=list)
    latest: bytes | None = None
    """What the last change wrote."""


class Folder:
    """What the app may read and write: all below `root`, wherever links lead."""

    def __init__(self, root: Path) -> None:
        self.root = root.resolve()
        self._histories: dict[Path, _History] = {}
        self._lock = threading.Lock()

    def path(self, name: str) -> Path:
        """A path inside, with links followed. Raises Outside."""
        if not name or "\0" in name:
            raise Outside("no file is named")
        try:
            found = (self.root / name).resolve()
            found.exists()
        except (OSError, RuntimeError, ValueError):  # links in a circle, names that are too long
            raise Outside(f"{name} cannot be found") from None
        if not found.is_relative_to(self.root):
            raise Outside(f"{name} is outside of the folder that was opened; open the folder that holds it")
        return found

    def name(self, path: Path) -> str:
        """Of a path inside, relative, with forward slashes."""
        return path.resolve().relative_to(self.root).as_posix()

    def projects(self) -> list[str]:
        """Project files, also such as need mending; not those that are results."""
        found = (path for path in self._walk() if path.suffix == ".toml" and not (path.parent / RESULT).exists())
        return sorted(self.name(path) for path in found if _is_project(path))

    def data_files(self) -> list[str]:
        """Files that the readers may know, by their names."""
        return sorted(self.name(path) for path in self._walk() if path.suffix.lower() in SUFFIXES)

    def project(self, name: str) -> ProjectFile:
        """Raises Outside where there is no such file."""
        path = self.path(name)
        if not path.is_file() or path.suffix != ".toml":
            raise Outside(f"there is no project file {name} in this folder")
        with self._lock:
            history = self._histories.setdefault(path, _History())
        return ProjectFile(self, self.name(path), path, history)

    def plain(self, message: str) -> str:
        """A message without the place of the folder on this machine, which a page need not know."""
        return message.replace(f"{self.root}{os.sep}", "").replace(str(self.root), "the folder")

    def _walk(self) -> Iterator[Path]:
        count = 0
        for place, folders, files in os.walk(self.root):
            depth = len(Path(place).relative_to(self.root).parts)
            folders[:] = sorted(f for f in folders if not f.startswith(".") and depth < levels.DEEPEST)
            for name in sorted(files):
                path = Path(place, name)
                if name.startswith(".") or not _is_inside(path, self.root):
                    continue
                count += 1
                if count > levels.MOST_FILES:
                    return
                yield path


@dataclass(frozen=True)
class ProjectFile:
    """A project file on disk. Nothing of it is kept: each question reads it anew."""

    folder: Folder
    name: str
    path: Path
    history: _History = field(repr=False)

    @property
    def content(self) -> bytes:
        return contents(self.path, ProjectError)

    @property
    def text(self) -> str:
        """As it stands, without a byte order mark. Raises ProjectError."""
        return _decoded(self.content, self.name)

    @property
    def version(self) -> str:
        """SHA-256 of the file, as result.json has it of the project that was analysed."""
        return hashlib.sha256(self.content).hexdigest()

    def load(self) -> Project:
        """The project, checked. Raises ProjectError, and Outside where it reads what is not in the folder."""
        self._confined(self.text)
        return Project.load(self.path)

    def change(self, edit: Callable[[str], str], version: str | None = None, check: bool = True) -> str:
        """Write what `edit` makes of the text, and return its version; `undo` takes it back.

        Raises Conflict where `version` is not that of the file, and ProjectError where the new text is no project
        (unless `check` is False); then nothing was written.
        """
        with self.history.lock:
            before = self.content
            if version is not None and hashlib.sha256(before).hexdigest() != version:
                raise Conflict(
                    f"{self.name} has changed since this page was opened (in another tab, or by another program): "
                    "load the page again and make the change there; nothing was overwritten"
                )
            text = _decoded(before, self.name)
            after = edit(text)
            if after == text:
                return hashlib.sha256(before).hexdigest()
            if check:
                self._checked(after)
            content = (BOM if before.startswith(BOM.encode()) else "").encode() + after.encode("utf-8")
            back = [*self.history.back, before] if before == self.history.latest else [before]
            version = self._write(before, content)
            self.history.back[:], self.history.forth[:] = back[-levels.UNDO :], []
            return version

    @property
    def can_undo(self) -> bool:
        return bool(self.history.back) and self._is_latest()

    @property
    def can_redo(self) -> bool:
        return bool(self.history.forth) and self._is_latest()

    def undo(self) -> str:
        """Take the last change back. Raises Conflict where there is none, or another program has changed the file."""
        return self._step(self.history.back, self.history.forth, "undo")

    def redo(self) -> str:
        """Make the change again that was taken back."""
        return self._step(self.history.forth, self.history.back, "redo")

    @property
    def out(self) -> Path:
        """Where ``trueplant run`` writes by default, when it is called where the project lies. Raises Outside."""
        return self.folder.path(str(self.path.with_name(f"{self.path.stem}-result").relative_to(self.folder.root)))

    def result(self) -> Result | None:
        """What was saved there; None if nothing was. Raises UsageError where it cannot be read."""
        return read_results(self.out) if (self.out / RESULT).is_file() else None

    def _is_latest(self) -> bool:
        try:
            return self.content == self.history.latest
        except TrueplantError:
            return False

    def _step(self, source: list[bytes], target: list[bytes], word: str) -> str:
        with self.history.lock:
            before = self.content
            if not source:
                raise Conflict(f"there is nothing to {word}")
            if before != self.history.latest:
                raise Conflict(f"{self.name} was changed by another program since: there is nothing to {word}")
            version = self._write(before, source[-1])
            source.pop()
            target.append(before)
            return version

    def _confined(self, text: str) -> None:
        """Raise Outside where the project reads something that is not in the folder; before anything is read."""
        named: list[str] = []

        def note(path: str) -> str:
            named.append(path)
            return path

        try:
            with_moved_paths(text, note)
        except Exception:  # no TOML, or of another shape: then it is no project, which is said better elsewhere
            return
        for name in named:
            if not name.startswith("dataset:") and not _is_inside(self.path.parent / name, self.folder.root):
                raise Outside(
                    f"{self.name} reads {name}, which is outside of the folder that was opened: "
                    "open the folder that holds both, or copy the file into this one"
                )

    def _checked(self, text: str) -> None:
        self._confined(text)
        try:
            Project.from_toml(text, self.path.parent)
        except ProjectError as error:  # which speaks of text that has no file yet
            said = str(error).replace(str(self.path.parent / "project.toml"), self.name)
            raise ProjectError(said) from None

    def _write(self, before: bytes, after: bytes) -> str:
        """Whole or not at all; what another program wrote meanwhile stays."""
        beside = self.path.with_name(f".{self.path.name}.{os.getpid()}-{secrets.token_hex(4)}.part")
        try:
            with open(beside, "xb") as file:
                file.write(after)
                file.flush()
                os.fsync(file.fileno())
            beside.chmod(self.path.stat().st_mode & 0o777)
            if self.content != before:
                raise Conflict(f"{self.name} is being changed by another program: load the page again")
            beside.replace(self.path)
        except OSError as error:
            raise OutputError(
                f"{self.name} cannot be written ({error.strerror or error}); nothing was changed"
            ) from None
        finally:
            beside.unlink(missing_ok=True)
        self.history.latest = after
        return hashlib.sha256(after).hexdigest()


def _is_inside(path: Path, root: Path) -> bool:
    try:
        return path.resolve().is_relative_to(root)
    except (OSError, RuntimeError, ValueError):  # links in a circle, names that are too long
        return False


def _decoded(content: bytes, name: str) -> str:
    try:
        return content.decode("utf-8").removeprefix(BOM)
    except UnicodeDecodeError as error:
        line = content[: error.start].count(b"\n") + 1
        raise ProjectError(f"{name}, line {line}: is not UTF-8 text: save the project file as UTF-8") from None


def _is_project(path: Path) -> bool:
    try:
        if path.stat().st_size > levels.PROJECT_BYTES:
            return False
        text = path.read_bytes().decode("utf-8").removeprefix(BOM)
    except (OSError, UnicodeDecodeError):
        return False
    try:
        tables = tomllib.loads(text)
    except (tomllib.TOMLDecodeError, RecursionError):
        return "[data]" in text or "[[output]]" in text  # it is to be mended, so it is shown
    return "output" in tables or "data" in tables
