"""Scenes of a replay and of a scan, built from the values of the stages."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from legsim.imu import simulation
from legsim.imu.signals import ImuSignals
from legsim.kinematics.moving_leg import MovingLeg
from legsim.kinematics.skeleton import SegmentPoses
from legsim.phantom.leg_phantom import LegPhantom, load_leg_phantom
from legsim.scene.slices import VolumeSlices
from legsim.scene.values import MovingSurface, ReplayScene, ScanScene, SegmentMesh
from legsim.simulation.simulated_scan import SimulatedScan

_SHOWN_SURFACES = ("skin", "patella_cortex", "femur_cortex", "tibia_cortex", "fibula_cortex")


def replay_scene(
    person: MovingLeg, signals: ImuSignals, phantom: LegPhantom | None = None
) -> ReplayScene:
    """Builds a scene of skeleton with bones, markers, sensors and curves.

    The bones are the phantom's. ``signals`` hold where their sensors are strapped on. Without a
    phantom the coarse one at the person's size is used.
    """
    poses = person.leg.segment_poses(person.trajectories)
    fit = person.fit
    return ReplayScene(
        name=person.name,
        trajectories=person.trajectories,
        shifts=person.leg.shifts,
        poses=poses,
        joint_centers=person.leg.joint_centers(poses),
        imu=signals,
        sensor_poses=simulation.sensor_poses(
            person.leg, person.splines, signals.sensors, person.trajectories.times
        ),
        measured=None if fit is None else fit.measured,
        modelled=None if fit is None else fit.modelled,
        segment_meshes=_bones(phantom or load_leg_phantom(scales=person.leg.scales)),
        floor_height=_floor(poses),
    )


def _bones(phantom: LegPhantom) -> tuple[SegmentMesh, ...]:
    """Extracts the outer surface of each bone, in the frame of its segment."""
    meshes = []
    for part, segment in zip(phantom.phantom.parts, phantom.segments, strict=True):
        if part.name.rsplit("_", 1)[0] in _SHOWN_SURFACES[1:]:
            meshes.append(
                SegmentMesh(part.name, segment, phantom.in_segment(part.name), part.triangles)
            )
    return tuple(meshes)


def _floor(poses: SegmentPoses) -> float:
    """Height of the soles: 2 cm below the lower toe joint, the median over the recording."""
    return (
        float(np.median(np.minimum(poses.of("toes_l")[:, 1, 3], poses.of("toes_r")[:, 1, 3])))
        - 0.02
    )


def scan_scene(
    scan: SimulatedScan, slices: Sequence[VolumeSlices] = (), every: int = 8
) -> ScanScene:
    """Builds the replay with skin, C-arm, projections and slices.

    The skin is at every ``every``-th view.
    """
    setup = scan.setup
    phantom, poses = setup.phantom, setup.poses
    replay = replay_scene(setup.person, scan.seen.signals, phantom)
    views = np.arange(0, len(poses.times), every)
    posed = [phantom.posed(poses.world_from_segment[view], poses.segment_names) for view in views]
    surfaces = [
        MovingSurface(
            part.name,
            poses.times[views],
            np.stack([p[k] for p in posed]).astype(np.float32),
            part.triangles,
        )
        for k, part in enumerate(phantom.phantom.parts)
        if part.name.startswith("skin")
    ]
    return ScanScene(
        replay=replay,
        projections=scan.seen.projections,
        surfaces=tuple(surfaces),
        slices=tuple(slices),
    )
