import errno
import fcntl
import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from legsim.core import files as core_files
from legsim.core.errors import LegsimError
from legsim.core.files import PREFIX, write_text
from legsim.run import folder
from legsim.run import folder as run_folder
from legsim.run.folder import RunFolder


def writing(path: Path, text: str) -> Callable[[], tuple[str]]:
    """A stage that writes one file."""

    def make() -> tuple[str]:
        write_text(path, text)
        return (path.name,)

    return make


def test_a_stage_is_done_only_while_key_and_files_are_as_recorded(tmp_path):
    folder = RunFolder(tmp_path, {"version": "x"})
    assert not folder.done("one", "k")
    assert folder.cached("one", "k", writing(tmp_path / "a.txt", "hello"))
    again = RunFolder(tmp_path, {"version": "x"})
    assert again.done("one", "k")
    assert not again.done("one", "other key")
    (tmp_path / "a.txt").write_text("tampered")
    assert not again.done("one", "k")


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
    assert sorted(p.name for p in tmp_path.iterdir()) == []
    assert not folder.done("one", "k")


def test_what_killed_processes_left_goes_and_what_others_are_writing_stays(tmp_path, monkeypatch):
    partial = tmp_path / f"{PREFIX}4711-a.txt"
    partial.write_text("half")
    RunFolder(tmp_path, {})
    assert partial.exists(), "another process may be writing it"
    monkeypatch.setattr(run_folder, "_ABANDONED_S", -1)
    RunFolder(tmp_path, {})
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


def test_a_broken_manifest_is_named(tmp_path):
    (tmp_path / "manifest.json").write_text("{")
    with pytest.raises(LegsimError, match=r"manifest\.json: is not a manifest"):
        RunFolder(tmp_path, {})


HOLD = """
import sys, time
from pathlib import Path
from legsim.run.folder import sole_use
with sole_use(Path(sys.argv[1])):
    print("held", flush=True)
    time.sleep(60)
"""


def test_a_second_process_is_told_of_the_first_until_that_is_killed(tmp_path):
    process = subprocess.Popen(
        [sys.executable, "-c", HOLD, str(tmp_path)], stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "held\n"
    with (
        pytest.raises(
            LegsimError,
            match=f"is in use by process {process.pid} on .*; wait until that has ended",
        ),
        folder.sole_use(tmp_path),
    ):
        pass
    os.kill(process.pid, signal.SIGKILL)
    process.communicate()
    for _ in range(2):
        with folder.sole_use(tmp_path):
            pass


def test_a_file_system_without_locks_is_told_and_used(tmp_path, monkeypatch):
    def refuse(*_: object) -> None:
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr(fcntl, "flock", refuse)
    with pytest.warns(UserWarning, match="has no locks"), folder.sole_use(tmp_path):
        pass
