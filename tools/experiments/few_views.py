"""Algorithms of reconstruction beside the phantom itself, where the views are few.

    python -m tools.experiments.few_views [--views 62] [--photons 20000] [--coarser 2]

One leg at rest in the pose of a squat's first view, over the arc of the preset's scan, seen by so
many views and by a detector without noise and one with so many photons per pixel. Pixels are
averaged to the size of a voxel; ``--coarser 2`` takes both twice as large. Printed for each
algorithm: RMSE (1/m) and SSIM to the voxelized phantom, and the RMSE in flat tissue (two voxels
away from any edge), where every view sees the leg; seconds on this machine.
"""

import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated

import numpy as np
import typer
from scipy.ndimage import maximum_filter, minimum_filter

from legsim import config
from legsim.core.values import Float32Array
from legsim.evaluation import similarity
from legsim.evaluation.regions import Region
from legsim.geometry.cone_beam import Projections
from legsim.geometry.volume import Volume, VolumeGrid
from legsim.kinematics import joint_splines
from legsim.kinematics.joint_splines import JointSplines
from legsim.opencl.device import Device, open_device
from legsim.phantom import leg_phantom, voxelize
from legsim.reconstruction import cgls, fdk, total_variation, weights
from legsim.run import motion as run_motion
from legsim.run.c_arm import c_arm, volume_grid
from legsim.scan import acquisition
from legsim.scan.acquisition import Imaging
from legsim.scan.detector import Detector

FINER = 3
MARGIN = 5e-3
"""m above and below what every view sees"""

Reconstruct = Callable[[Projections], Volume]


@dataclass(frozen=True, slots=True, eq=False)
class Rest:
    """One leg at rest, and what is true of it."""

    expose: Callable[[Imaging], Projections]
    truth: Volume
    seen: Region
    flat: np.ndarray
    """of that, voxels away from any edge"""


def at_rest(views: int, preset: str, coarser: int, motion_file: str, device: Device) -> Rest:
    """The scanned leg in the pose of the first view."""
    given = config.load_settings(preset=preset)
    whole = given.scan
    factor = max(round(_pixel_ratio(preset)), 1) * coarser
    chosen = (
        f"motion.file={motion_file}",
        f"scan.views={views}",
        f"scan.increment_deg={whole.increment_deg * (whole.views - 1) / (views - 1)!r}",
        f"scan.rate_hz={whole.rate_hz * (views - 1) / (whole.views - 1)!r}",
        f"scan.columns={whole.columns // factor}",
        f"scan.rows={whole.rows // factor}",
        f"scan.pixel_mm={whole.pixel_mm * factor!r}",
        f"grid.voxels={given.grid.voxels // coarser}",
        f"grid.voxel_mm={given.grid.voxel_mm * coarser!r}",
    )
    settings = config.load_settings(preset=preset, overrides=chosen)
    person = run_motion.solve(settings.motion)
    arm = c_arm(settings.scan)
    times = arm.view_times(person.trajectories.times)
    poses = joint_splines.segment_poses_at(person.leg, JointSplines(person.trajectories), times)
    knee = person.leg.joint_centers(poses).of("knee_l")[0]
    geometry, grid = arm.geometry(times, knee), volume_grid(settings.grid, knee)
    phantom = leg_phantom.load_leg_phantom(scales=person.leg.scales)
    left = [k for k, part in enumerate(phantom.phantom.parts) if part.name.endswith("_l")]
    vertices = phantom.posed(poses.world_from_segment[0], poses.segment_names)
    shown, posed = phantom.phantom.only(left), [vertices[k] for k in left]

    def expose(how: Imaging) -> Projections:
        drawing = np.random.default_rng(0)
        return acquisition.project(
            shown,
            geometry,
            device,
            how,
            drawing,
            rays_per_pixel=settings.scan.rays_per_pixel,
            posed=lambda _: posed,
        )

    n = grid.shape_zyx[0]
    fine = VolumeGrid.cubic(FINER * n, grid.spacing_xyz[0] / FINER, grid.center)
    values = voxelize.attenuation(shown, fine, device, posed=posed).attenuation
    truth = values.reshape(n, FINER, n, FINER, n, FINER).mean((1, 3, 5), dtype=np.float32)
    inside = (truth > 0) & arm.seen_by_every_view(grid, margin=MARGIN)
    even = np.asarray(maximum_filter(truth, 5) - minimum_filter(truth, 5) < 1e-3)
    return Rest(expose, Volume(grid, truth), Region("seen", inside), inside & even)


def _pixel_ratio(preset: str) -> float:
    """Voxels over pixels at the isocenter."""
    settings = config.load_settings(preset=preset)
    scan = settings.scan
    pixel = scan.pixel_mm * scan.source_isocenter_mm / scan.source_detector_mm
    return settings.grid.voxel_mm / pixel


def algorithms(grid: VolumeGrid, device: Device) -> dict[str, Reconstruct]:
    """Each with its defaults."""
    return {
        "fdk": lambda p: fdk.fdk(p, grid, device=device),
        "cgls": lambda p: cgls.cgls(p, grid, device=device),
        "cgls, nonnegative": lambda p: cgls.cgls(p, grid, nonnegative=True, device=device),
        "tv": lambda p: total_variation.tv(p, grid, device=device),
    }


def _off(values: Float32Array, truth: Float32Array, where: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square((values - truth)[where], dtype=np.float64))))


def main(
    views: Annotated[int, typer.Option()] = 62,
    photons: Annotated[float, typer.Option(help="Per pixel and view, unattenuated.")] = 20000,
    preset: Annotated[str, typer.Option()] = "demo",
    coarser: Annotated[int, typer.Option(help="Times as large pixels and voxels.")] = 1,
    motion_file: Annotated[str, typer.Option()] = "subject01/squat_60.trc",
) -> None:
    """Prints the table."""
    warnings.simplefilter("ignore", weights.ShortScanWarning)
    device = open_device()
    rest = at_rest(views, preset, coarser, motion_file, device)
    typer.echo(
        "| photons | algorithm | RMSE (1/m) | SSIM | RMSE in flat tissue (1/m) | s |\n"
        "|---|---|---|---|---|---|"
    )
    for count in (0.0, photons):
        projections = rest.expose(Imaging(detector=Detector(photons=count)))
        for name, reconstruct in algorithms(rest.truth.grid, device).items():
            begun = time.perf_counter()
            volume = reconstruct(projections)
            seconds = time.perf_counter() - begun
            scores = similarity.evaluate(volume, rest.truth, [rest.seen], register=False)
            found, true = volume.attenuation, rest.truth.attenuation
            typer.echo(
                f"| {count:g} | {name} | {_off(found, true, rest.seen.mask):.3f} "
                f"| {scores.of('seen').ssim:.4f} | {_off(found, true, rest.flat):.3f} "
                f"| {seconds:.0f} |"
            )


if __name__ == "__main__":
    typer.run(main)
