"""What images of beads leave open: the size of the scene. `python -m tools.experiments.bead_gauge`,
for docs/results.md.

Shadows of the beads of a run are computed exactly, without any image. Free poses in every view
explain them equally well at any size of the scene: a bead cloud that is smaller by 1 in 1000 and
moves towards the source by 0.8 mm looks the same, in every view. How little the misfit says of it
is the first table; what it costs at the tibia, before any registration, the second. "Places known"
is what would be left if somebody had measured the beads' places at the first view; the noise is of
detection.
"""

from typing import Annotated

import numpy as np
import typer

from legsim import config
from legsim.core import transforms
from legsim.core.values import FloatArray
from legsim.correction import bead_scan, bead_tracking
from legsim.deformation.models import RigidMotion
from legsim.geometry.cone_beam import ConeBeamGeometry
from legsim.kinematics import joint_splines
from legsim.kinematics.joint_splines import JointSplines
from legsim.kinematics.skeleton import SEGMENTS
from legsim.phantom import leg_phantom
from legsim.run import motion as run_motion
from legsim.run.c_arm import c_arm

DETECTION_PX = 0.1


def beads(motion_file: str) -> tuple[ConeBeamGeometry, FloatArray, FloatArray]:
    """(scan, beads (v, b, 3), tibia poses (v, 4, 4)) of the preset "half"."""
    settings = config.load_settings(preset="half", overrides=(f"motion.file={motion_file}",))
    recovered = run_motion.solve(settings.motion)
    arm = c_arm(settings.scan)
    times = arm.view_times(recovered.trajectories.times)
    poses = joint_splines.segment_poses_at(
        recovered.leg, JointSplines(recovered.trajectories), times
    )
    geometry = arm.geometry(times, recovered.leg.joint_centers(poses).of("knee_l")[0])
    phantom = leg_phantom.load_leg_phantom(scales=recovered.leg.scales)
    ordered = np.stack([poses.of(name) for name in SEGMENTS], 1)
    placed = bead_scan.bead_positions(phantom, bead_scan.Beads())
    start = phantom.reference_world_from_segment
    paths = phantom.paths(placed, "soft_l", start=start, poses=ordered, segment_names=SEGMENTS)
    return geometry, paths, poses.of("tibia_l")


def size(found: FloatArray, true: FloatArray) -> float:
    """Of one bead cloud (b, 3) against the other."""
    a, b = found - found.mean(0), true - true.mean(0)
    return float((a * b).sum() / (b * b).sum())


def error_mm(motion: RigidMotion, tibia: FloatArray) -> str:
    """Error of the knee's place: RMS over the views, length of its mean over them, and what
    varies.
    """
    true = RigidMotion.from_poses(motion.times, tibia)
    knee = tibia[0, None, :3, 3]
    off = (
        1e3
        * (
            transforms.apply(motion.moved_from_reference, knee)
            - transforms.apply(true.moved_from_reference, knee)
        )[:, 0]
    )
    rms, mean = np.sqrt((off**2).sum(-1).mean()), off.mean(0)
    return (
        f"{rms:.2f} | {np.linalg.norm(mean):.2f} | "
        f"{np.sqrt(((off - mean) ** 2).sum(-1).mean()):.2f} |"
    )


def main(
    motion_files: Annotated[str, typer.Option()] = "subject01/squat_30.trc subject01/squat_60.trc",
    draws: int = 5,
) -> None:
    """Prints both tables."""
    scans = {name: beads(name) for name in motion_files.split()}
    typer.echo(
        "| scan | size of the bead cloud | misfit of the best poses (px RMS) |\n|---|---|---|"
    )
    for name, (geometry, paths, _) in scans.items():
        pixels, middle = geometry.project(paths)[0], paths[0].mean(0)
        for wanted in (0.99, 1.0, 1.01):
            places = middle + wanted * (paths[0] - middle)
            motion = bead_tracking.poses(geometry, pixels, places).moved_from_reference
            miss = geometry.project(transforms.apply(motion, places))[0] - pixels
            typer.echo(f"| {name} | {wanted:g} | {np.sqrt((miss**2).sum(-1).mean()):.5f} |")
    typer.echo(
        "\n| scan | shadows | size found | knee RMS (mm) | mean (mm) | about the mean (mm) "
        "|\n|---|---|---|---|---|---|"
    )
    for name, (geometry, paths, tibia) in scans.items():
        pixels = geometry.project(paths)[0]
        known = bead_tracking.poses(geometry, pixels, paths[0])
        typer.echo(f"| {name} | exact, places known | 1 | {error_mm(known, tibia)}")
        for seed in range(-1, draws):
            noise = (
                DETECTION_PX * np.random.default_rng(seed).standard_normal(pixels.shape)
                if seed >= 0
                else 0.0
            )
            shown = f"{DETECTION_PX} px of noise, draw {seed}" if seed >= 0 else "exact"
            found = bead_tracking.estimate(geometry, pixels + noise)
            typer.echo(
                f"| {name} | {shown} | {size(found.positions, paths[0]):.4f} | "
                f"{error_mm(found.motion, tibia)}"
            )


if __name__ == "__main__":
    typer.run(main)
