import dataclasses
import importlib.metadata
import os
import shutil

import pytest

from legsim.cli import doctor
from legsim.opencl import discovery, textures


def findings(folder, topic: str) -> dict[str, doctor.Finding]:
    """By the second word of their topic."""
    return {
        f.topic.partition(" ")[2]: f for f in doctor.examine(folder) if f.topic.startswith(topic)
    }


def test_it_looks_at_devices_memory_disk_and_viewer(tmp_path):
    findings = doctor.examine(tmp_path / "not" / "there" / "yet")
    topics = {f.topic.split(" ")[0] for f in findings}
    assert {"python", "package", "opencl", "memory", "disk", "models", "rerun"} <= topics
    assert all(f.cure for f in findings if not f.good)


def test_a_device_that_fails_the_probe_is_reported_with_its_reason(tmp_path, monkeypatch):
    broken = dataclasses.replace(
        discovery.candidates()[0], seconds=None, failure="unknown target CPU"
    )
    monkeypatch.setattr(discovery, "candidates", lambda: (broken,))
    found = [f for f in doctor.examine(tmp_path) if f.topic.startswith("opencl")]
    assert not any(f.good for f in found)
    assert any("unknown target CPU" in f.detail for f in found)
    assert any("pip install" in f.cure for f in found)


@pytest.mark.parametrize(
    ("fault", "said"),
    [("", "images through texture units"), ("it is blind", "images from buffers, as it is blind")],
)
def test_of_a_gpu_it_says_how_images_are_read(tmp_path, monkeypatch, fault, said):
    gpu = dataclasses.replace(discovery.candidates()[0], kind="gpu")
    monkeypatch.setattr(discovery, "candidates", lambda: (gpu,))
    monkeypatch.setattr(textures, "check", lambda _: textures.TextureReads(fault, 0.0))
    (found,) = findings(tmp_path, "opencl").values()
    assert found.good
    assert said in found.detail


@pytest.mark.parametrize(
    ("wanted", "good", "said"),
    [
        ("off", True, "images from buffers, as LEGSIM_TEXTURES is off"),
        ("on", True, "images through texture units"),
        ("maybe", False, "LEGSIM_TEXTURES is 'maybe'"),
    ],
)
def test_what_the_environment_says_of_textures_is_reported(
    tmp_path, monkeypatch, wanted, good, said
):
    gpu = dataclasses.replace(discovery.candidates()[0], kind="gpu")
    monkeypatch.setenv("LEGSIM_TEXTURES", wanted)
    monkeypatch.setattr(discovery, "candidates", lambda: (gpu,))
    monkeypatch.setattr(textures, "check", lambda _: textures.TextureReads("", 0.0))
    (found,) = findings(tmp_path, "opencl").values()
    assert found.good is good
    assert said in found.detail


def test_packages_are_those_that_the_installation_asks_for(tmp_path, monkeypatch):
    asked = [
        "numpy>=2.2",
        "scipy<1.0",
        "no-such-package>=1",
        "ezc3d>=1.6; extra == 'dev'",
        "elsewhere; sys_platform == 'amiga'",
    ]
    monkeypatch.setattr(importlib.metadata, "requires", lambda _: asked)
    found = findings(tmp_path, "package")
    assert list(found) == ["legsim", "numpy", "scipy", "no-such-package"]
    assert found["numpy"].good
    assert found["scipy"].detail.endswith("but <1.0 is needed")
    assert not found["scipy"].good
    assert (found["no-such-package"].good, found["no-such-package"].cure) == (
        False,
        "pip install 'no-such-package>=1'",
    )


@pytest.mark.parametrize(("free", "writable"), [(3 * 2**30, True), (5 * 2**30, False)])
def test_a_disk_that_is_full_or_closed_is_reported(tmp_path, monkeypatch, free, writable):
    monkeypatch.setattr(shutil, "disk_usage", lambda _: type("Usage", (), {"free": free}))
    monkeypatch.setattr(os, "access", lambda *_: writable)
    (disk,) = findings(tmp_path, "disk").values()
    assert not disk.good
    assert ("not writable" in disk.detail) is not writable


def test_too_little_memory_is_reported(tmp_path, monkeypatch):
    monkeypatch.setattr(os, "sysconf", lambda name: {"SC_PAGE_SIZE": 4096}.get(name, 2**20))
    (memory,) = findings(tmp_path, "memory").values()
    assert not memory.good
    assert memory.detail.startswith("4.0 GiB")
