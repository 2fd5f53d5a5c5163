"""The store of finished stages: what one folder finished another gets, whole or not at all."""

import errno
import os
from pathlib import Path

import pytest

from legsim.core.errors import LegsimError
from legsim.core.files import key_of
from legsim.run.folder import RunFolder
from legsim.run.store import StageCache, check_shared


def finish(folder: RunFolder, key: str, text: str) -> None:
    def write() -> tuple[str]:
        (folder.path / "numbers.txt").write_text(text)
        return ("numbers.txt",)

    assert folder.cached("count", key, write)


def folders(tmp_path: Path) -> tuple[RunFolder, RunFolder]:
    store = StageCache(tmp_path / "store")
    return RunFolder(tmp_path / "a", {}, store), RunFolder(tmp_path / "b", {}, store)


def test_what_one_folder_finished_another_gets(tmp_path):
    first, second = folders(tmp_path)
    key = key_of(1)
    assert not second.done("count", key)
    finish(first, key, "one")
    assert second.done("count", key)
    assert (second.path / "numbers.txt").read_text() == "one"
    assert second.hash_of("numbers.txt") == first.hash_of("numbers.txt")
    assert second.seconds("count") == first.seconds("count")


def test_another_key_is_another_stage(tmp_path):
    first, second = folders(tmp_path)
    finish(first, key_of(1), "one")
    assert not second.done("count", key_of(2))


def test_writing_anew_in_one_folder_leaves_the_others(tmp_path):
    first, second = folders(tmp_path)
    finish(first, key_of(1), "one")
    assert second.done("count", key_of(1))
    replacement = first.path / "other"
    replacement.write_text("two")
    os.replace(replacement, first.path / "numbers.txt")
    assert not second.done("count", key_of(2))
    assert (second.path / "numbers.txt").read_text() == "one"
    # the changed folder takes the kept file back
    with pytest.warns(UserWarning, match=r"numbers\.txt: is not as the stage"):
        assert first.done("count", key_of(1))
    assert (first.path / "numbers.txt").read_text() == "one"


def test_a_half_filled_place_is_not_believed(tmp_path):
    first, second = folders(tmp_path)
    finish(first, key_of(1), "one")
    (tmp_path / "store" / "count" / key_of(1) / "entry.json").unlink()
    assert not second.done("count", key_of(1))


def test_a_damaged_file_in_the_store_is_not_believed(tmp_path):
    first, second = folders(tmp_path)
    finish(first, key_of(1), "one")
    kept = tmp_path / "store" / "count" / key_of(1) / "numbers.txt"
    kept.unlink()
    kept.write_text("bad")
    assert not second.done("count", key_of(1))
    finish(second, key_of(1), "one")
    third = RunFolder(tmp_path / "c", {}, StageCache(tmp_path / "store"))
    assert third.done("count", key_of(1)), "what was made anew was not kept"
    assert (third.path / "numbers.txt").read_text() == "one"


def test_an_entry_whose_file_is_gone_is_made_anew(tmp_path):
    first, second = folders(tmp_path)
    finish(first, key_of(1), "one")
    (tmp_path / "store" / "count" / key_of(1) / "numbers.txt").unlink()
    assert not second.done("count", key_of(1))
    assert list((tmp_path / "store" / "count").iterdir()) == []


def test_the_second_to_keep_changes_nothing(tmp_path):
    first, second = folders(tmp_path)

    def write_while_the_other_finishes() -> tuple[str]:
        finish(first, key_of(1), "one")
        (second.path / "numbers.txt").write_text("one")
        return ("numbers.txt",)

    assert second.cached("count", key_of(1), write_while_the_other_finishes)
    assert [p.name for p in (tmp_path / "store" / "count").iterdir()] == [key_of(1)]


def test_where_there_are_no_links_files_are_copied(tmp_path, monkeypatch):
    def refuse(*_: object) -> None:
        raise OSError(errno.EPERM, "no links here")

    monkeypatch.setattr(os, "link", refuse)
    first, second = folders(tmp_path)
    finish(first, key_of(1), "one")
    assert second.done("count", key_of(1))
    assert (second.path / "numbers.txt").stat().st_ino != (first.path / "numbers.txt").stat().st_ino


@pytest.mark.parametrize("again", [1, 2])
def test_fetching_twice_leaves_no_partial_files(tmp_path, again):
    first, second = folders(tmp_path)
    finish(first, key_of(1), "one")
    for _ in range(again):
        StageCache(tmp_path / "store").fetch("count", key_of(1), second.path)
    second.close()
    assert sorted(p.name for p in second.path.iterdir()) == ["numbers.txt"]


def test_a_store_to_share_is_made_and_left_empty(tmp_path):
    check_shared(tmp_path / "a" / "store", tmp_path / "b")
    assert list((tmp_path / "a" / "store").iterdir()) == []
    assert list((tmp_path / "b").iterdir()) == []


def test_a_store_on_another_file_system_is_refused(tmp_path, monkeypatch):
    def refuse(*_: object) -> None:
        raise OSError(errno.EXDEV, "Invalid cross-device link")

    monkeypatch.setattr(os, "link", refuse)
    with pytest.raises(
        LegsimError,
        match="hard links, which need one; choose --store and --out on the same file system",
    ):
        check_shared(tmp_path / "a", tmp_path / "b")
    assert list((tmp_path / "a").iterdir()) == []


def test_a_studys_folder_is_no_store_and_a_file_neither(tmp_path):
    (tmp_path / "table1" / "store").mkdir(parents=True)
    with pytest.raises(LegsimError, match=r"is a study's folder, .*; give .*/table1/store$"):
        check_shared(tmp_path / "table1", tmp_path / "b")
    (tmp_path / "file").touch()
    with pytest.raises(LegsimError, match="cannot be shared with"):
        check_shared(tmp_path / "file", tmp_path / "b")


def test_a_full_disk_is_named_and_leaves_nothing_half_kept(tmp_path, monkeypatch):
    first, second = folders(tmp_path)

    def half(source: Path, target: Path) -> None:
        target.write_text(source.read_text()[:2])
        raise OSError(errno.ENOSPC, "No space left on device")

    def no_link(*_: object) -> None:
        raise OSError(errno.EMLINK, "Too many links")

    with monkeypatch.context() as patched:
        patched.setattr("os.link", no_link)
        patched.setattr("shutil.copy2", half)
        with pytest.raises(LegsimError, match=r"store.*: the disk is full; free some space"):
            finish(first, key_of(1), "one")
    assert not list((tmp_path / "store").glob("**/.partial-*"))
    assert not second.done("count", key_of(1))
    # what was computed is still there, and is kept the next time
    assert first.done("count", key_of(1))


def test_what_a_killed_process_left_is_removed_after_a_day_and_nothing_else(tmp_path):
    first, _ = folders(tmp_path)
    finish(first, key_of(1), "one")
    old, new = (tmp_path / "store/count" / f".partial-{name}" for name in ("old", "new"))
    for place in (old, new):
        place.mkdir()
        (place / "numbers.txt").touch()
    os.utime(old, (1e9, 1e9))
    check_shared(tmp_path / "store", tmp_path / "b")
    assert sorted(p.name for p in (tmp_path / "store/count").iterdir()) == [new.name, key_of(1)]


@pytest.mark.parametrize(
    "damage",
    [
        lambda text: "",
        lambda text: "[]",
        lambda text: "[" * 100_000,
        lambda text: text.replace('"files"', '"file"'),
        lambda text: text.replace("numbers.txt", "../numbers.txt"),
        lambda text: text.replace("numbers.txt", "/dev/null"),
        lambda text: text.replace("numbers.txt", "n" * 300),
        lambda text: text.replace("numbers.txt", ""),
        lambda text: text.replace('"sha256": "', '"sha256": "0'),
        lambda text: text.replace('"sha256": "', '"sha": "'),
        lambda text: text.replace('"seconds": ', '"seconds": Infinity, "s": '),
        lambda text: text.replace('"key": "', '"key": "0'),
    ],
)
def test_a_damaged_entry_is_dropped(tmp_path, damage):
    first, second = folders(tmp_path)
    finish(first, key_of(1), "one")
    (entry,) = (tmp_path / "store").rglob("entry.json")
    entry.write_text(damage(entry.read_text()))
    assert not second.done("count", key_of(1))
    assert list(second.path.glob("*.txt")) in ([], [second.path / "numbers.txt"])
    assert not entry.exists()
    finish(second, key_of(1), "one")
    assert entry.exists()
