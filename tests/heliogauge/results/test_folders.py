"""Whole folders of any kind; what results add is in test_store."""

import errno
from collections.abc import Iterable
from pathlib import Path

import pytest

from heliogauge.errors import InputError
from heliogauge.results import whole_folder
from heliogauge.results.whole_folder import FolderKind, WholeFolder

PLANS = FolderKind(content="plans", mark="plan.toml", strangers=frozenset({"photo.jpg"}), remedy="take another")
ONCE = FolderKind(content="notes", remedy="take another")


def make(target: Path, kind: FolderKind, text: str, *, force: bool = False) -> None:
    with WholeFolder(target, kind, force=force) as folder:
        (folder / "plan.toml").write_text(text)


def fail(target: Path, error: BaseException) -> None:
    with WholeFolder(target, PLANS) as folder:
        (folder / "plan.toml").write_text("half")
        raise error


def test_an_earlier_folder_is_told_by_its_mark(tmp_path: Path) -> None:
    target = tmp_path / "a"
    make(target, PLANS, "old")
    with pytest.raises(InputError, match="force=True to replace plans"):
        make(target, PLANS, "new")
    make(target, PLANS, "new", force=True)
    assert (target / "plan.toml").read_text() == "new"
    (target / "photo.jpg").touch()
    with pytest.raises(InputError, match="earlier plans only, and this folder holds something else"):
        make(target, PLANS, "newer", force=True)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a"]


def test_what_force_would_refuse_is_not_advised(tmp_path: Path) -> None:
    target = tmp_path / "photos"
    target.mkdir()
    (target / "photo.jpg").touch()
    with pytest.raises(InputError, match=r"holds files already; take another$"):
        make(target, PLANS, "new")


def test_without_a_mark_nothing_is_ever_replaced(tmp_path: Path) -> None:
    make(tmp_path / "a", ONCE, "old")
    with pytest.raises(InputError, match="holds files already; take another"):
        make(tmp_path / "a", ONCE, "new", force=True)
    (tmp_path / "b").mkdir()
    make(tmp_path / "b", ONCE, "first")
    assert (tmp_path / "a" / "plan.toml").read_text() == "old"


@pytest.mark.parametrize("kind", [PLANS, ONCE])
def test_the_folder_one_is_in_is_not_replaced(
    tmp_path: Path, kind: FolderKind, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The shell would stand in a folder that is gone."""
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match="the folder you are in cannot be replaced"):
        make(Path("."), kind, "new", force=True)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EDQUOT, errno.EROFS])
def test_a_full_disk_is_one_clear_message(tmp_path: Path, number: int) -> None:
    with pytest.raises(InputError, match=r"cannot be written .*check permissions and space"):
        fail(tmp_path / "a", OSError(number, "No room"))
    assert list(tmp_path.iterdir()) == []


def test_a_file_of_ours_that_cannot_be_written_is_one_clear_message(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be written"), WholeFolder(tmp_path / "a", PLANS) as folder:
        (folder / "absent" / "plan.toml").write_text("x")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("error", [FileNotFoundError(2, "No such file", "elsewhere"), ConnectionError("lost")])
def test_other_errors_of_the_system_are_not_explained_away(tmp_path: Path, error: OSError) -> None:
    with pytest.raises(type(error)):
        fail(tmp_path / "a", error)
    assert list(tmp_path.iterdir()) == []


def test_a_new_folder_is_on_the_disk_before_its_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """After a power cut a folder with its name and empty files would count as whole."""
    steps: list[str] = []
    rename = Path.rename

    def recorded(paths: Iterable[Path]) -> None:
        steps.append(", ".join(sorted(path.name for path in paths if not path.name.startswith("."))))

    def renamed(path: Path, target: Path) -> Path:
        steps.append(f"rename to {target.name}")
        return rename(path, target)

    monkeypatch.setattr(whole_folder, "put_on_disk", recorded)
    monkeypatch.setattr(Path, "rename", renamed)
    make(tmp_path / "a", PLANS, "new")
    assert steps == ["plan.toml", "rename to a", tmp_path.name]
