"""Texture units are used where known images come back right."""

import dataclasses
from importlib import resources
from types import SimpleNamespace

import numpy as np
import pytest

from legsim.core.errors import LegsimError
from legsim.opencl import textures
from legsim.opencl.device import Device

SOURCE = resources.files("legsim.opencl").joinpath("kernels", "textures.cl").read_text("utf-8")


@pytest.fixture
def read_as(device, monkeypatch):
    """Checks the device as if it made something else of the kernel that the probe runs."""

    def check(right: str, wrong: str) -> textures.TextureReads:
        assert right in SOURCE
        built = textures.build_program
        monkeypatch.setattr(
            textures,
            "build_program",
            lambda context, source, options: built(context, source.replace(right, wrong), options),
        )
        return textures.check.__wrapped__(device.candidate)

    return check


def test_reads_are_off_by_no_more_than_texture_units_are(device):
    found = textures.check(device.candidate)
    assert found.fault == ""
    assert found.off <= textures.MOST_OFF + 2e-4
    if device.is_cpu:
        assert found.off < 2e-4


EIGHT_BITS = "(float4)(rint({0} * 256.0f) / 256.0f + 0.5f, rint({1} * 256.0f) / 256.0f + 0.5f"


def test_the_size_of_the_error_is_that_of_the_places(read_as):
    found = read_as("(float4)(x + 0.5f, y + 0.5f", EIGHT_BITS.format("x", "y"))
    assert found.fault == ""
    assert found.off == pytest.approx(1 / 512, rel=0.05)


WRONG = {
    "no half pixel": ("x + 0.5f", "x"),
    "six bits": ("(float4)(x + 0.5f", "(float4)(rint(x * 64.0f) / 64.0f + 0.5f"),
    "turned": ("x + 0.5f, y + 0.5f", "y + 0.5f, x + 0.5f"),
    "another layer": ("(float)layer", "(float)layer + 1.0f"),
    "nearest pixel": ("FILTER_LINEAR", "FILTER_NEAREST"),
    "not a number": (".x;", ".x * NAN;"),
    "one read left out": (
        "values[get_global_id(0)] =",
        "if (get_global_id(0) != 5000) values[get_global_id(0)] =",
    ),
}


@pytest.mark.parametrize(("right", "wrong"), WRONG.values(), ids=WRONG)
def test_texture_units_that_read_wrongly_are_not_used(read_as, right, wrong):
    assert "returned wrong numbers" in read_as(right, wrong).fault


def test_a_driver_that_does_not_build_says_why(read_as):
    assert "error:" in read_as("read_imagef", "read_nonsense").fault


def test_a_device_without_images_says_so(device):
    blind = dataclasses.replace(device.candidate, handle=SimpleNamespace(image_support=0))
    assert textures.check.__wrapped__(blind).fault == "the device reads no images"


def test_layers_arrive_where_they_were_written(device, rng):
    values = rng.normal(size=(3, 5, 7)).astype(np.float32)
    images = device.image_array((4, 5, 7))
    device.write(images, values, 1)
    y, x = np.mgrid[:5, :7].reshape(2, -1)
    points = np.concatenate([np.stack([x, y, np.full(35, k)], -1) for k in range(4)])
    found = device.zeros(140)
    run = device.kernel("read_points", "textures.cl")
    run(device.queue, (140,), None, images, device.upload(points.astype(np.float32)), found)
    expected = np.concatenate([np.zeros((1, 5, 7), np.float32), values])
    np.testing.assert_array_equal(device.download(found, np.empty_like(expected)), expected)


def as_gpu(device: Device) -> Device:
    return dataclasses.replace(device, candidate=dataclasses.replace(device.candidate, kind="gpu"))


def test_gpus_use_textures_and_cpus_do_not_unless_the_setting_says_so(device, monkeypatch):
    monkeypatch.delenv("LEGSIM_TEXTURES", raising=False)
    cpu = dataclasses.replace(device, candidate=dataclasses.replace(device.candidate, kind="cpu"))
    assert (cpu.uses_textures, as_gpu(device).uses_textures) == (False, True)
    monkeypatch.setenv("LEGSIM_TEXTURES", "on")
    assert cpu.uses_textures
    monkeypatch.setenv("LEGSIM_TEXTURES", "off")
    assert not as_gpu(device).uses_textures
    monkeypatch.setenv("LEGSIM_TEXTURES", "1")
    with pytest.raises(LegsimError, match="LEGSIM_TEXTURES is '1'; set it to on or off"):
        assert cpu.uses_textures


def test_a_gpu_that_reads_wrongly_uses_buffers(device, monkeypatch):
    monkeypatch.delenv("LEGSIM_TEXTURES", raising=False)
    wrong = textures.TextureReads("its texture units returned wrong numbers", 0.5)
    monkeypatch.setattr(textures, "check", lambda _: wrong)
    assert not as_gpu(device).uses_textures
    monkeypatch.setenv("LEGSIM_TEXTURES", "on")
    with pytest.raises(LegsimError, match=r"LEGSIM_TEXTURES is on, but .* wrong numbers; unset it"):
        assert as_gpu(device).uses_textures


def test_what_decides_the_numbers_tells_gpus_and_textures_apart(device, monkeypatch):
    monkeypatch.delenv("LEGSIM_TEXTURES", raising=False)
    gpu, compiler = as_gpu(device), device.candidate.compiler
    assert gpu.arithmetic == f"{compiler}, gpu, textures"
    monkeypatch.setenv("LEGSIM_TEXTURES", "off")
    assert gpu.arithmetic == f"{compiler}, gpu"
    assert gpu.described == gpu.label
    monkeypatch.delenv("LEGSIM_TEXTURES")
    assert gpu.described == f"{gpu.label}, textures"
    if device.is_cpu:
        assert (device.arithmetic, device.described) == (compiler, device.label)
