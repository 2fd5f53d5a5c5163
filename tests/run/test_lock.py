"""The lock of a folder: one writer, named to the second one; no trace where it ends, in any way."""

import errno
import os
import signal
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from legsim.core.errors import LegsimError
from legsim.run import lock
from legsim.run.lock import FolderLock

HOLD = """
import sys, time
from pathlib import Path
from legsim.run import lock
def refuse(_):
    raise OSError(lock.errno.ENOLCK, "No locks available")
if sys.argv[2] == "without":
    lock._lock = refuse
with lock.FolderLock(Path(sys.argv[1])):
    print("held", flush=True)
    time.sleep(60)
"""


@pytest.fixture(params=["with", "without"])
def locks(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """A file system with locks, and one without."""
    if request.param == "without":

        def refuse(_: object) -> None:
            raise OSError(errno.ENOLCK, "No locks available")

        monkeypatch.setattr(lock, "_lock", refuse)
    return request.param


def holder(folder: Path, locks: str) -> subprocess.Popen:
    """Another process that holds the folder."""
    command = [sys.executable, "-c", HOLD, str(folder), locks]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    assert process.stdout.readline() == "held\n"
    return process


def test_a_second_process_is_refused_naming_the_first_until_that_is_killed(tmp_path, locks):
    process = holder(tmp_path, locks)
    name = f"process {process.pid} on {socket.gethostname()}"
    try:
        with pytest.raises(LegsimError, match=f"is in use by {name}; wait until") as refused:
            FolderLock(tmp_path)
        assert "\n" not in str(refused.value)
    finally:
        os.kill(process.pid, signal.SIGKILL)
        process.communicate()
    with pytest.warns(UserWarning, match=f"{name} ended there before it was finished"):
        FolderLock(tmp_path).release()
    FolderLock(tmp_path).release()
    assert list(tmp_path.iterdir()) == []


def test_this_process_is_refused_too_while_it_holds_the_folder(tmp_path, locks):
    with FolderLock(tmp_path):
        with pytest.raises(LegsimError, match=f"is in use by process {os.getpid()} on"):
            FolderLock(tmp_path)
        assert len(list(tmp_path.iterdir())) == 1
    assert list(tmp_path.iterdir()) == []


def test_a_lock_that_nobody_holds_any_more_is_released(tmp_path, locks):
    FolderLock(tmp_path)
    with FolderLock(tmp_path):
        pass
    assert list(tmp_path.iterdir()) == []


def test_a_claim_of_another_machine_is_not_taken_over_and_the_file_is_named(tmp_path, monkeypatch):
    def refuse(_: object) -> None:
        raise OSError(errno.EOPNOTSUPP, "Operation not supported")

    monkeypatch.setattr(lock, "_lock", refuse)
    (tmp_path / lock._CLAIM).write_text("process 1 on elsewhere")
    with pytest.raises(LegsimError, match=r"process 1 on elsewhere; .*delete \.in-use-here"):
        FolderLock(tmp_path)


def test_a_lock_file_removed_by_its_last_holder_is_not_mistaken_for_the_folders(
    tmp_path, monkeypatch
):
    """Between opening and locking the file the last holder removes it, and a third takes a new one."""
    real, others = lock._lock, []

    def late(stream: object) -> None:
        monkeypatch.setattr(lock, "_lock", real)
        (tmp_path / lock.LOCK).unlink()
        others.append(FolderLock(tmp_path))
        real(stream)

    monkeypatch.setattr(lock, "_lock", late)
    with pytest.raises(LegsimError, match="is in use by process"):
        FolderLock(tmp_path)
    others[0].release()


def test_a_name_that_is_not_utf8_is_refused_in_words(tmp_path):
    folder = Path(os.fsdecode(os.fsencode(tmp_path) + b"/bad\xff"))
    folder.mkdir()
    with FolderLock(folder), pytest.raises(LegsimError) as refused:
        FolderLock(folder)
    assert str(refused.value).encode("utf-8")
