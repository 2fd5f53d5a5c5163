"""FDK on the paper's scan: seconds and errors against an analytic phantom, beside RTK in the same
run.
"""

import json
import resource
import subprocess
import tempfile
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any, TypeVar
from unittest import mock

import numpy as np

from legsim.core import transforms
from legsim.deformation.models import ControlPointMotion, Motion, RigidMotion
from legsim.geometry.cone_beam import ConeBeamGeometry, Projections
from legsim.geometry.volume import Volume, VolumeGrid
from legsim.opencl.device import Device, open_device
from legsim.reconstruction import fdk
from legsim.reconstruction._backprojection_plan import Kernel
from legsim.reconstruction.backprojection import VolumeSlab
from legsim.reconstruction.fdk import FdkOptions
from legsim.reconstruction.weights import ShortScanWarning

_Result = TypeVar("_Result")
SOURCE_ISOCENTER, SOURCE_DETECTOR, PITCH, STEP_DEG, SIDE = 0.78, 1.198, 0.616e-3, 0.8, 0.256
"""m; the volume is a cube of SIDE"""
# a leg with two bones, a marrow cavity and a dense insert: center (mm), radii (mm), added
# attenuation (1/m)
PHANTOM = (
    ((0, 0, 0), (62, 75, 58), 20.0),
    ((5, 20, -3), (24, 50, 22), 25.0),
    ((5, 20, -3), (14, 40, 13), -20.0),
    ((-8, -45, 18), (16, 24, 15), 28.0),
    ((40, 5, 20), (5, 5, 5), 10.0),
)


@dataclass(frozen=True, slots=True)
class Row:
    """One way of reconstructing, one machine, one run."""

    name: str
    seconds: float
    cpu_seconds: float
    adding_seconds: float | None
    """of back-projection alone, images on the device, by the clock"""
    rmse_percent: float | None
    """of the phantom's greatest contrast, in the field of view, away from edges"""


def scan(views: int, binning: int) -> ConeBeamGeometry:
    """The paper's scan; pixels ``binning`` times as large, views spread over the same range."""
    return ConeBeamGeometry.circular(
        times=np.arange(views) / 31.0,
        angles=np.radians(STEP_DEG * np.linspace(0, 247, views)),
        source_isocenter=SOURCE_ISOCENTER,
        source_detector=SOURCE_DETECTOR,
        shape_vu=(480 // binning, 620 // binning),
        pixel_pitch=PITCH * binning,
    )


def projected(geometry: ConeBeamGeometry) -> Projections:
    """Exact line integrals of the phantom."""
    rows, columns = geometry.shape_vu
    v, u = np.mgrid[:rows, :columns]
    sources = geometry.sources()
    images = np.zeros((len(geometry), rows, columns), np.float32)
    for k in range(len(geometry)):
        rays = geometry[k : k + 1].ray_directions(u, v)[0]
        rays = (rays / np.linalg.norm(rays, axis=-1, keepdims=True)).astype(np.float32)
        for center, radii, attenuation in PHANTOM:
            scale = 1e3 / np.array(radii, np.float32)
            start, ray = (
                ((sources[k] - 1e-3 * np.array(center)) * scale).astype(np.float32),
                rays * scale,
            )
            a, b = (ray**2).sum(-1), ray @ start
            images[k] += (
                attenuation * 2 * np.sqrt(np.maximum(b * b - a * (start @ start - 1), 0)) / a
            )
    return Projections(geometry, images)


def truth(grid: VolumeGrid) -> tuple[np.ndarray, np.ndarray]:
    """((z, y, x) 1/m, bool where the comparison counts: seen by all views and at least 3 voxels
    from any edge).
    """
    x, y, z = grid.axes()
    values = np.zeros(grid.shape_zyx, np.float32)
    counts = np.broadcast_to(
        (np.hypot(x[None, None], z[:, None, None]) < 0.11) & (np.abs(y[None, :, None]) < 0.075),
        grid.shape_zyx,
    ).copy()
    for center, radii, attenuation in PHANTOM:
        r = np.array(radii) * 1e-3
        dx, dy, dz = (a - 1e-3 * c for a, c in zip((x, y, z), center, strict=True))
        distance = np.sqrt(
            (dx / r[0])[None, None] ** 2
            + (dy / r[1])[None, :, None] ** 2
            + (dz / r[2])[:, None, None] ** 2
        )
        values += np.where(distance < 1, np.float32(attenuation), np.float32(0))
        counts &= np.abs(distance - 1) * r.min() > 3 * max(grid.spacing_xyz)
    return values, counts


def timed(work: Callable[[], _Result]) -> tuple[_Result, float, float]:
    """(result, seconds, seconds of all cores)."""
    begin, used = time.perf_counter(), resource.getrusage(resource.RUSAGE_SELF)
    result = work()
    seconds, now = time.perf_counter() - begin, resource.getrusage(resource.RUSAGE_SELF)
    return result, seconds, now.ru_utime + now.ru_stime - used.ru_utime - used.ru_stime


def adding(work: Callable[[], object]) -> float:
    """Seconds by the clock that the device back-projects while ``work`` runs."""
    spent, plain = [], VolumeSlab.add

    def watched(*arguments: Any) -> None:
        begin = time.perf_counter()
        plain(*arguments)
        spent.append(time.perf_counter() - begin)

    with mock.patch.object(VolumeSlab, "add", watched):
        work()
    return sum(spent)


def sway(views: int) -> RigidMotion:
    """A few millimeters and degrees."""
    phase = np.linspace(0, 9, views)
    turns = 0.03 * np.stack([np.sin(phase), np.cos(1.3 * phase) - 1, np.sin(0.7 * phase)], -1)
    shifts = 0.006 * np.stack([np.cos(phase) - 1, np.sin(2 * phase), np.sin(0.8 * phase)], -1)
    return RigidMotion(
        np.arange(views) / 31.0, transforms.rigid(transforms.rotation_from_vector(turns), shifts)
    )


def bending(views: int) -> ControlPointMotion:
    """Hip, knee and ankle that go their own ways by millimeters."""
    joints = np.array([[-0.05, 0.4, 0.0], [0.02, 0.0, 0.0], [-0.04, -0.4, 0.01]])
    phase = np.linspace(0, 9, views)[:, None, None]
    swing = 0.008 * np.sin(phase * np.array([[[1.0], [1.4], [0.6]]]) + np.array([0.0, 1.0, 2.0]))
    return ControlPointMotion(np.arange(views) / 31.0, joints, joints + swing - swing[:1])


def warm_up(count: int) -> VolumeGrid:
    """A few columns as long as the cube's: what kernels are built for."""
    step = SIDE / count
    return VolumeGrid((8, count, 8), (step, step, step), (0.0, 0.0, 0.0))


def kernels(device: Device, textures: bool | None) -> dict[str, Kernel | None]:
    """What is measured, and what to add to its name: the kernel that FDK chooses; on a GPU, or
    where ``textures`` says so, images from buffers and through texture units.
    """
    if not (textures or (textures is None and not device.is_cpu)):
        return {"": None}
    if device.texture_fault:
        return {f", from buffers ({device.texture_fault})": "voxels"}
    return {", from buffers": "voxels", ", through textures": "textures"}


def measure(
    views: int,
    count: int,
    binning: int,
    device: Device,
    rtk_python: Path | None,
    textures: bool | None,
) -> list[Row]:
    """All rows. Each way runs once; kernels are built before by a few columns."""
    geometry = scan(views, binning)
    projections = projected(geometry)
    grid = VolumeGrid.cubic(count, SIDE / count, (0.0, 0.0, 0.0))
    expected, counts = truth(grid)
    contrast = float(expected.max())
    rows = []
    motions: list[tuple[str, Motion | None]] = [
        ("legsim, circular scan", None),
        ("legsim, any matrices", sway(views)),
        ("legsim, moving least squares", bending(views)),
    ]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ShortScanWarning)
        for (name, motion), (how, kernel) in product(motions, kernels(device, textures).items()):
            of = partial(
                fdk.fdk,
                projections,
                device=device,
                motion=motion,
                options=FdkOptions(kernel=kernel),
            )
            of(warm_up(count))
            found: list[tuple[Volume, float, float]] = []
            spent = adding(lambda of=of, found=found: found.append(timed(partial(of, grid))))
            volume, seconds, cpu = found[0]
            error = (
                _rmse(volume.attenuation, expected, counts, contrast) if motion is None else None
            )
            rows.append(Row(name + how, seconds, cpu, spent, error))
    if rtk_python is not None:
        volume, seconds, cpu = _rtk(projections, count, rtk_python)
        rows.append(Row("RTK", seconds, cpu, None, _rmse(volume, expected, counts, contrast)))
    return rows


def _rmse(volume: np.ndarray, expected: np.ndarray, counts: np.ndarray, contrast: float) -> float:
    return 100 * float(np.sqrt(np.mean((volume - expected)[counts] ** 2, dtype=float))) / contrast


def _rtk(projections: Projections, count: int, python: Path) -> tuple[np.ndarray, float, float]:
    geometry = projections.geometry
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        np.save(folder / "projections.npy", projections.line_integrals)
        numbers = {
            "angles_deg": (STEP_DEG * np.linspace(0, 247, len(geometry))).tolist(),
            "source_isocenter_mm": 1e3 * SOURCE_ISOCENTER,
            "source_detector_mm": 1e3 * SOURCE_DETECTOR,
            "pixel_mm": 1e3 * geometry.pixel_pitch,
            "count": count,
            "voxel_mm": 1e3 * SIDE / count,
        }
        (folder / "scan.json").write_text(json.dumps(numbers))
        script = Path(__file__).parent / "peers" / "rtk_fdk.py"
        done = subprocess.run([python, script, folder], check=True, capture_output=True, text=True)
        found = json.loads(done.stdout.strip().splitlines()[-1])
        return (
            np.load(folder / "volume.npy") * np.float32(1e3),
            found["seconds"],
            found["cpu_seconds"],
        )


def table(rows: list[Row], views: int, count: int, binning: int) -> str:
    """Markdown."""
    rtk = next((row for row in rows if row.name == "RTK"), None)
    updates = views * count**3 / 1e9
    lines = [
        f"{views} views of {620 // binning} x {480 // binning} to {count}^3:",
        "",
        "| | s | CPU s | GUPS, all stages | GUPS, back-projection | RTK's time / this | "
        "error, % of contrast |",
        "|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        ratio = (
            f"{rtk.seconds / row.seconds:.1f} ({rtk.cpu_seconds / row.cpu_seconds:.1f} in CPU s)"
            if rtk
            else ""
        )
        alone = f"{updates / row.adding_seconds:.2f}" if row.adding_seconds is not None else ""
        error = f"{row.rmse_percent:.3f}" if row.rmse_percent is not None else ""
        lines.append(
            f"| {row.name} | {row.seconds:.1f} | {row.cpu_seconds:.1f} | "
            f"{updates / row.seconds:.2f} | {alone} | {ratio} | {error} |"
        )
    return "\n".join(lines)


def run(
    views: int,
    count: int,
    binning: int,
    device: str | None,
    rtk_python: Path | None,
    textures: bool | None,
) -> str:
    """The table."""
    rows = measure(views, count, binning, open_device(device), rtk_python, textures)
    return table(rows, views, count, binning)
