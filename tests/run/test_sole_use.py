"""A folder has one user at a time, whoever is killed."""

import errno
import fcntl
import os
import signal
import subprocess
import sys

import pytest

from legsim.core.errors import LegsimError
from legsim.run import folder

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
