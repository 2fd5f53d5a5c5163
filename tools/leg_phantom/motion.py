"""How knee and patella of the unscaled leg model move: what the joint faces of the phantom are
shaped by.
"""

import numpy as np

from legsim.core import transforms
from legsim.kinematics.leg_model import COORDINATES, LegModel
from legsim.kinematics.skeleton import SegmentPoses
from legsim.mocap.trajectories import JointTrajectories
from tools.leg_phantom.fields import Array


def leg_poses(flexion: Array, *, hip_flexion: float = 0.0) -> SegmentPoses:
    """Poses of the unscaled leg model at knee flexions (n,) in rad, the same on both sides; all
    else straight but the hips.
    """
    values = np.zeros((len(flexion), len(COORDINATES)))
    for side in "lr":
        values[:, COORDINATES.index(f"knee_angle_{side}")] = -np.asarray(flexion)
        values[:, COORDINATES.index(f"hip_flexion_{side}")] = hip_flexion
    return LegModel.load().segment_poses(
        JointTrajectories(np.arange(len(flexion), dtype=float), COORDINATES, values)
    )


def femur_from_tibia(flexion: Array) -> Array:
    """(n, 4, 4) of the right knee at flexion angles (n,) in rad."""
    poses = leg_poses(flexion)
    return transforms.inverse(poses.of("femur_r")) @ poses.of("tibia_r")


def femur_from_patella(flexion: Array) -> Array:
    """(n, 4, 4) of the right patella at flexion angles (n,) in rad."""
    poses = leg_poses(flexion)
    return transforms.inverse(poses.of("femur_r")) @ poses.of("patella_r")


def plateau_contact(flexion: Array, plateau: float) -> Array:
    """Points (n, 2) of the femur, x and y, that a plane at y = ``plateau`` of the tibia touches at
    each flexion: its envelope.
    """

    def height(angle: Array) -> Array:
        pose = femur_from_tibia(angle)
        normal = np.stack([np.sin(angle), np.cos(angle)], -1)
        return (pose[:, :2, 3] * normal).sum(-1) + plateau

    h = 1e-4
    slope = (height(flexion + h) - height(flexion - h)) / (2 * h)
    normal, along = (
        np.stack([np.sin(flexion), np.cos(flexion)], -1),
        np.stack([np.cos(flexion), -np.sin(flexion)], -1),
    )
    return height(flexion)[:, None] * normal + slope[:, None] * along
