"""Why deformed images can score above the true motion: what of a correction's distance from the
motion-free volume is streaks of its rays.

    python -m tools.experiments.ray_streaks [--motion-file subject01/squat_60.trc] [--cases "248
    views; one leg"] [--cgls 8]

The motion-free reference is itself a reconstruction, with streaks that hang on its rays. A
back-projection that follows the motion has the same object under other rays; deformed images keep
the rays of the reference. Each case is scanned twice: with the recorded motion (the truth is then a
displacement field), and with everything moved rigidly as the shank moves. There the motion is known
without any error, and the scan *is* one of a resting leg by a C-arm that shakes: all that parts it
from the reference comes from the rays. Published are SSIM against the reference in the leg's region
of a run and in what every view sees of it; there also the rest: RMSE, SSIM to the voxelized
phantom, raw distance (1/m) in flat tissue (two voxels away from any edge) from the reference, and
from the phantom everywhere and there.
"""

import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
import typer
from scipy.ndimage import maximum_filter, minimum_filter

from legsim import config
from legsim.config import RunConfig
from legsim.core.values import Float32Array
from legsim.correction import control_points, image_warp, oracle, rigid
from legsim.correction.control_points import AttachedPoint
from legsim.deformation.models import ControlPointMotion, FieldMotion, RigidMotion
from legsim.evaluation import regions, similarity
from legsim.evaluation.regions import Region
from legsim.geometry.cone_beam import ConeBeamGeometry, Projections
from legsim.geometry.volume import Volume, VolumeGrid
from legsim.kinematics import joint_splines
from legsim.kinematics.joint_splines import JointSplines
from legsim.kinematics.skeleton import SegmentPoses
from legsim.opencl.device import Device, open_device
from legsim.phantom import leg_phantom, voxelize
from legsim.phantom.leg_phantom import LegPhantom
from legsim.reconstruction import cgls as reconstruction_cgls
from legsim.reconstruction import fdk, weights
from legsim.run import motion as run_motion
from legsim.run.c_arm import c_arm, volume_grid
from legsim.scan import acquisition
from legsim.scan.acquisition import Imaging

SMALL = (
    "scan.columns=124",
    "scan.rows=96",
    "scan.pixel_mm=3.08",
    "grid.voxels=96",
    "grid.voxel_mm=2.6",
)
SECONDS, SHORT, FULL = 7.968, 197.6, 360.0
FINER = 3
MARGIN = 5e-3
"""m above and below what every view sees, for the motion"""


@dataclass(frozen=True, slots=True)
class Case:
    """One scan."""

    name: str
    views: int = 248
    span_deg: float = SHORT
    """first to last view; 360 for a closed circle"""
    both_legs: bool = True
    rays: int = 1
    """along either edge of a pixel, whose mean it shows; 1: the ray through its middle alone"""

    def settings(self, motion_file: str) -> RunConfig:
        """The scan of this case, in the same seconds."""
        steps = self.views if self.span_deg == FULL else self.views - 1
        rate, step = (self.views - 1) / SECONDS, self.span_deg / steps
        chosen = (
            f"motion.file={motion_file}",
            f"scan.views={self.views}",
            f"scan.increment_deg={step!r}",
            f"scan.rate_hz={rate!r}",
        )
        return config.load_settings(overrides=(*SMALL, *chosen))


CASES = (
    Case("248 views"),
    Case("124 views", 124),
    Case("496 views", 496),
    Case("one leg", both_legs=False),
    Case("full circle", 450, FULL),
    Case("one leg, full circle", 450, FULL, both_legs=False),
    Case("one leg, 124 views", 124, both_legs=False),
    Case("one leg, 124 views, 3x3 rays a pixel", 124, both_legs=False, rays=3),
    Case("one leg, 496 views, 3x3 rays a pixel", 496, both_legs=False, rays=3),
)


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """A phantom at every view, and what is true of it at the first."""

    phantom: LegPhantom
    poses: SegmentPoses
    geometry: ConeBeamGeometry
    grid: VolumeGrid
    truth: Float32Array
    leg: Region
    """as in a run: also above and below what the cone sees"""
    seen: Region
    """of the leg, what every view sees"""
    flat: np.ndarray
    """of that, voxels away from any edge"""
    parts: tuple[int, ...]
    rays: int
    device: Device

    def exposed(self, poses: SegmentPoses) -> Projections:
        """Line integrals of the case's parts."""

        def posed(view: int) -> list[np.ndarray]:
            vertices = self.phantom.posed(poses.world_from_segment[view], poses.segment_names)
            return [vertices[k] for k in self.parts]

        how, none_drawn = Imaging(), np.random.default_rng(0)
        shown = self.phantom.phantom.only(self.parts)
        return acquisition.project(
            shown,
            self.geometry,
            self.device,
            how,
            none_drawn,
            rays_per_pixel=self.rays,
            posed=posed,
        )

    def warped(self, projections: Projections, poses: SegmentPoses) -> Projections:
        """Images deformed by the true places of hip, knee and ankle, as nonrigid-2d does."""
        near = control_points.contracted(joints(self.phantom, poses), 1, 0.8)
        return image_warp.warp_images(projections, near, self.device)


def joints(phantom: LegPhantom, poses: SegmentPoses) -> ControlPointMotion:
    """Hip, knee and ankle of the left leg, by the segments that carry them: origins of femur, tibia
    and talus at the first view.
    """
    hip, knee, ankle = (poses.of(f"{name}_l")[0, :3, 3] for name in ("femur", "tibia", "talus"))
    carried = (("femur_l", hip), ("tibia_l", knee), ("tibia_l", ankle))
    return control_points.track_points(
        poses,
        [
            AttachedPoint.at_start(segment, poses.of(segment)[0], point)
            for segment, point in carried
        ],
    )


def scene(case: Case, motion_file: str, device: Device) -> Scene:
    """The case with the recorded motion."""
    settings = case.settings(motion_file)
    recovered = run_motion.solve(settings.motion)
    arm = c_arm(settings.scan)
    times = arm.view_times(recovered.trajectories.times)
    poses = joint_splines.segment_poses_at(
        recovered.leg, JointSplines(recovered.trajectories), times
    )
    knee = recovered.leg.joint_centers(poses).of("knee_l")[0]
    geometry, grid = arm.geometry(times, knee), volume_grid(settings.grid, knee)
    phantom = leg_phantom.load_leg_phantom(scales=recovered.leg.scales)
    vertices = phantom.posed(poses.world_from_segment[0], poses.segment_names)
    left = [k for k, part in enumerate(phantom.phantom.parts) if part.name.endswith("_l")]
    parts = tuple(range(len(vertices))) if case.both_legs else tuple(left)
    fine = VolumeGrid.cubic(FINER * grid.shape_zyx[0], grid.spacing_xyz[0] / FINER, grid.center)
    values = voxelize.attenuation(
        phantom.phantom.only(parts), fine, device, posed=[vertices[k] for k in parts]
    ).attenuation
    n = grid.shape_zyx[0]
    truth = values.reshape(n, FINER, n, FINER, n, FINER).mean((1, 3, 5), dtype=np.float32)
    labels = voxelize.labels(
        phantom.phantom.only(left), grid, device, posed=[vertices[k] for k in left]
    )
    leg = regions.leg_regions(labels, grid, float(knee[1]), arm.seen_by_every_view(grid))[0]
    seen = Region("seen", leg.mask & arm.seen_by_every_view(grid, margin=MARGIN))
    even = (
        np.asarray(maximum_filter(truth, 5) - minimum_filter(truth, 5) < 1e-3)
        & seen.mask
        & (truth > 0)
    )
    return Scene(phantom, poses, geometry, grid, truth, leg, seen, even, parts, case.rays, device)


def as_one(poses: SegmentPoses) -> SegmentPoses:
    """Everything moved rigidly as the left shank moves."""
    motion = RigidMotion.from_poses(poses.times, poses.of("tibia_l")).moved_from_reference
    return replace(poses, world_from_segment=motion[:, None] @ poses.world_from_segment[0])


def row(scene: Scene, name: str, volume: Volume, reference: Volume) -> str:
    """A line of the table."""
    found = similarity.evaluate(volume, reference, [scene.leg, scene.seen])
    whole, seen = found.of("leg"), found.of("seen")
    true = similarity.evaluate(
        volume, Volume(scene.grid, scene.truth), [scene.seen], register=False
    ).of("seen")
    away = (
        (volume.attenuation - reference.attenuation, scene.flat),
        *((volume.attenuation - scene.truth, m) for m in (scene.seen.mask, scene.flat)),
    )
    raw = " | ".join(
        f"{float(np.sqrt(np.mean(np.square(off[mask], dtype=np.float64)))):.3f}"
        for off, mask in away
    )
    return (
        f"{name} | {whole.ssim:.4f} | {seen.ssim:.4f} | {seen.rmse:.4f} | {true.ssim:.4f} | {raw} |"
    )


Motion = RigidMotion | FieldMotion | None
Corrected = tuple[Projections, Motion]
Reconstruct = Callable[[Projections, Motion], Volume]


def rows(scene: Scene, reconstruct: Reconstruct, *, recorded: bool) -> list[str]:
    """Both motions, or the rigid one alone, and all ways to correct them."""
    still = scene.exposed(scene.poses.held_at(0))
    reference = reconstruct(still, None)
    lines = [row(scene, "– | static", reference, reference)]
    both = [("recorded", scene.poses), ("as one", as_one(scene.poses))]
    for motion_name, poses in both if recorded else both[1:]:
        moving = scene.exposed(poses)
        truth = rigid.rigid_motion(poses.times, poses.of("tibia_l"))
        made: dict[str, Corrected] = {
            "uncorrected": (moving, None),
            "nonrigid-2d": (scene.warped(moving, poses), None),
        }
        if motion_name == "as one":
            made["true motion"] = moving, truth
        else:
            nodes = scene.grid.coarse(8e-3)
            made["true motion"] = (
                moving,
                oracle.phantom_motion(scene.phantom, poses, nodes, scene.device),
            )
        lines += [
            row(scene, f"{motion_name} | {name}", reconstruct(*how), reference)
            for name, how in made.items()
        ]
    return lines


def main(
    motion_file: Annotated[str, typer.Option()] = "subject01/squat_60.trc",
    cases: Annotated[str, typer.Option(help="Names, parted by semicolons; empty: all.")] = "",
    cgls: Annotated[
        int,
        typer.Option(
            help="So many steps of CGLS instead of FDK; one leg, so that all is inside the grid."
        ),
    ] = 0,
) -> None:
    """Prints the table."""
    warnings.simplefilter("ignore", weights.ShortScanWarning)
    device = open_device()
    heads = (
        "SSIM leg",
        "SSIM seen",
        "RMSE seen",
        "SSIM to the phantom",
        "flat tissue (1/m)",
        "RMSE to the phantom (1/m)",
        "its flat tissue (1/m)",
    )
    typer.echo(f"| case | motion | correction | {' | '.join(heads)} |\n|{10 * '---|'}")
    wanted = [c.strip() for c in cases.split(";") if c.strip()]
    for case in (Case("one leg, CGLS", 124, both_legs=False),) if cgls else CASES:
        if wanted and case.name not in wanted:
            continue
        seen = scene(case, motion_file, device)

        def reconstruct(projections: Projections, motion: Motion, seen: Scene = seen) -> Volume:
            if cgls:
                return reconstruction_cgls.cgls(
                    projections, seen.grid, device=device, motion=motion, iterations=cgls
                )
            return fdk.fdk(projections, seen.grid, device=device, motion=motion)

        for line in rows(seen, reconstruct, recorded=not cgls):
            typer.echo(f"| {case.name} | {line}")


if __name__ == "__main__":
    typer.run(main)
