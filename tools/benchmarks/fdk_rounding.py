"""What 8 bits of a place in a pixel, as texture units of GPUs have them, change in a volume."""

import warnings
from collections.abc import Iterator
from typing import Any
from unittest import mock

import numpy as np

from legsim.deformation.models import Motion
from legsim.geometry.cone_beam import Projections
from legsim.geometry.volume import VolumeGrid
from legsim.opencl.device import Device, open_device
from legsim.reconstruction import fdk
from legsim.reconstruction._backprojection_plan import Kernel
from legsim.reconstruction.backprojection import VoxelMap
from legsim.reconstruction.fdk import FdkOptions
from legsim.reconstruction.weights import ShortScanWarning
from tools.benchmarks import fdk as bench_fdk

_PARTS = 256


def rounded(self: VoxelMap, *names: str, _plain: Any = VoxelMap.kernel, **defines: int) -> Any:
    """A kernel that rounds places as texture units do, on any device."""
    return _plain(self, *names, **defines, FRACTIONS=_PARTS)


def volume(
    images: Projections, grid: VolumeGrid, device: Device, motion: Motion | None, kernel: Kernel
) -> np.ndarray:
    """(z, y, x) 1/m in float64."""
    options = FdkOptions(kernel=kernel)
    found = fdk.fdk(images, grid, motion=motion, options=options, device=device)
    return found.attenuation.astype(float)


def run(views: int, slices: int, noise: float, wanted: str | None) -> Iterator[str]:
    """Lines of markdown."""
    device, geometry = open_device(wanted), bench_fdk.scan(views, 1)
    still = bench_fdk.projected(geometry)
    step = bench_fdk.SIDE / 512
    grid = VolumeGrid((slices, 512, 512), (step, step, step), (0.0, 0.0, 0.0))
    expected, counts = bench_fdk.truth(grid)
    bone = float(expected.max())
    drawn = np.random.default_rng(0).normal(0, noise, still.line_integrals.shape)
    noisy = Projections(geometry, (still.line_integrals + drawn).astype(np.float32))
    yield (
        f"{device.label}; {views} views of 620 x 480, {slices} slices of 512 x 512; in % of the "
        f"bone's {1e-3 * bone:.3g}/mm, where the phantom is at least three voxels from an edge "
        f"and all views see it, and in all voxels"
    )
    yield ""
    yield "| scan | differs by | rms | rms of all voxels | greatest of all voxels |"
    yield "|---|---|---|---|---|"
    ways: list[tuple[str, Projections, Motion | None]] = [
        ("circular", still, None),
        ("any matrices", still, bench_fdk.sway(views)),
        ("moving least squares", still, bench_fdk.bending(views)),
        (f"circular, noise of {noise:g}", noisy, None),
    ]
    for name, images, motion in ways:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ShortScanWarning)
            exact = volume(images, grid, device, motion, "voxels")
            others = _others(images, grid, device, motion)
            if images is noisy:
                others["noise"] = volume(still, grid, device, motion, "voxels")
        for what, other in others.items():
            yield _row(name, what, other - exact, counts, bone)


def _others(
    images: Projections, grid: VolumeGrid, device: Device, motion: Motion | None
) -> dict[str, np.ndarray]:
    """The same volume with rounded places, and through texture units where the device has some."""
    with mock.patch.object(VoxelMap, "kernel", rounded):
        found = {f"rounding to 1/{_PARTS}": volume(images, grid, device, motion, "voxels")}
    if not device.is_cpu and not device.texture_fault:
        found["textures"] = volume(images, grid, device, motion, "textures")
    return found


def _row(name: str, what: str, change: np.ndarray, counts: np.ndarray, bone: float) -> str:
    inside, whole = (100 * np.sqrt(np.mean(c**2)) / bone for c in (change[counts], change))
    most = 100 * np.abs(change).max() / bone
    return f"| {name} | {what} | {inside:.4f} | {whole:.4f} | {most:.4f} |"
