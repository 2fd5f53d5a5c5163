import json
import os
from collections.abc import Callable
from pathlib import Path

import pytest

from legsim.core import files as core_files
from legsim.core.errors import LegsimError
from legsim.core.files import PREFIX, write_text
from legsim.run import folder as run_folder
from legsim.run.folder import (
    REGISTRATION_ERROR_FILE,
    RunFolder,
    finished_stages,
    head,
    registration_error,
)


def writing(path: Path, text: str) -> Callable[[], tuple[str]]:
    """A stage that writes one file."""

    def make() -> tuple[str]:
        write_text(path, text)
        return (path.name,)

    return make


def test_a_stage_is_done_only_while_key_and_files_are_as_recorded(tmp_path):
    with RunFolder(tmp_path, {"version": "x"}) as folder:
        assert not folder.done("one", "k")
        assert folder.cached("one", "k", writing(tmp_path / "a.txt", "hello"))
    with RunFolder(tmp_path, {"version": "x"}) as again:
        assert again.done("one", "k")
        assert not again.done("one", "other key")
        (tmp_path / "a.txt").write_text("tampered")
        with pytest.warns(
            UserWarning, match=r"a\.txt: is not as the stage 'one' left it; .* again"
        ):
            assert not again.done("one", "k")


def test_a_name_in_the_manifest_that_no_file_has_is_a_file_that_is_gone(tmp_path):
    with RunFolder(tmp_path, {}) as folder:
        folder.cached("one", "k", writing(tmp_path / "a.txt", "hello"))
    manifest = tmp_path / "manifest.json"
    manifest.write_text(manifest.read_text().replace("a.txt", 300 * "a"))
    with RunFolder(tmp_path, {}) as again, pytest.warns(UserWarning, match="aaa: is not as"):
        assert not again.done("one", "k")


def test_a_file_that_was_deleted_or_whose_recorded_hash_is_wrong_is_made_again(tmp_path):
    with RunFolder(tmp_path, {}) as folder:
        folder.cached("one", "k", writing(tmp_path / "a.txt", "hello"))
        (tmp_path / "a.txt").unlink()
        with pytest.warns(UserWarning, match=r"a\.txt: is not as"):
            assert folder.cached("one", "k", writing(tmp_path / "a.txt", "hello"))
    manifest = tmp_path / "manifest.json"
    true = core_files.sha256(tmp_path / "a.txt")
    manifest.write_text(manifest.read_text().replace(true, 64 * "0"))
    with RunFolder(tmp_path, {}) as folder:
        with pytest.warns(UserWarning, match=r"a\.txt: is not as"):
            assert folder.cached("one", "k", writing(tmp_path / "a.txt", "hello"))
        assert folder.hash_of("a.txt") == true
        assert not folder.cached("one", "k", writing(tmp_path / "a.txt", "hello"))


def test_a_damaged_entry_is_made_again(tmp_path):
    with RunFolder(tmp_path, {}) as folder:
        for stage in ("one", "two"):
            folder.cached(stage, "k", writing(tmp_path / f"{stage}.txt", stage))
    content = json.loads((tmp_path / "manifest.json").read_text())
    del content["stages"]["one"]["files"]
    (tmp_path / "manifest.json").write_text(json.dumps(content))
    with RunFolder(tmp_path, {}) as folder:
        assert not folder.done("one", "k")
        assert folder.done("two", "k")


def test_a_stage_that_is_done_is_not_made_again(tmp_path):
    folder = RunFolder(tmp_path, {})
    assert folder.cached("one", "k", writing(tmp_path / "a.txt", "hello"))
    assert not folder.cached("one", "k", writing(tmp_path / "a.txt", "again"))
    assert (tmp_path / "a.txt").read_text() == "hello"
    assert folder.cached("one", "other key", writing(tmp_path / "a.txt", "again"))
    assert (tmp_path / "a.txt").read_text() == "again"


def test_a_stage_that_fails_leaves_no_file_and_no_entry(tmp_path):
    folder = RunFolder(tmp_path, {})

    def fail() -> tuple[str]:
        with core_files.whole(tmp_path / "a.txt") as partial:
            partial.write_text("half")
            raise RuntimeError

    with pytest.raises(RuntimeError):
        folder.cached("one", "k", fail)
    assert not folder.done("one", "k")
    folder.close()
    assert sorted(p.name for p in tmp_path.iterdir()) == []


def test_what_killed_processes_left_goes_and_what_others_are_writing_stays(tmp_path, monkeypatch):
    partial = tmp_path / f"{PREFIX}4711-a.txt"
    partial.write_text("half")
    RunFolder(tmp_path, {}).close()
    assert partial.exists(), "another process may be writing it"
    monkeypatch.setattr(run_folder, "_ABANDONED_S", -1)
    RunFolder(tmp_path, {}).close()
    assert list(tmp_path.iterdir()) == []


def test_manifest_tells_hash_size_and_seconds(tmp_path):
    folder = RunFolder(tmp_path, {"seed": 3})
    folder.cached("one", "k", writing(tmp_path / "a.txt", "hello"))
    manifest = json.loads((tmp_path / "manifest.json").read_text())
    assert manifest["seed"] == 3
    assert manifest["stages"]["one"]["files"]["a.txt"] == {
        "sha256": core_files.sha256(tmp_path / "a.txt"),
        "bytes": 5,
    }


def test_an_unwritable_folder_is_refused(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(LegsimError, match=r"cannot be written to .*--out"):
        RunFolder(tmp_path / "file" / "below", {})


@pytest.mark.parametrize("text", ["{", "[]", '{"stages": 3}', 100_000 * "["])
def test_what_is_no_manifest_is_named_and_leaves_no_lock(tmp_path, text):
    (tmp_path / "manifest.json").write_text(text)
    assert finished_stages(tmp_path) == ()
    assert head(tmp_path) == {}
    with pytest.raises(LegsimError, match=r"manifest\.json: is not a manifest"):
        RunFolder(tmp_path, {})
    assert [p.name for p in tmp_path.iterdir()] == ["manifest.json"]


@pytest.mark.parametrize("text", ["{", "[]", "{}", '{"a": 1}'])
def test_a_damaged_error_of_the_registration_is_named(tmp_path, text):
    assert registration_error(tmp_path) is None
    (tmp_path / REGISTRATION_ERROR_FILE).write_text(text)
    with pytest.raises(LegsimError, match=r"registration-error\.json: cannot be read .*delete"):
        registration_error(tmp_path)


def test_a_second_writer_is_refused_until_the_first_closes(tmp_path):
    with (
        RunFolder(tmp_path, {}),
        pytest.raises(LegsimError, match=f"is in use by process {os.getpid()} on "),
    ):
        RunFolder(tmp_path, {})
    RunFolder(tmp_path, {}).close()
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("first", ["run", "replay", "correct"])
@pytest.mark.parametrize("second", ["run", "replay", "correct"])
def test_a_folder_holds_the_results_of_one_command(tmp_path, first, second):
    with RunFolder(tmp_path, {}, kind=first) as folder:
        folder.cached("one", "k", writing(tmp_path / "a.txt", "hello"))
    if first == second:
        with RunFolder(tmp_path, {}, kind=second) as folder:
            assert folder.done("one", "k")
    else:
        with pytest.raises(
            LegsimError,
            match=f"results of `legsim {first}`, not of `legsim {second}`; .*--out",
        ):
            RunFolder(tmp_path, {}, kind=second)


def test_a_studys_folder_takes_no_run_and_a_runs_folder_no_study(tmp_path):
    (tmp_path / "study.toml").write_text("")
    with pytest.raises(LegsimError, match="results of `legsim study`"):
        RunFolder(tmp_path, {})
    RunFolder(tmp_path / "runs" / "one", {}).write_manifest()
    with pytest.raises(LegsimError, match="results of `legsim run`, not of `legsim study`"):
        run_folder.check_kind(tmp_path / "runs" / "one", "study")


def test_a_folder_of_an_older_version_is_known_by_its_stages(tmp_path):
    for stage, kind in (("replay", "replay"), ("geometry", "run"), ("kinematics", None)):
        content = {"schema": run_folder.SCHEMA, "stages": {stage: {}}}
        (tmp_path / "manifest.json").write_text(json.dumps(content))
        assert run_folder.kind_of(tmp_path) == kind
