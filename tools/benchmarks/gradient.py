"""Gradient of a back-projected box beside the back-projection of the same box, on one device."""

import statistics
import time
from collections.abc import Callable, Iterator

import numpy as np

from legsim.core import transforms
from legsim.deformation.models import RigidMotion
from legsim.geometry.cone_beam import ConeBeamGeometry, Projections
from legsim.geometry.volume import VolumeGrid
from legsim.opencl.device import open_device
from legsim.reconstruction import _backprojection_plan, backprojection
from legsim.reconstruction.image_gradient import FilteredScan, filtered_scan

_TURN = (0.31, 0.52, 0.17)
"""rad, of the box against the detector"""


def scan(views: int) -> ConeBeamGeometry:
    """The paper's scan at half its resolution, seen by a turned box."""
    geometry = ConeBeamGeometry.circular(
        times=np.arange(views) / 31,
        angles=np.radians(np.linspace(0, 197.6, views)),
        source_isocenter=0.78,
        source_detector=1.198,
        shape_vu=(240, 310),
        pixel_pitch=1.232e-3,
    )
    return geometry.moved(transforms.rigid(transforms.rotation_from_vector(_TURN), np.zeros(3)))


def median(work: Callable[[], object], repeats: int) -> tuple[float, float]:
    """Median seconds by the clock, and CPU seconds, after one run that is not counted."""
    work()
    clock, cpu = [], []
    for _ in range(repeats):
        began, used = time.perf_counter(), time.process_time()
        work()
        clock.append(time.perf_counter() - began)
        cpu.append(time.process_time() - used)
    return statistics.median(clock), statistics.median(cpu)


def _columns(filtered: FilteredScan, grid: VolumeGrid, images: np.ndarray) -> Callable[[], object]:
    """The same box by FDK's own choice of kernel, images on the device already."""
    device = filtered.device
    decided = _backprojection_plan.plan(filtered.geometry, grid, device)
    stored = backprojection.ViewImages(filtered.geometry, device, decided)
    everything = slice(0, len(images))
    stored.write(everything, backprojection.arranged(images, np.array(decided.mirrored)))
    placement = backprojection.VoxelMap(filtered.geometry, grid, device, decided, None)

    def work() -> object:
        slab = backprojection.VolumeSlab(placement, 0, grid.shape_zyx[0])
        for first in range(0, len(images), decided.batch):
            views = slice(first, min(first + decided.batch, len(images)))
            slab.add(*stored.of(views), views)
        return slab.result()

    return work


def run(views: int, voxel_mm: float, repeats: int, device: str | None) -> Iterator[str]:
    """Lines of markdown."""
    geometry = scan(views)
    long, high, size = round(110 / voxel_mm), round(70 / voxel_mm), 1e-3 * voxel_mm
    grid = VolumeGrid((long, high, long), (size, size, size), (0.0, 0.0, 0.0))
    rng = np.random.default_rng(0)
    images = rng.random((views, 240, 310), np.float32)
    filtered = filtered_scan(Projections(geometry, images), grid, device=open_device(device))
    slopes = rng.normal(0, 1, grid.shape_zyx).astype(np.float32)
    motion = RigidMotion.identity(geometry.times)
    updates = views * slopes.size
    yield f"{filtered.device.label}: {views} views of 310x240, {updates / 1e6:.0f} M updates"
    yield "| | s | CPU s | of voxels | of FDK's choice |\n|---|---|---|---|---|"
    rows = {
        "back-projection, voxels": lambda: filtered.volume(grid, motion),
        "back-projection, FDK's choice": _columns(filtered, grid, images),
        "gradient, all views": lambda: filtered.gradient(grid, slopes, motion),
    }
    found = {name: median(work, repeats) for name, work in rows.items()}
    voxels, chosen, _ = (clock for clock, _ in found.values())
    for name, (clock, cpu) in found.items():
        ratios = f"{clock / voxels:.2f} | {clock / chosen:.2f}"
        yield f"| {name} | {clock:.3f} | {cpu:.3f} | {ratios} |"
