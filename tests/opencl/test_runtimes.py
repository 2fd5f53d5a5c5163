"""Which runtimes the loader is told of, and what is said of a setting that names none."""

import os
import re
from pathlib import Path

import pytest

from legsim.opencl import runtimes


@pytest.fixture
def clean(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A machine without runtimes of its own, in whose environment nothing is set."""
    monkeypatch.delenv("OCL_ICD_VENDORS", raising=False)
    monkeypatch.delenv("LD_LIBRARY_PATH", raising=False)
    monkeypatch.setattr(runtimes, "_SYSTEM", tmp_path / "system")
    monkeypatch.setattr(runtimes, "_NVIDIA_FOLDERS", (str(tmp_path / "drivers"),))
    monkeypatch.setattr(runtimes, "_in_environment", list)
    monkeypatch.setattr(runtimes, "own_folder", lambda name: made(tmp_path / name))
    for name in ("system", "drivers"):
        (tmp_path / name).mkdir()
    return tmp_path


def made(folder: Path) -> Path:
    folder.mkdir(exist_ok=True)
    return folder


def registered() -> dict[str, str]:
    """Entries that the loader is shown, by name."""
    folder = runtimes.register.__wrapped__()
    return {path.name: path.read_text().strip() for path in Path(folder).glob("*.icd") if folder}


def test_without_runtimes_of_its_own_the_loader_is_left_alone(clean):
    (clean / "system/vendor.icd").write_text("libvendor.so")
    assert runtimes.register.__wrapped__() == ""
    assert "OCL_ICD_VENDORS" not in os.environ


def test_nvidias_driver_without_its_icd_file_is_registered(clean):
    library = clean / "drivers/libnvidia-opencl.so.1"
    library.touch()
    (clean / "system/vendor.icd").write_text("libvendor.so")
    assert registered() == {"nvidia.icd": str(library), "vendor.icd": "libvendor.so"}


def test_nvidias_driver_is_found_through_the_library_path(clean, monkeypatch):
    (clean / "mounted").mkdir()
    (clean / "mounted/libnvidia-opencl.so.1").touch()
    monkeypatch.setenv("LD_LIBRARY_PATH", f"/nowhere::{clean / 'mounted'}")
    assert registered() == {"nvidia.icd": str(clean / "mounted/libnvidia-opencl.so.1")}


def test_a_driver_that_the_system_lists_is_not_registered_twice(clean):
    (clean / "drivers/libnvidia-opencl.so.1").touch()
    (clean / "system/any.icd").write_text("libnvidia-opencl.so.1\n")
    assert registered() == {}


def test_the_environments_and_the_systems_runtimes_are_shown_together(clean, monkeypatch):
    libraries = [clean / "libintelocl.so", clean / "libpocl.so"]
    monkeypatch.setattr(runtimes, "_in_environment", lambda: libraries)
    (clean / "system/vendor.icd").write_text("libvendor.so")
    expected = {"env-0.icd": str(libraries[0]), "env-1.icd": str(libraries[1])}
    assert registered() == expected | {"vendor.icd": "libvendor.so"}
    # the folder that was made is not the user's setting
    assert runtimes.fault() == ""


def test_a_users_own_setting_stays(clean, monkeypatch):
    monkeypatch.setattr(runtimes, "_in_environment", lambda: [clean / "libintelocl.so"])
    monkeypatch.setenv("OCL_ICD_VENDORS", "/mine")
    assert runtimes.register.__wrapped__() == "/mine"


def test_without_a_place_for_the_folder_it_is_said(clean, monkeypatch):
    monkeypatch.setattr(runtimes, "_in_environment", lambda: [clean / "libintelocl.so"])
    monkeypatch.setattr(runtimes, "own_folder", lambda _: None)
    with pytest.warns(UserWarning, match="set TMPDIR to a folder that can"):
        assert runtimes.register.__wrapped__() == ""


@pytest.mark.parametrize(
    ("made", "said"),
    [
        (None, "there is no such folder"),
        ({}, r"it holds no \.icd file"),
        ({"a.icd": "/gone/libx.so\n"}, r"it names /gone/libx\.so, which is not there"),
        ({"a.icd": "libx.so\n"}, r"it names libx\.so, which offers no device"),
        ({"a.icd": b"\xff\xfe"}, "which offers no device"),
    ],
)
def test_a_setting_that_names_no_runtime_is_reported_with_the_fix(
    tmp_path, monkeypatch, made, said
):
    place = tmp_path / "vendors"
    if made is not None:
        place.mkdir()
        for name, content in made.items():
            content = content.encode() if isinstance(content, str) else content
            (place / name).write_bytes(content)
    monkeypatch.setenv("OCL_ICD_VENDORS", str(place))
    assert re.fullmatch(rf"OCL_ICD_VENDORS is '.*': .*{said}; unset it", runtimes.fault())


@pytest.mark.parametrize(
    ("machine", "system", "expected"),
    [
        ("x86_64", "linux", "pip install intel-opencl-rt"),
        ("AMD64", "win32", "pip install intel-opencl-rt"),
        ("aarch64", "linux", "apt install pocl-opencl-icd"),
        ("arm64", "darwin", "conda install -c conda-forge pocl"),
        ("x86_64", "darwin", "conda install -c conda-forge pocl"),
    ],
)
def test_the_named_runtime_exists_for_the_machine(machine, system, expected):
    assert runtimes.installation(machine, system).startswith(expected)
