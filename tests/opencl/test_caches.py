"""Kernel caches where nothing can be written: every command still finds its device."""

import os
import stat
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from legsim.opencl import caches

OPEN = """
from legsim.opencl.device import open_device
import numpy as np
device = open_device()
print(device.download(device.zeros(3), np.ones(3, np.float32)).sum())
"""


def opened(**environment: str) -> str:
    """What a new process prints that opens a device and uses it."""
    result = subprocess.run(
        [sys.executable, "-W", "error", "-c", OPEN],
        env=os.environ | environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.returncode == 0, result.stderr
    return result.stdout + result.stderr


@pytest.mark.parametrize(
    "environment",
    [
        {"XDG_CACHE_HOME": "", "HOME": "/proc/x"},
        {"XDG_CACHE_HOME": "/proc/y"},
        {"XDG_CACHE_HOME": "/dev/null"},
        {"XDG_CACHE_HOME": "/proc/y", "HOME": "/proc/x", "TMPDIR": "/proc/z"},
        {"XDG_CACHE_HOME": "relative", "HOME": "/proc/x"},
    ],
    ids=str,
)
def test_a_device_works_where_no_cache_can_be_made(tmp_path, environment):
    assert opened(**({"TMPDIR": str(tmp_path)} | environment)) == "0.0\n"


def test_a_cache_that_can_be_written_stays_where_it_is(tmp_path):
    opened(XDG_CACHE_HOME=str(tmp_path / "cache"), TMPDIR=str(tmp_path))
    assert (tmp_path / "cache/pyopencl").is_dir()
    assert not list(tmp_path.glob("legsim-cache*"))


def test_a_folder_of_ones_own_is_closed_to_others_and_found_again(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "gettempdir", lambda: str(tmp_path))
    folder = caches.own_folder("mine")
    assert folder is not None
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700
    assert caches.own_folder("mine") == folder


def test_a_link_in_its_place_is_not_followed(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "gettempdir", lambda: str(tmp_path))
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    (tmp_path / "others").mkdir()
    name = f"mine-{os.getuid()}"
    (tmp_path / name).symlink_to(tmp_path / "others")
    folder = caches.own_folder("mine")
    assert folder is not None
    assert folder.name.startswith("mine-")
    assert folder.name != name


def test_without_any_place_there_is_no_folder(monkeypatch):
    def none() -> str:
        raise FileNotFoundError("No usable temporary directory found")

    monkeypatch.setattr(tempfile, "gettempdir", none)
    assert caches.own_folder("mine") is None


def test_files_in_place_of_folders_are_not_writable(tmp_path: Path):
    (tmp_path / "file").touch()
    assert not caches._writable(tmp_path / "file" / "below")
    assert caches._writable(tmp_path / "new" / "below")
