"""Projects on disk: changed whole or not at all, taken back, and never over what somebody else has changed."""

from __future__ import annotations

import threading
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from trueplant.app import levels
from trueplant.app.folder import Conflict, Folder, Outside, ProjectFile
from trueplant.errors import OutputError, ProjectError

TEXT = """# what we know
time_unit = "min"

[data]
files = ["record.csv"]

[[output]]
name = "T"
pv = "y"
sp = "r"

[[input]]
name = "F"
op = "u"
"""


@pytest.fixture
def folder(tmp_path: Path) -> Folder:
    root = tmp_path / "plant"
    root.mkdir()
    (root / "a.toml").write_text(TEXT)
    (root / "record.csv").write_text("t,r,y,u\n0,1,1,1\n")
    return Folder(root)


@pytest.fixture
def project(folder: Folder) -> ProjectFile:
    return folder.project("a.toml")


def renamed(name: str) -> object:
    return lambda text: text.replace('name = "T"', f'name = "{name}"')


def test_projects_and_data_are_listed(folder: Folder) -> None:
    for name in ("sub/b.toml", "sub/deep/deeper/deepest/c.toml", ".hidden/d.toml", "a-result/plant.toml"):
        (folder.root / name).parent.mkdir(parents=True, exist_ok=True)
        (folder.root / name).write_text(TEXT)
    (folder.root / "a-result" / "result.json").write_text("{}")
    (folder.root / "pyproject.toml").write_text("[project]\nname = 'x'\n")
    (folder.root / "broken.toml").write_text("[data]\nfiles = [\n")
    (folder.root / "sub" / "week.XLSX").write_bytes(b"PK")
    (folder.root.parent / "outside.toml").write_text(TEXT)
    (folder.root / "link.toml").symlink_to(folder.root.parent / "outside.toml")
    assert folder.projects() == ["a.toml", "broken.toml", "sub/b.toml"]
    assert folder.data_files() == ["record.csv", "sub/week.XLSX"]


def test_a_big_folder_answers(folder: Folder, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(levels, "MOST_FILES", 3)
    for k in range(10):
        (folder.root / f"z{k}.csv").write_text("")
    assert len(folder.data_files()) == 2


@pytest.mark.parametrize("name", ["b.toml", "record.csv", ".", "../a.toml", "a.toml/b.toml", "x" * 5000, "a\0.toml"])
def test_what_is_no_project_is_none(folder: Folder, name: str) -> None:
    with pytest.raises(Outside):
        folder.project(name)


def test_links_in_a_circle_lead_nowhere(folder: Folder) -> None:
    (folder.root / "circle.toml").symlink_to(folder.root / "circle.toml")
    with pytest.raises(Outside):
        folder.project("circle.toml")
    assert folder.projects() == ["a.toml"]


@given(name=st.text(max_size=30) | st.from_regex(r"(\.\./|/|~|\./){1,4}[a-z]{0,5}", fullmatch=True))
@settings(max_examples=200)
def test_every_path_is_inside_or_refused(tmp_path_factory: pytest.TempPathFactory, name: str) -> None:
    folder = Folder(tmp_path_factory.getbasetemp())
    try:
        path = folder.path(name)
    except Outside:
        return
    assert path == folder.root or folder.root in path.parents


def test_a_change_is_written_and_taken_back(project: ProjectFile) -> None:
    first = project.version
    second = project.change(renamed("T1"), first)
    assert 'name = "T1"' in project.text and "# what we know" in project.text
    assert second == project.version != first
    assert project.can_undo and not project.can_redo
    third = project.change(renamed("x"))  # no such text any more: nothing is changed
    assert third == second
    assert project.undo() == first and project.text == TEXT
    assert project.can_redo and not project.can_undo
    assert project.redo() == second
    with pytest.raises(Conflict, match="nothing to redo"):
        project.redo()
    assert not list(project.path.parent.glob(".*"))


def test_two_views_of_a_project_share_its_history(folder: Folder) -> None:
    folder.project("a.toml").change(renamed("T1"))
    assert folder.project("./a.toml").can_undo
    folder.project("a.toml").undo()
    assert folder.project("a.toml").text == TEXT


def test_a_change_from_an_older_page_is_a_conflict(project: ProjectFile) -> None:
    shown = project.version
    project.change(renamed("T1"), shown)
    with pytest.raises(Conflict, match="nothing was overwritten"):
        project.change(renamed("T2"), shown)
    assert 'name = "T1"' in project.text


def test_what_another_program_wrote_is_not_taken_back(project: ProjectFile) -> None:
    project.change(renamed("T1"))
    project.path.write_text(TEXT + "\n# by hand\n")
    assert not project.can_undo
    with pytest.raises(Conflict, match="another program"):
        project.undo()
    assert "# by hand" in project.text
    project.change(renamed("T3"))
    project.undo()
    assert project.text == TEXT + "\n# by hand\n"
    assert not project.can_undo


def test_what_another_program_writes_meanwhile_stays(project: ProjectFile) -> None:
    def edit(text: str) -> str:
        project.path.write_text(TEXT + "# meanwhile\n")
        return text.replace('"T"', '"T1"')

    with pytest.raises(Conflict, match="being changed"):
        project.change(edit)
    assert project.text == TEXT + "# meanwhile\n"
    assert not project.can_undo


@pytest.mark.parametrize(
    ("bad", "says"),
    [("[data", "a.toml.*TOML"), (TEXT.replace('"min"', '"parsec"'), "a.toml.*time_unit"), (TEXT + "[x]\n", "x")],
)
def test_what_is_no_project_is_not_written(project: ProjectFile, bad: str, says: str) -> None:
    with pytest.raises(ProjectError, match=says) as refused:
        project.change(lambda text: bad)
    assert "project.toml" not in str(refused.value)
    assert project.text == TEXT and not project.can_undo
    project.change(lambda text: bad, check=False)
    assert project.text == bad


def test_many_at_once_lose_nothing(project: ProjectFile) -> None:
    def add(k: int) -> None:
        project.change(lambda text: f"{text}# {k}\n")

    threads = [threading.Thread(target=add, args=(k,)) for k in range(20)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sorted(project.text.removeprefix(TEXT).split("\n")[:-1]) == sorted(f"# {k}" for k in range(20))
    for _ in range(20):
        project.undo()
    assert project.text == TEXT


def test_of_two_changes_of_one_version_one_is_a_conflict(project: ProjectFile) -> None:
    shown, ended = project.version, []

    def change(k: int) -> None:
        try:
            project.change(lambda text: f"{text}# {k}\n", shown)
            ended.append("written")
        except Conflict:
            ended.append("conflict")

    threads = [threading.Thread(target=change, args=(k,)) for k in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sorted(ended) == ["conflict"] * 7 + ["written"]


@pytest.mark.parametrize("ends", ["\n", "\r\n"])
@pytest.mark.parametrize("mark", ["", "\ufeff"])
def test_line_ends_and_mark_stay(project: ProjectFile, ends: str, mark: str) -> None:
    before = (mark + TEXT.replace("\n", ends)).encode()
    project.path.write_bytes(before)
    project.change(renamed("T1"))
    assert project.content == before.replace(b'"T"', b'"T1"')
    project.load()


def test_permissions_stay(project: ProjectFile) -> None:
    project.path.chmod(0o640)
    project.change(renamed("T1"))
    assert project.path.stat().st_mode & 0o777 == 0o640


def test_a_failed_write_leaves_the_old(project: ProjectFile, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(number: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.fsync", full)
    with pytest.raises(OutputError, match="No space left.*nothing was changed"):
        project.change(renamed("T1"))
    assert project.text == TEXT and not project.can_undo
    assert not list(project.path.parent.glob(".*"))


@pytest.mark.parametrize(
    "reads", ['["../secret.csv"]', '["/etc/passwd"]', '["link.csv"]', '["record.csv", "sub/../../secret.csv"]']
)
def test_a_project_reads_nothing_outside(folder: Folder, reads: str) -> None:
    (folder.root.parent / "secret.csv").write_text("t,r,y,u\n")
    (folder.root / "link.csv").symlink_to(folder.root.parent / "secret.csv")
    project = folder.project("a.toml")
    with pytest.raises(Outside, match="outside of the folder"):
        project.change(lambda text: text.replace('["record.csv"]', reads))
    project.path.write_text(TEXT.replace('["record.csv"]', reads))
    with pytest.raises(Outside, match="outside of the folder"):
        project.load()


def test_a_model_from_outside_is_not_even_read(folder: Folder) -> None:
    (folder.root.parent / "secret.csv").write_text("root:x:0:0\n")
    element = '\n[[model]]\noutput = "T"\ninput = "F"\nstep = "../secret.csv"\nsample_time = 1\n'
    project = folder.project("a.toml")
    with pytest.raises(Outside) as refused:
        project.change(lambda text: text + element)
    assert "root:x" not in str(refused.value)


def test_results_are_not_written_through_a_link(folder: Folder) -> None:
    (folder.root / "a-result").symlink_to(folder.root.parent)
    with pytest.raises(Outside):
        _ = folder.project("a.toml").out


def test_messages_do_not_say_where_the_folder_lies(folder: Folder) -> None:
    project = folder.project("a.toml")
    project.path.write_text(TEXT + "[x]\n")
    with pytest.raises(ProjectError) as refused:
        project.load()
    assert folder.plain(str(refused.value)).startswith("a.toml")
