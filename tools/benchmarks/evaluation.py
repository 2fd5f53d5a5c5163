"""Comparison of a volume with its reference: time and memory per step, beside SimpleITK and
scikit-image on the same volumes.

The volumes are the leg phantom at the first view of a held squat, in voxels and with noise of about
two voxels; the second one is shifted by a part of a millimeter. The libraries get what legsim gave
them before its own kernels: whole volumes as far as a registration may read.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from scipy.ndimage import gaussian_filter

from legsim import config
from legsim.core import memory
from legsim.core.values import Float32Array
from legsim.evaluation import registration, resampling, similarity, ssim
from legsim.evaluation.regions import Region, within
from legsim.evaluation.registration import Compared
from legsim.geometry.volume import Volume, VolumeGrid
from legsim.opencl.device import Device, open_device
from legsim.phantom import voxelize
from legsim.run import motion as run_motion
from legsim.run.c_arm import c_arm
from legsim.simulation.setup import PhantomOptions, ScanSetup, prepare_scan, scan_regions
from tests.references import comparison

T = TypeVar("T")

CUBE, SHIFT = 0.256, (0.0003, -0.0002, 0.00015)
"""m: edge of the volumes, and by how much the second one is off"""

NOISE = 2.0
"""1/m"""


@dataclass(frozen=True, slots=True)
class Cost:
    """What one step took."""

    seconds: float
    cpu_seconds: float
    mebibytes: float | None
    """most memory beyond what was there before; None where the system does not report it"""


def measured(step: Callable[[], T]) -> tuple[T, Cost]:
    """The result of a step and its cost."""
    before = memory.resident_mebibytes()
    memory.begin_peak()
    wall, cpu = time.perf_counter(), time.process_time()
    result = step()
    seconds, cpu = time.perf_counter() - wall, time.process_time() - cpu
    peak = memory.peak_mebibytes()
    return result, Cost(seconds, cpu, None if peak is None or before is None else peak - before)


def volumes(setup: ScanSetup, grid: VolumeGrid, device: Device) -> tuple[Volume, Volume]:
    """The reference, and the shifted volume."""
    rng = np.random.default_rng(0)
    made = []
    for shift in (np.zeros(3), np.array(SHIFT)):
        x, y, z = (np.array(grid.center) - shift).tolist()
        seen = VolumeGrid(grid.shape_zyx, grid.spacing_xyz, (x, y, z))
        leg = voxelize.attenuation(setup.phantom.phantom, seen, device, posed=setup.scanned_leg())
        noise = np.float32(NOISE) * rng.standard_normal(grid.shape_zyx, np.float32)
        noise += leg.attenuation
        made.append(Volume(grid, gaussian_filter(noise, 0.7)))
    return made[0], made[1]


def here(
    pair: tuple[Volume, Volume], regions: tuple[Region, ...], device: Device
) -> tuple[similarity.Scores, dict[str, Cost]]:
    """Scores, and the cost of each step and of all together."""
    reference, volume = pair
    scores, whole = measured(lambda: similarity.evaluate(volume, reference, regions, device=device))
    wide, box = registration.boxes(regions[0].mask, reference.grid)
    inner, mask = within(box, wide), regions[0].mask[box]
    fixed, moving = scaled(reference, reference, box), scaled(volume, reference, wide)
    given = Compared(fixed, mask, moving, reference.grid.cropped(wide), inner)
    (matrix, _), registered = measured(lambda: registration.rigid_transform(given))
    shift = registration.shift_in_voxels(matrix, given.grid)
    resampled, resampling_cost = measured(lambda: resampling.resample(moving, shift, inner, device))
    _, similar = measured(lambda: ssim.ssim_map(resampled, fixed, device=device))
    costs = {"registration": registered, "resampling": resampling_cost, "SSIM": similar}
    return scores, {**costs, "all, with scaling, RMSE and entropy": whole}


def by_libraries(
    pair: tuple[Volume, Volume], regions: tuple[Region, ...]
) -> tuple[float, float, dict[str, Cost]]:
    """SSIM and RMSE of the leg, and the cost of each step."""
    reference, volume = pair
    wide, _ = registration.boxes(regions[0].mask, reference.grid)
    grid, mask = reference.grid.cropped(wide), np.ascontiguousarray(regions[0].mask[wide])
    fixed, moving = scaled(reference, reference, wide), scaled(volume, reference, wide)
    transform, registered = measured(lambda: comparison.register(fixed, moving, mask, grid))
    resampled, resampling_cost = measured(lambda: comparison.resample(moving, transform, grid))
    found, similar = measured(lambda: comparison.ssim(resampled, fixed))
    rmse = float(np.sqrt(np.nanmean((resampled[mask] - fixed[mask]).astype(np.float64) ** 2)))
    seen = found[mask]
    mean = float(seen[np.isfinite(seen)].mean(dtype=np.float64))
    costs = {"registration": registered, "resampling": resampling_cost, "SSIM": similar}
    return mean, rmse, costs


def scaled(volume: Volume, reference: Volume, box: tuple[slice, slice, slice]) -> Float32Array:
    """The box of a volume with the reference's range as 0 to 1."""
    low, high = float(reference.attenuation.min()), float(reference.attenuation.max())
    return (volume.attenuation[box] - np.float32(low)) * np.float32(1 / (high - low))


def run(counts: list[int], device: str | None, echo: Callable[[str], None]) -> None:
    """Prints one row per step for each number of voxels along the cube's edge."""
    opened = open_device(device)
    settings = config.load_settings(overrides=("motion.file=subject01/squat_60.trc",))
    person = run_motion.solve(settings.motion)
    setup = prepare_scan(person, c_arm(settings.scan), phantom=PhantomOptions(legs="scanned"))
    echo(f"{opened.label}, {opened.candidate.compute_units} units; CPU seconds count all threads")
    for count in counts:
        center = [float(c) for c in setup.geometry.rotation_center()]
        grid = VolumeGrid.cubic(count, CUBE / count, center)
        regions = scan_regions(setup, grid, opened)
        pair = volumes(setup, grid, opened)
        scores, ours = here(pair, regions, opened)
        mean, rmse, theirs = by_libraries(pair, regions)
        for line in table(count, ours, theirs):
            echo(line)
        leg = scores.of("leg")
        echo(
            f"leg: SSIM {leg.ssim:.5f} here, {mean:.5f} by the libraries; RMSE {leg.rmse:.5f}, "
            f"{rmse:.5f}"
        )


def table(count: int, ours: dict[str, Cost], theirs: dict[str, Cost]) -> list[str]:
    """Rows of Markdown; the last compares all of a volume with the libraries' three steps."""
    sums = [theirs[step] for step in theirs]
    peaks = [c.mebibytes for c in sums if c.mebibytes is not None]
    together = Cost(
        sum(c.seconds for c in sums),
        sum(c.cpu_seconds for c in sums),
        max(peaks) if peaks else None,
    )
    lines = [
        "",
        f"| {count}³ | seconds here | libraries | CPU seconds here | libraries | times as fast "
        "(CPU) | MiB here | libraries |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for step, cost in ours.items():
        other = theirs.get(step, together)
        lines.append(
            f"| {step} | {cost.seconds:.2f} | {other.seconds:.2f} | {cost.cpu_seconds:.2f} | "
            f"{other.cpu_seconds:.2f} | {other.cpu_seconds / cost.cpu_seconds:.1f} | "
            f"{_size(cost)} | {_size(other)} |"
        )
    return lines


def _size(cost: Cost) -> str:
    return "–" if cost.mebibytes is None else f"{cost.mebibytes:.0f}"
