"""Scenes of a replay and of a scan, built from the values of the stages."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from legsim.core.values import FloatArray
from legsim.geometry.cone_beam import Projections
from legsim.geometry.volume import NamedVolume
from legsim.imu import simulation
from legsim.imu.signals import ImuSignals
from legsim.imu.simulation import Sensor
from legsim.kinematics.joint_splines import JointSplines
from legsim.kinematics.moving_leg import MovingLeg
from legsim.kinematics.skeleton import JOINT_CENTERS, SegmentPoses
from legsim.phantom.leg_phantom import LegPhantom
from legsim.scene.values import MovingSurface, ReplayScene, ScanScene, SegmentMesh, SlicePlanes

if TYPE_CHECKING:
    pass


_SHOWN_SURFACES = ("skin", "patella_cortex", "femur_cortex", "tibia_cortex", "fibula_cortex")

_AXIAL_OFFSET = 0.05
"""m below and above the knee center of the axial slices"""


def replay_scene(
    recovered: MovingLeg,
    splines: JointSplines,
    sensors: tuple[Sensor, ...],
    signals: ImuSignals,
    phantom: LegPhantom,
) -> ReplayScene:
    """Skeleton with bones, markers, sensors and curves."""
    poses = recovered.leg.segment_poses(recovered.trajectories)
    fit = recovered.fit
    return ReplayScene(
        name=recovered.name,
        trajectories=recovered.trajectories,
        poses=poses,
        joint_centers=recovered.leg.joint_centers(poses),
        imu=signals,
        sensor_poses=simulation.sensor_poses(
            recovered.leg, splines, sensors, recovered.trajectories.times
        ),
        measured=None if fit is None else fit.measured,
        modelled=None if fit is None else fit.modelled,
        segment_meshes=_bones(phantom),
        floor_height=_floor(poses),
    )


def _bones(phantom: LegPhantom) -> tuple[SegmentMesh, ...]:
    """The outer surface of each bone, in the frame of its segment."""
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
    replay: ReplayScene,
    phantom: LegPhantom,
    poses: SegmentPoses,
    projections: Projections,
    volumes: Sequence[NamedVolume],
    every: int = 8,
) -> ScanScene:
    """The replay with skin, C-arm, projections and slices; skin at every ``every``-th view."""
    knee = replay.joint_centers.positions_world[:, JOINT_CENTERS.index("knee_l")].mean(0)
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
    center = volumes[0].volume.grid.center if volumes else knee
    return ScanScene(
        replay=replay,
        projections=projections,
        surfaces=tuple(surfaces),
        volumes=tuple(volumes),
        planes=slice_planes(center),
    )


def slice_planes(center: Sequence[float] | FloatArray) -> SlicePlanes:
    """Below and above ``center`` (3,), which is the knee's, and sagittal through it."""
    _, y, z = (float(c) for c in center)
    return SlicePlanes(y - _AXIAL_OFFSET, y + _AXIAL_OFFSET, z)
